"""Views to tune on: frames as taken and as synthesised nearby, with pose, depth and rays."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch

from adapt_helpers import NONE_HELD_OUT, RedAndNear, redness, room_map, views_of
from depth_helpers import ROOM, SMALL_CAMERA, TINY, exported_model, looking_around, small_recording, tiny_network
from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.training_views import Views, make_views
from monoloc.adapt.tuning import Adaptation
from monoloc.depth.predictor import DepthPredictor
from monoloc.geometry import se3_exp, so3_log
from monoloc.io.recording import Selection
from synthetic_room import RoomRecording

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return small_recording(12)


@pytest.fixture(scope="module")
def views(recording: RoomRecording) -> Views:
    """The whole view of every frame, and two views synthesised near it."""
    return views_of(recording, 24)


def test_views_are_selected_by_frame(recording: RoomRecording, views: Views) -> None:
    """Frames as taken come first, then synthesised views."""
    assert len(views) == 3 * len(recording)
    assert recording.poses is not None
    np.testing.assert_array_equal(views.frame, [*range(12), *np.repeat(np.arange(12), 2)])
    np.testing.assert_array_equal(views.whole, [True] * 12 + [False] * 24)
    np.testing.assert_allclose(views.origins[:12], recording.poses[:, :3, 3])
    chosen = views.of_frames([2, 7])
    np.testing.assert_array_equal(chosen.frame, [2, 7, 2, 2, 7, 7])
    np.testing.assert_array_equal(views.of_frames(np.array([7, 2]), only_whole=True).frame, [2, 7])
    torch.testing.assert_close(chosen.rays_world[3], views.rays_world[17])
    np.testing.assert_array_equal(chosen.colors[3], views.colors[17])
    torch.testing.assert_close(chosen.depth_m[1], views.depth_m[7])
    torch.testing.assert_close(chosen.origins[5], views.origins[27])


def test_views_repeat_with_their_seed_only(recording: RoomRecording) -> None:
    few = Selection(recording, [0, 1, 2])
    one, same, other = (
        make_views(few, few.depth, TINY.focal_px, 3, NONE_HELD_OUT, np.random.default_rng(seed)) for seed in (0, 0, 1)
    )
    for name in ("colors", "depth_m", "rays_world", "poses"):
        first, again, changed = (np.asarray(getattr(made, name)) for made in (one, same, other))
        np.testing.assert_array_equal(again, first)
        np.testing.assert_array_equal(changed[:3], first[:3])
        assert not np.array_equal(changed[3:], first[3:])


@pytest.mark.parametrize(("synthesised", "progress"), [(0, [1, 2, 3]), (4, [1, 2, 3, 4, 5, 6])])
def test_views_are_synthesised_evenly_and_progress_counts_frames(
    recording: RoomRecording, synthesised: int, progress: list[int]
) -> None:
    few, done = Selection(recording, [0, 1, 2]), []
    rng = np.random.default_rng(0)
    made = make_views(few, few.depth, TINY.focal_px, synthesised, NONE_HELD_OUT, rng, done.append)
    counts = np.bincount(made.frame[~made.whole], minlength=3)
    assert counts.sum() == synthesised and counts.max() - counts.min() <= 1
    assert done == progress


def test_frames_as_taken_have_a_fifth_of_the_odds(views: Views) -> None:
    """Evenly, and all of them where nothing is synthesised."""
    assert float(views.odds().sum()) == pytest.approx(1.0)
    assert float(views.odds()[views.whole].sum()) == pytest.approx(0.2)
    assert len(views.odds()[views.whole].unique()) == len(views.odds()[~views.whole].unique()) == 1
    whole = views.of_frames(range(12), only_whole=True)
    torch.testing.assert_close(whole.odds(), torch.full((12,), 1.0 / 12.0))


def test_cameras_of_views_are_rigid_and_near_their_frames(recording: RoomRecording, views: Views) -> None:
    """Rays are those of one camera in another pose: with z = 1 in that camera, which stands near its frame's."""
    camera = recording.camera.resized(96, 64).resized(24, 16)
    rays = camera.pixel_rays().reshape(-1, 3)
    assert recording.poses is not None
    shifts, turns = [], []
    for index in range(len(views)):
        R = np.linalg.lstsq(rays, views.rays_world[index].numpy(), rcond=None)[0].T
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1.0)
        np.testing.assert_allclose(views.rays_world[index].numpy() @ R, rays, atol=1e-9)
        of_frame = recording.poses[int(views.frame[index])]
        shifts.append(np.linalg.norm(views.origins[index].numpy() - of_frame[:3, 3]))
        turns.append(np.linalg.norm(so3_log(of_frame[:3, :3].T @ R)))
    assert max(shifts[:12]) < 1e-12 and max(turns[:12]) < 1e-6
    # The disturbance of three axes, shrunk where too little of the view would be known.
    assert 0.1 < np.median(shifts[12:]) < 0.5
    assert np.deg2rad(3.0) < np.median(turns[12:]) < np.deg2rad(15.0)


def test_most_of_a_synthesised_view_is_known(views: Views) -> None:
    known = (views.depth_m > 0.0).double().mean((1, 2, 3))
    assert float(known[views.whole].min()) == 1.0
    assert float(known[~views.whole].min()) > 0.5 and float(known[~views.whole].median()) > 0.7


