"""What Rerun shows of a run, read back from its files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
import rerun
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.geometry import quaternion_to_rotation, transform
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc.viz.viewer import NoViewer, run_viewer
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture
from viewer_helpers import RUN_ENTITIES, Recorded, file_names, show_run

FRAMES = 8


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    """Rerun's warnings are errors."""
    rerun.set_strict_mode(True)
    yield
    rerun.set_strict_mode(False)


@pytest.fixture(scope="module")
def room() -> Room:
    return Room()


@pytest.fixture(scope="module")
def recording(room: Room) -> RoomRecording:
    return RoomRecording(room, make_path(FRAMES), SMALL_CAMERA)


@pytest.fixture(scope="module")
def bundle(room: Room, recording: RoomRecording) -> Bundle:
    return make_bundle(room_mixture(room, 60), recording)


def positions(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return poses[:, :3, 3]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory, bundle: Bundle, recording: RoomRecording) -> tuple[Run, Recorded]:
    path = tmp_path_factory.mktemp("shown") / "run.rrd"
    with run_viewer("a run", view=False, record=path) as recorder:
        run = show_run(bundle, recording, recorder)
    assert file_names(path.parent) == ["run.rrd"]
    return run, Recorded(path)


def test_run_does_not_depend_on_the_viewer(bundle, recording, shown):
    with run_viewer("a run", view=False, record=None) as viewer:
        assert isinstance(viewer, NoViewer)
        run = show_run(bundle, recording, viewer)
    np.testing.assert_array_equal(run.poses, shown[0].poses)


def test_every_frame_is_recorded_with_its_time_and_layout(shown):
    _, recorded = shown
    assert recorded.entities >= RUN_ENTITIES
    assert recorded.store.application_id == "monoloc localize"
    assert len(recorded.reader.blueprints()) == 1  # the layout comes with the file
    assert recorded.static("/__properties", "RecordingInfo:name") == ["a run"]
    for entity, component in (
        ("/world/camera", "Transform3D:translation"),
        ("/world/camera/image", "EncodedImage:blob"),
        ("/world/particles", "Points3D:positions"),
        ("/depth", "DepthImage:buffer"),
        ("/step_ms", "Scalars:scalars"),
    ):
        assert list(recorded.frames(entity, component)) == list(range(FRAMES)), entity
    seconds = recorded.frames("/step_ms", "seconds")
    times_s = [value.total_seconds() for value in seconds.values()]
    np.testing.assert_allclose(times_s, np.arange(FRAMES) / 15.0, atol=1e-6)


def test_trajectories_and_errors_are_those_of_the_run(shown):
    """Each frame adds one segment of estimate and odometry; the truth is static."""
    run, recorded = shown
    assert run.truth is not None and run.odometry is not None
    translations = np.concatenate(list(recorded.frames("/world/camera", "Transform3D:translation").values()))
    np.testing.assert_allclose(translations, positions(run.poses), atol=1e-6)
    rotations = np.concatenate(list(recorded.frames("/world/camera", "Transform3D:mat3x3").values()))
    # Rerun keeps a matrix's columns one after the other.
    np.testing.assert_allclose(rotations.reshape(-1, 3, 3).swapaxes(1, 2), run.poses[:, :3, :3], atol=1e-6)
    for name, poses, first in (("estimate", run.poses, 0), ("odometry", run.odometry, 1)):
        strips = recorded.frames(f"/world/{name}", "LineStrips3D:strips")
        assert list(strips) == list(range(first, FRAMES))
        ends = np.array([strip for (strip,) in strips.values()])
        np.testing.assert_allclose(ends[:, 1], positions(poses)[first:], atol=1e-6)
        np.testing.assert_allclose(ends[1:, 0], ends[:-1, 1], atol=1e-6)
        errors = np.concatenate(list(recorded.frames(f"/error_cm/{name}", "Scalars:scalars").values()))
        distances_m = np.linalg.norm(positions(poses) - positions(run.truth), axis=1)[first:]
        np.testing.assert_allclose(errors, 100.0 * distances_m, atol=1e-9)
    np.testing.assert_allclose(
        recorded.static("/world/truth", "LineStrips3D:strips")[0], positions(run.truth), atol=1e-6
    )


