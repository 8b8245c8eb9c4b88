"""Views of frames and their exposure: geometry, light, noise and what varies by how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from depth_helpers import NEUTRAL_AUGMENT
from monoloc.camera import Camera
from monoloc.depth.training.augment import (
    AugmentConfig,
    Exposure,
    View,
    expose,
    random_exposure,
    random_view,
    whole_view,
)

MANY_ELECTRONS = 1e14
PERFECT = Exposure(electrons=MANY_ELECTRONS, read_noise=0.0)
FRAME = Camera(100, 75, 90.0, 87.0, 48.0, 39.0)
LEVELS = np.array([2.0, 3.0])  # of red and green, per pixel
SIZE = (64, 48)
RAMP = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)


# --- Views ---


def coordinate_frame() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """A frame whose red and green are a pixel's column and row, and whose depth encodes both."""
    v, u = np.mgrid[0 : FRAME.height, 0 : FRAME.width]
    color = np.stack([2 * u, 3 * v, np.full_like(u, 255)], axis=-1).astype(np.uint8)
    return color, (1.0 + u + FRAME.width * v).astype(np.float32)


def check_view(view: View) -> float:
    """Colour and depth show the frame at ``linear @ p + offset``; returns the share of pixels inside the frame."""
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].reshape(2, -1)
    expected = np.stack([columns, rows], axis=1) @ view.linear.T + view.offset
    upper = np.array([FRAME.width, FRAME.height]) - 1
    depth = view.depth_m.ravel()
    seen = depth > 0.0
    clearly_inside = ((expected > -0.4) & (expected < upper + 0.4)).all(axis=1)
    clearly_outside = ((expected < -0.6) | (expected > upper + 0.6)).any(axis=1)
    assert seen[clearly_inside].all() and not seen[clearly_outside].any()
    by_depth = np.stack(np.divmod(depth[seen].astype(np.int64) - 1, FRAME.width)[::-1], axis=1)
    assert np.abs(by_depth - expected[seen]).max() <= 0.5 + 1 / 16  # nearest, up to OpenCV's fixed point
    # Colours are averages about the pixel, so the pixel's own footprint must lie inside too.
    reach = np.abs(view.linear).sum(axis=1)
    whole = ((expected > reach) & (expected < upper - reach)).all(axis=1)
    # Rounded to eight bits twice, halves upwards.
    by_color = view.color.reshape(-1, 3)[whole, :2] / LEVELS
    assert np.abs(by_color - expected[whole]).max() < 0.6
    assert np.abs((by_color - expected[whole]).mean(axis=0)).max() < 0.3
    return float(seen.mean())


@given(st.integers(0, 100_000))
@settings(max_examples=25)
def test_random_views_show_the_frame_where_they_state(seed: int) -> None:
    color, depth_m = coordinate_frame()
    config = AugmentConfig(roll_deg=40.0, zoom_min=0.8, zoom_max=2.5)
    view = random_view(color, depth_m, FRAME, SIZE, config, np.random.default_rng(seed))
    assert view.color.shape == (48, 64, 3) and view.color.dtype == np.uint8
    assert view.depth_m.shape == (48, 64) and view.depth_m.dtype == np.float32
    check_view(view)
    assert view.focal_px == pytest.approx(FRAME.focal_px / np.sqrt(abs(np.linalg.det(view.linear))))
    whole_focal_px = FRAME.resized(*SIZE).focal_px
    # The view's centre varies by as much as the magnification leaves inside the frame.
    middle = view.linear @ ((np.array(SIZE) - 1.0) / 2.0) + view.offset
    room = max(0.0, 1.0 - whole_focal_px / view.focal_px) * np.array([FRAME.width, FRAME.height]) / 2.0
    assert (np.abs(middle - (np.array([FRAME.width, FRAME.height]) - 1.0) / 2.0) <= room + 1e-9).all()
    assert 0.8 * whole_focal_px * (1.0 - 1e-9) <= view.focal_px <= 2.5 * whole_focal_px


def test_whole_view_is_the_resized_camera() -> None:
    view = whole_view(*coordinate_frame(), FRAME, SIZE)
    assert check_view(view) == 1.0
    small = FRAME.resized(*SIZE)
    assert view.focal_px == pytest.approx(small.focal_px)
    pixels = np.array([[0.0, 0.0], [63.0, 0.0], [20.0, 40.0]])
    np.testing.assert_allclose(FRAME.rays(pixels @ view.linear.T + view.offset), small.rays(pixels), atol=1e-12)


def test_neutral_view_is_the_whole_view() -> None:
    frame = coordinate_frame()
    neutral = random_view(*frame, FRAME, SIZE, NEUTRAL_AUGMENT, np.random.default_rng(0))
    whole = whole_view(*frame, FRAME, SIZE)
    np.testing.assert_allclose(neutral.linear, whole.linear)
    np.testing.assert_allclose(neutral.offset, whole.offset)
    np.testing.assert_array_equal(neutral.depth_m, whole.depth_m)


