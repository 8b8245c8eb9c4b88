"""How a camera sits on the vehicle: where it looks, by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from monoloc.config import load_settings
from monoloc.flight.flight_settings import FlightSettings, Mount, down_of_map
from monoloc.geometry import FloatArray, is_rigid
from monoloc.image_turns import T_camera_turned
from refusals import refuses_data, refuses_setting

FORWARD, BACK = (1, 0, 0), (-1, 0, 0)
RIGHT, LEFT = (0, 1, 0), (0, -1, 0)
DOWN, UP = (0, 0, 1), (0, 0, -1)
H = np.sqrt(0.5)

MOUNTS = [
    # turns, where the camera looks, where the right border of its image is
    ({}, FORWARD, RIGHT),
    ({"yaw_deg": 90}, RIGHT, BACK),
    ({"yaw_deg": -90}, LEFT, FORWARD),
    ({"yaw_deg": 180}, BACK, LEFT),
    ({"pitch_deg": 90}, UP, RIGHT),
    ({"pitch_deg": -90}, DOWN, RIGHT),
    ({"pitch_deg": -45}, (H, 0, H), RIGHT),
    ({"roll_deg": 90}, FORWARD, DOWN),  # clockwise, as the camera sees
    ({"roll_deg": 180}, FORWARD, LEFT),
    ({"yaw_deg": 90, "pitch_deg": -90}, DOWN, BACK),  # down, the top of the image to the right
    ({"yaw_deg": 90, "pitch_deg": -45}, (0, H, H), BACK),
    ({"pitch_deg": -90, "roll_deg": 90}, DOWN, BACK),
    ({"yaw_deg": 180, "roll_deg": 90}, BACK, DOWN),
]


@pytest.mark.parametrize(("turns", "axis", "image_right"), MOUNTS)
def test_where_a_turned_camera_looks(
    turns: dict[str, float], axis: tuple[float, ...], image_right: tuple[float, ...]
) -> None:
    T_body_camera = Mount.model_validate({**turns, "forward_m": 0.1, "right_m": -0.02, "down_m": 0.03}).T_body_camera
    assert is_rigid(T_body_camera)
    np.testing.assert_allclose(T_body_camera[:3, 2], axis, atol=1e-12)
    np.testing.assert_allclose(T_body_camera[:3, 0], image_right, atol=1e-12)
    np.testing.assert_array_equal(T_body_camera[:3, 3], [0.1, -0.02, 0.03])


@pytest.mark.parametrize(("turns", "axis", "image_right"), MOUNTS)
def test_images_of_a_turned_camera_stand_upright(
    turns: dict[str, float], axis: tuple[float, ...], image_right: tuple[float, ...]
) -> None:
    mount = Mount.model_validate({**turns, "forward_m": 0.1})
    expected = mount.T_body_camera @ T_camera_turned(mount.quarter_turns)
    np.testing.assert_allclose(mount.upright.T_body_camera, expected, atol=1e-12)
    if abs(axis[2]) < 0.9:  # else it looks up or down
        assert mount.upright.T_body_camera[2, 1] > 0.7 and mount.upright.quarter_turns == 0
    else:
        assert mount.quarter_turns == 0 and mount.upright.roll_deg == mount.roll_deg
    assert image_right[2] != 1 or mount.quarter_turns == 3


def test_settings_are_read_from_a_file_and_wrong_ones_are_named(tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text("north_deg = 75.5\nmost_age_s = 0.3\n[mount]\npitch_deg = -90\ndown_m = 0.05\n")
    settings = load_settings(path, FlightSettings)
    assert (settings.north_deg, settings.most_age_s, settings.rate_hz) == (75.5, 0.3, 50.0)
    assert settings.mount == Mount(pitch_deg=-90, down_m=0.05)
    for line, problem in (
        ("most_age_s = 0", "most_age_s: .*greater than 0"),
        ("most_age_s = nan", "most_age_s: .*finite"),
        ("rate_hz = 1e4", "rate_hz: .*less than or equal to 500"),
        ("most_age_s = true", "most_age_s: is true or false, not a number"),
        ("[mount]\npitch_deg = false", "mount.pitch_deg: is true or false, not a number"),
        ("down = [0, 0, true]", "down.2: is true or false, not a number"),
        ("nort_deg = 3", "nort_deg: is unknown, the nearest is north_deg"),
        ("[mount]\npitch_deg = 91", "mount.pitch_deg: .*less than or equal to 90"),
        ("[mount]\nup_m = 1", "mount.up_m: is unknown, known are forward_m, right_m, down_m, "),
        ("down = [0, 0]", "down.2: is missing"),
        ("down = [0, 0, 0.0]", "down: .*no direction"),
    ):
        path.write_text(line + "\n")
        refuses_data(lambda: load_settings(path, FlightSettings), path, problem, "correct")


@dataclass(frozen=True)
class Level:
    """A map."""

    down: FloatArray | None


def test_gravity_is_that_of_the_settings_unless_the_map_contradicts_it() -> None:
    level, tilted = Level(np.array([0.0, 1.0, 0.0])), (0.0, 2.0, 0.4)
    assert down_of_map(level, FlightSettings()) is level.down
    given = down_of_map(level, FlightSettings(down=tilted))
    assert given is not None and np.allclose(given, np.divide(tilted, np.linalg.norm(tilted)))
    assert down_of_map(Level(None), FlightSettings()) is None
    assert down_of_map(Level(None), FlightSettings(down=(0.0, -1.0, 0.0))) is not None
    refuses_setting(
        lambda: down_of_map(level, FlightSettings(down=(0.0, -1.0, 0.0))),
        "down",
        r"is 180° from the direction that the map tells, \[0.00, 1.00, 0.00\]",
        "leave it out of flight.toml, or correct it",
    )