def test_plotted_values_are_those_of_the_run(shown, bundle):
    run, recorded = shown
    stated = 100.0 * np.sqrt(np.trace(run.covariances[:, :3, :3], axis1=1, axis2=2))
    for entity, expected in (
        ("/likelihood/scan", run.mean_log_likelihoods),
        ("/likelihood/low", np.full(FRAMES, bundle.thresholds.low)),
        ("/step_ms", run.step_ms),
        ("/error_cm/stated_sd", stated),
    ):
        values = recorded.frames(entity, "Scalars:scalars")
        np.testing.assert_allclose(np.concatenate(list(values.values())), expected, atol=1e-9)
    states = recorded.frames("/state", "StateChange:state")
    assert [state for (state,) in states.values()] == run.states
    texts = [text for (text,) in recorded.frames("/reasons", "TextDocument:text").values()]
    assert len(texts) == FRAMES
    for text, state, reasons in zip(texts, run.states, run.reasons, strict=True):
        said, _, listed = text.partition(": ")
        assert said == state and set(filter(None, listed.split(", "))) == {reason.value for reason in reasons}
    far = np.concatenate(list(recorded.frames("/probability_far", "Scalars:scalars").values()))
    assert len(far) == FRAMES and np.all((far >= 0.0) & (far <= 1.0))
    assert np.all(far[np.array(run.states) == "tracking"] < 0.05)


def covariances_of(half_sizes: Any, quaternions: Any, sigmas: float) -> NDArray[np.float64]:
    axes = quaternion_to_rotation(np.array(quaternions))
    variances = (np.array(half_sizes) / sigmas) ** 2
    return np.asarray((axes * variances[:, None, :]) @ axes.swapaxes(1, 2))


def test_ellipsoids_are_those_of_map_and_covariances(shown, bundle):
    run, recorded = shown
    half_sizes, quaternions, centers = (
        recorded.static("/world/map", f"Ellipsoids3D:{name}") for name in ("half_sizes", "quaternions", "centers")
    )
    np.testing.assert_allclose(centers, bundle.adapted.means, atol=1e-6)
    shown = covariances_of(half_sizes, quaternions, np.sqrt(3.0))
    np.testing.assert_allclose(shown, bundle.adapted.covariances, atol=1e-6)
    spreads, turns = (
        recorded.frames("/world/camera/covariance", f"Ellipsoids3D:{name}") for name in ("half_sizes", "quaternions")
    )
    # 95 % of a Gaussian in three dimensions lie within 2.7955 standard deviations.
    shown = np.concatenate([covariances_of(spreads[k], turns[k], 2.7955) for k in range(FRAMES)])
    np.testing.assert_allclose(shown, run.covariances[:, :3, :3], rtol=1e-3, atol=1e-9)


def test_scan_lies_on_surfaces_and_projects_into_the_image(shown, room, recording):
    run, recorded = shown
    scans = recorded.frames("/world/scan", "Points3D:positions")
    for scan in scans.values():
        assert np.median(room.distance_m(np.array(scan))) < 0.06
    # The scan, in the camera, falls on the image that Rerun draws before it.
    matrix = np.array(recorded.static("/world/camera/image", "Pinhole:image_from_camera")[0]).reshape(3, 3).T
    inverse = np.linalg.inv(run.poses[0])
    pixels = transform(inverse, np.array(scans[0])) @ matrix.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    ours = SMALL_CAMERA.project(transform(inverse, np.array(scans[0]))) + 0.5
    np.testing.assert_allclose(pixels, ours, atol=1e-3)
    (blob,) = recorded.frames("/world/camera/image", "EncodedImage:blob")[3]
    image = cv2.imdecode(np.array(blob, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(image[..., ::-1].astype(int) - recording.color(3)).mean() < 8.0
    assert recorded.static("/world", "ViewCoordinates:xyz") == [[3, 2, 5]]  # right, down, forward


def test_errors_need_truth_and_thresholds_need_a_network(tmp_path, room, bundle):
    """Thresholds are those of a network, and so are not shown with sensor depth."""
    without_truth = RoomRecording(room, make_path(3), SMALL_CAMERA)
    assert without_truth.poses is not None
    start, without_truth.poses = Start(without_truth.poses[0]), None
    rng = np.random.default_rng(0)
    with run_viewer("a run", view=False, record=tmp_path / "run.rrd") as recorder:
        localize(bundle, without_truth, start, rng, NoProgress(), use_sensor_depth=True, viewer=recorder)
    recorded = Recorded(tmp_path / "run.rrd")
    assert "/world/truth" not in recorded.entities
    assert recorded.frames("/error_cm/estimate", "Scalars:scalars") == {}
    assert recorded.frames("/likelihood/lost", "Scalars:scalars") == {}
    assert len(recorded.frames("/likelihood/scan", "Scalars:scalars")) == 3