def test_half_of_the_views_are_mirrored_and_none_where_it_is_off() -> None:
    frame = coordinate_frame()
    rng = np.random.default_rng(0)
    for config, low, high in ((AugmentConfig(), 70, 130), (AugmentConfig(mirror=False), 0, 0)):
        views = [random_view(*frame, FRAME, SIZE, config, rng) for _ in range(200)]
        assert low <= sum(np.linalg.det(view.linear) < 0.0 for view in views) <= high


def test_a_mirrored_view_is_mirrored_left_to_right() -> None:
    frame = coordinate_frame()
    config = NEUTRAL_AUGMENT.model_copy(update={"mirror": True})
    views = [random_view(*frame, FRAME, SIZE, config, np.random.default_rng(seed)) for seed in range(8)]
    mirrored = [view for view in views if np.linalg.det(view.linear) < 0.0]
    assert 0 < len(mirrored) < 8
    whole = whole_view(*frame, FRAME, SIZE)
    difference = mirrored[0].color[:, ::-1].astype(int) - whole.color
    assert np.abs(difference).max() <= 1


def test_views_have_no_depth_where_the_frame_has_none() -> None:
    color, depth_m = coordinate_frame()
    depth_m[20:45, 30:60] = 0.0
    view = random_view(color, depth_m, FRAME, SIZE, AugmentConfig(zoom_max=1.0), np.random.default_rng(3))
    rows, columns = np.nonzero(view.depth_m == 0.0)
    at = np.round(np.stack([columns, rows], axis=1) @ view.linear.T + view.offset)
    hole = ((at >= [29, 19]) & (at <= [60, 45])).all(axis=1)
    outside = ((at <= 0) | (at >= [99, 74])).any(axis=1)
    assert hole.any() and (hole | outside).all()
    assert set(np.unique(view.depth_m)) <= set(np.unique(depth_m))  # depth is never interpolated across an edge


# --- Exposure ---


