"""Images that show nothing of a turn that another sensor measures."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import se3_exp, so3_exp
from monoloc.odometry.motion import Motion
from monoloc.odometry.standing_image import StandingImage

FRAME_S = 1.0 / 15.0
WALL = np.array([[0.1 * x, 0.1 * y, 2.0] for x in range(-5, 6) for y in range(-4, 5)])


def shown(turn_deg: float, step_m: float = 0.0) -> Motion:
    """Motion that images show, about the vertical axis and to the side, before a wall 2 m away."""
    return Motion(se3_exp([step_m, 0.0, 0.0, 0.0, np.deg2rad(turn_deg), 0.0]), len(WALL), WALL)


def measured(turn_deg: float) -> Motion:
    return Motion.rotation(so3_exp([0.0, np.deg2rad(turn_deg), 0.0]), 0.003)


def stood_s(
    frames: int, seen: Motion | None, other: Motion | None, image: StandingImage | None = None
) -> list[float]:
    image = image or StandingImage()
    return [image.update(seen, other, FRAME_S) for _ in range(frames)]


@pytest.mark.parametrize("rate_deg_s", [2.5, 20.0, 100.0])
def test_a_turn_that_the_image_does_not_show_is_found(rate_deg_s: float) -> None:
    """Half a second after three degrees are passed, and from then on, for as long as it lasts."""
    found = np.array(stood_s(60, shown(0.0), measured(rate_deg_s * FRAME_S)))
    first_s = FRAME_S * (int(np.argmax(found > 0.0)) + 1)
    assert 0.5 + 3.0 / rate_deg_s <= first_s < 0.5 + 3.0 / rate_deg_s + 3.1 * FRAME_S
    np.testing.assert_allclose(np.diff(found[found > 0.0]), FRAME_S)


@pytest.mark.parametrize(
    ("seen", "other"),
    [
        (shown(1.5), measured(1.5)),
        (shown(0.5), measured(1.5)),  # odometry that falls short
        (shown(0.0), measured(0.0)),  # a camera at rest
        (shown(0.0), measured(0.6 * FRAME_S)),  # at rest, with a gyroscope's bias
        (shown(0.0, 2.0 * np.deg2rad(1.5)), measured(1.5)),  # a turn that was taken for a step to the side
        (None, measured(1.5)),
        (shown(0.0), None),
        (Motion.rotation(np.eye(3), 0.01), measured(1.5)),  # the image was aligned as a whole: it shows no corners
    ],
)
def test_nothing_is_found_where_images_show_the_turn_or_do_not_show_motion(
    seen: Motion | None, other: Motion | None
) -> None:
    assert not any(stood_s(60, seen, other))


def test_a_delay_between_the_sensors_is_no_standing_image() -> None:
    """A turn of 90 degrees a second begins and ends 0.2 s later, or earlier, in the image."""
    turns = np.repeat([0.0, 6.0, 0.0], 15)
    for frames in (-3, 3):
        image, delayed = StandingImage(), np.roll(turns, frames)
        pairs = zip(map(shown, delayed), map(measured, turns), strict=True)
        assert not any(image.update(seen, other, FRAME_S) for seen, other in pairs)


def test_an_image_that_moves_again_stands_no_longer() -> None:
    image = StandingImage()
    assert stood_s(30, shown(0.0), measured(1.5), image)[-1] > 1.9
    assert stood_s(10, shown(1.5), measured(1.5), image)[-1] == 0.0
    assert stood_s(30, shown(0.0), measured(1.5), image)[-1] > 1.0
    image.reset()
    assert stood_s(1, shown(0.0), measured(45.0), image) == [0.0]