def test_held_out_frames_are_not_used_for_views_of_other_frames() -> None:
    """Else adaptation would know the frames it is evaluated on; the last assertion is a positive control."""
    poses = np.repeat(looking_around(6), 2, axis=0)
    poses[1::2] = poses[::2] @ se3_exp(np.array([0.05, 0.02, 0.0, 0.01, 0.05, 0.0]))
    recording = RedAndNear(ROOM, poses, SMALL_CAMERA)
    others = np.setdiff1d(np.arange(12), recording.marked)
    apart, together = (views_of(recording, 36, held_out) for held_out in (recording.marked, NONE_HELD_OUT))
    assert redness(apart.of_frames(others)).max() == 0.0
    assert redness(apart.of_frames(recording.marked)).min() > 0.3
    assert redness(together.of_frames(others)).max() > 0.3


def test_whole_views_are_what_the_runtime_sees(recording: RoomRecording, views: Views) -> None:
    """The network meets the same pixels, rays and focal length in flight as when it was tuned."""
    network = tiny_network()
    predictor = DepthPredictor(exported_model(network), recording.camera)
    whole = views.of_frames(range(12), only_whole=True)
    predicted = Adaptation(network, AdaptedMap(*room_map(0.4, 5)), AdaptConfig()).predict(whole).exp()
    assert recording.poses is not None
    for index in range(12):
        depth = predictor(recording.color(index))
        np.testing.assert_allclose(predicted[index, 0], depth.depth_m, rtol=0.02)
        rays = depth.camera.pixel_rays().reshape(-1, 3) @ recording.poses[index][:3, :3].T
        np.testing.assert_allclose(whole.rays_world[index], rays, atol=1e-9)


def test_back_projected_views_lie_on_the_room_s_surfaces(views: Views) -> None:
    """The depth of a view, along its rays, from its origin, whether taken or synthesised."""
    depth = views.depth_m[:, 0]
    # An output pixel's centre lies between the four pixels of its block.
    corners = torch.stack([depth[:, i::2, j::2] for i in (0, 1) for j in (0, 1)])
    smooth = (corners.amin(0) > 0.0) & (corners.amax(0) < 1.06 * corners.amin(0))
    z = corners.mean(0).reshape(len(views), -1).double()
    points = views.origins[:, None] + z[..., None] * views.rays_world
    # Of what falls in a synthesised pixel the nearest counts, half a percent nearer than its middle.
    for kind, least_share, most_m in ((views.whole, 0.7, 0.01), (~views.whole, 0.4, 0.02)):
        usable = smooth.reshape(len(views), -1) & kind[:, None]
        assert float(usable.double().sum() / (kind.sum() * z.shape[1])) > least_share
        distance = ROOM.distance_m(points[usable].numpy())
        assert np.median(distance) < most_m
        assert np.percentile(distance, 99.0) < 3.0 * most_m


def test_views_have_the_focal_length_of_the_network_s_input(recording: RoomRecording, views: Views) -> None:
    """Neighbouring rays differ by its reciprocal."""
    assert views.colors.shape == (36, 64, 96, 3) and views.colors.dtype == np.uint8
    assert views.log_focal_ratio == pytest.approx(np.log(recording.camera.resized(96, 64).focal_px / TINY.focal_px))
    rays = views.rays_world.reshape(len(views), 16, 24, 3)
    middle = rays[:, 8, 12]
    area = torch.linalg.cross(rays[:, 8, 13] - middle, rays[:, 9, 12] - middle).norm(dim=1)  # of an output pixel
    np.testing.assert_allclose(4.0 / area.sqrt(), TINY.focal_px * np.exp(views.log_focal_ratio), rtol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 10.0 / 3.0])
def test_supervision_is_not_shifted_against_the_image(scale: float) -> None:
    """The shift, in pixels of the supervision, that best explains its difference to the room rendered there."""
    camera = SMALL_CAMERA.resized(round(192 * scale), round(128 * scale))
    recording = RoomRecording(ROOM, looking_around(6), camera)
    views = views_of(recording, 24)
    small = camera.resized(48, 32)
    for kind in (views.whole, ~views.whole):
        slopes, errors = [], []
        for index in torch.nonzero(kind).ravel():
            truth = np.log(ROOM.view(views.poses[index].numpy(), small)[1].astype(np.float64))
            along_y, along_x = np.gradient(truth)
            smooth = np.abs(cv2.Laplacian(truth, cv2.CV_64F)) < 8e-3
            smooth[[0, -1]] = smooth[:, [0, -1]] = False
            found = views.depth_m[index, 0].numpy()
            smooth &= found > 0.0
            slopes.append(np.stack([along_x[smooth], along_y[smooth]], axis=1))
            errors.append(np.log(found[smooth]) - truth[smooth])
        shift_px = np.linalg.lstsq(np.concatenate(slopes), np.concatenate(errors), rcond=None)[0]
        # Frames are minified: the nearest of four equally near pixels is an eighth of a pixel off.
        assert np.abs(shift_px).max() < 0.2