def linear(color: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Light on the sensor, 0..1, of an image with the display's curve."""
    return (color / 255.0) ** 2.2


def grey(level: int, height: int = 200, width: int = 200) -> NDArray[np.uint8]:
    return np.full((height, width, 3), level, dtype=np.uint8)


@given(st.integers(0, 1000))
@settings(max_examples=10)
def test_neutral_exposure_by_a_perfect_sensor_changes_nothing(seed: int) -> None:
    color = np.random.default_rng(seed).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    rng = np.random.default_rng(seed)
    np.testing.assert_array_equal(expose(color, PERFECT, rng), color)
    np.testing.assert_array_equal(random_exposure(color, NEUTRAL_AUGMENT, rng), color)


def test_neutral_exposure_by_a_good_camera_is_hardly_visible() -> None:
    exposed = expose(RAMP.repeat(50, axis=0), Exposure(), np.random.default_rng(0)).astype(int)
    difference = np.abs(exposed - RAMP)[:, 40:]
    assert difference.mean() < 1.0 and difference.max() <= 8


@pytest.mark.parametrize("stops", [-4.0, -1.0, 0.5, 1.0])
def test_a_stop_is_a_factor_of_two_in_light(stops: float) -> None:
    exposed = expose(RAMP, replace(PERFECT, stops=stops), np.random.default_rng(0))
    expected = 255.0 * np.minimum(1.0, 2.0**stops * linear(RAMP)) ** (1.0 / 2.2)
    assert np.abs(exposed - expected).max() <= 0.5 + 1e-3


def test_balance_is_a_gain_of_each_channel() -> None:
    exposed = expose(RAMP, replace(PERFECT, balance=(0.5, 1.0, 0.8)), np.random.default_rng(0))
    expected = 255.0 * (linear(RAMP) * [0.5, 1.0, 0.8]) ** (1.0 / 2.2)
    assert np.abs(exposed - expected).max() <= 0.5 + 1e-3


@pytest.mark.parametrize(
    ("electrons", "read_noise", "level"), [(300.0, 0.0, 90), (300.0, 10.0, 150), (3000.0, 10.0, 150)]
)
def test_noise_is_that_of_counted_electrons(level: int, electrons: float, read_noise: float) -> None:
    """Poisson's variance, with a mean of N electrons, and the sensor's own; the display's curve is undone.

    Both grey levels are more than four standard deviations from black and white, and noise exceeds one level, so
    that rounding adds only a twelfth of a level squared. The variance of 120,000 values is known to 0.4 %.
    """
    exposed = expose(grey(level), Exposure(electrons=electrons, read_noise=read_noise), np.random.default_rng(0))
    light = float(linear(grey(level, 1, 1)).mean())
    expected = (light * electrons + read_noise**2) / electrons**2
    rounding = (2.2 * light / level) ** 2 / 12.0
    assert linear(exposed).var() == pytest.approx(expected + rounding, rel=0.025)
    assert linear(exposed).mean() == pytest.approx(light, abs=5.0 * np.sqrt(expected / exposed.size) + 1e-4)


def test_noise_is_independent_between_pixels_and_channels() -> None:
    exposed = expose(grey(128), Exposure(electrons=300.0), np.random.default_rng(0)) - 128.0
    channels = np.corrcoef(exposed.reshape(-1, 3).T)[~np.eye(3, dtype=bool)]
    neighbours = np.corrcoef(exposed[:, :-1].ravel(), exposed[:, 1:].ravel())[0, 1]
    assert np.abs(channels).max() < 0.03 and abs(neighbours) < 0.03


def test_dark_images_are_noisier_relative_to_their_light() -> None:
    """The same sensor with four stops less light."""
    sensor = Exposure(electrons=1000.0)
    spread = []
    for stops in (0.0, -4.0):
        exposed = linear(expose(grey(128), replace(sensor, stops=stops), np.random.default_rng(0)))
        spread.append(exposed.std() / exposed.mean())
    assert spread[1] > 4.0 * spread[0]  # shot noise alone gives a factor of four; read noise adds to it


def test_blur_preserves_light_and_removes_detail() -> None:
    color = np.random.default_rng(0).integers(0, 200, (60, 80, 3), dtype=np.uint8)
    blurred = expose(color, replace(PERFECT, blur_px=1.5), np.random.default_rng(0))
    assert linear(blurred).mean() == pytest.approx(linear(color).mean(), rel=0.02)
    assert linear(blurred).std() < 0.4 * linear(color).std()


def test_saturation_contrast_and_gamma_are_of_the_displayed_image() -> None:
    color = np.random.default_rng(0).integers(60, 190, (20, 30, 3), dtype=np.uint8)
    shown, rng = color / 255.0, np.random.default_rng(0)
    mean = shown.mean(axis=2, keepdims=True)
    for exposure, expected in (
        (replace(PERFECT, saturation=0.0), mean + 0.0 * shown),
        (replace(PERFECT, saturation=0.6), mean + 0.6 * (shown - mean)),
        (replace(PERFECT, contrast=1.2), 0.5 + 1.2 * (shown - 0.5)),
        (replace(PERFECT, gamma=0.7), shown**0.7),
    ):
        assert np.abs(expose(color, exposure, rng) / 255.0 - expected).max() <= 0.5 / 255.0 + 1e-4


@given(st.integers(0, 100_000))
@settings(max_examples=10)
def test_exposure_preserves_the_image_s_form_and_repeats_with_its_seed(seed: int) -> None:
    color = np.random.default_rng(seed).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    before = color.copy()
    once, again = (random_exposure(color, AugmentConfig(), np.random.default_rng(seed)) for _ in range(2))
    assert once.shape == color.shape and once.dtype == np.uint8
    np.testing.assert_array_equal(once, again)
    np.testing.assert_array_equal(color, before)


def test_exposure_preserves_the_order_of_brightness() -> None:
    """Light, gamma and contrast are monotonic curves; noise, blur and saturation are off."""
    config = AugmentConfig(electrons_min=MANY_ELECTRONS, read_noise=0.0, blur_px=0.0, saturation=0.0)
    means = []
    for seed in range(20):
        exposed = random_exposure(RAMP, config, np.random.default_rng(seed)).astype(int)
        assert (np.diff(exposed, axis=1) >= 0).all()
        means.append(exposed.mean())
    assert np.std(means) > 15.0


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_dim_share_and_dim_stops_bound_how_many_views_are_dimmed_and_by_how_much(share: float) -> None:
    config = NEUTRAL_AUGMENT.model_copy(update={"dim_share": share, "dim_stops": 3.0})
    rng = np.random.default_rng(0)
    light = [linear(random_exposure(grey(200, 1, 1), config, rng)).mean() for _ in range(500)]
    stops = np.log2(np.array(light) / linear(grey(200, 1, 1)).mean())
    dimmed = stops < -0.02
    # Four standard errors of a share of 500; a view that is dimmed by almost nothing does not count.
    assert dimmed.mean() == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / 500) + 0.02)
    assert stops.max() <= 0.02
    if share > 0.0:
        assert -3.05 <= stops.min() < -2.5
        assert stops[dimmed].mean() == pytest.approx(-1.5, abs=0.3)


def test_exposure_varies_within_its_bounds() -> None:
    config = NEUTRAL_AUGMENT.model_copy(update={"exposure_stops": 0.8})
    rng = np.random.default_rng(0)
    light = [linear(random_exposure(grey(120, 1, 1), config, rng)).mean() for _ in range(300)]
    stops = np.log2(np.array(light) / linear(grey(120, 1, 1)).mean())
    assert -0.82 <= stops.min() < -0.7 and 0.7 < stops.max() <= 0.82
