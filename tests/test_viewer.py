"""The viewer: one that does nothing, and what Rerun gets to show, read back from its recordings."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun
import rerun_cli
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.cli.main import invoke
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.cloud_metrics import cloud_distances, matched_clouds
from monoloc.geometry import quaternion_to_rotation, transform
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc.viz import viewer
from monoloc.viz.viewer import NoViewer, Viewer, run_viewer
from monoloc_lab.cli import demo
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture, write_recording

FRAMES = 8
RUN_ENTITIES = {
    "/world",
    "/world/map",
    "/world/truth",
    "/world/estimate",
    "/world/odometry",
    "/world/camera",
    "/world/camera/image",
    "/world/camera/covariance",
    "/world/particles",
    "/world/scan",
    "/depth",
    "/error_cm/estimate",
    "/error_cm/odometry",
    "/error_cm/stated_sd",
    "/fit/scan",
    "/fit/healthy",
    "/fit/lost",
    "/state",
    "/step_ms",
}
PLACES = ("/world/camera", "Transform3D:translation")


class Recorded:
    """A recording of Rerun's on disk: its entities, and the values of a component by frame."""

    def __init__(self, path: Path) -> None:
        self.reader = RrdReader(path)
        self.entities = {str(entity) for entity in self.reader.stream().collect().schema().entity_paths()}
        (self.store,) = self.reader.recordings()

    def frames(self, entity: str, component: str) -> dict[int, Any]:
        """Values of a component that changes, by the number of the frame."""
        values: dict[int, Any] = {}
        for chunk in self.reader.stream().filter(content=entity, is_static=False).to_chunks():
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                values |= zip(batch["frame"].to_pylist(), batch[component].to_pylist(), strict=True)
        return values

    def static(self, entity: str, component: str) -> Any:
        chunks = self.reader.stream().filter(content=entity, is_static=True).to_chunks()
        batches = [chunk.to_record_batch() for chunk in chunks]
        (values,) = (batch[component].to_pylist()[0] for batch in batches if component in batch.schema.names)
        return values


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    """What Rerun would only warn of is an error here."""
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


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, recording: RoomRecording, bundle: Bundle) -> Path:
    folder = tmp_path_factory.mktemp("made")
    write_recording(folder / "walk", recording)
    write_bundle(folder / "room.monoloc", bundle)
    return folder


@pytest.fixture
def here(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def follow(bundle: Bundle, recording: RoomRecording, seen_by: Viewer) -> Run:
    assert recording.poses is not None
    rng = np.random.default_rng(0)
    return localize(bundle, recording, Start(recording.poses[0]), bundle.settings, rng, NoProgress(), viewer=seen_by)


def positions(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return poses[:, :3, 3]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# --- A run ---


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory, bundle: Bundle, recording: RoomRecording) -> tuple[Run, Recorded]:
    path = tmp_path_factory.mktemp("seen") / "run.rrd"
    with run_viewer("a run", view=False, record=path) as recorder:
        run = follow(bundle, recording, recorder)
    assert names(path.parent) == ["run.rrd"]
    return run, Recorded(path)


def test_nobody_looks_unless_asked(bundle, recording, seen):
    """The stub does nothing, and looking changes nothing."""
    with run_viewer("a run", view=False, record=None) as nobody:
        assert isinstance(nobody, NoViewer)
        run = follow(bundle, recording, nobody)
    np.testing.assert_array_equal(run.poses, seen[0].poses)
    assert vars(nobody) == {}


def test_everything_is_there_at_every_frame(seen):
    _, recorded = seen
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


def test_the_ways_are_the_runs(seen):
    """Estimate and odometry grow by a piece a frame, which begins where the last one ended; the truth is there."""
    run, recorded = seen
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
        apart = np.linalg.norm(positions(poses) - positions(run.truth), axis=1)[first:]
        np.testing.assert_allclose(errors, 100.0 * apart, atol=1e-9)
    np.testing.assert_allclose(
        recorded.static("/world/truth", "LineStrips3D:strips")[0], positions(run.truth), atol=1e-6
    )


def test_the_numbers_are_the_runs(seen, bundle):
    run, recorded = seen
    stated = 100.0 * np.sqrt(np.trace(run.covariances[:, :3, :3], axis1=1, axis2=2))
    for entity, expected in (
        ("/fit/scan", run.fits),
        ("/fit/healthy", np.full(FRAMES, bundle.healthy.low)),
        ("/step_ms", run.step_ms),
        ("/error_cm/stated_sd", stated),
    ):
        values = recorded.frames(entity, "Scalars:scalars")
        np.testing.assert_allclose(np.concatenate(list(values.values())), expected, atol=1e-9)
    states = recorded.frames("/state", "StateChange:state")
    assert [state for (state,) in states.values()] == run.states


def covariances_of(half_sizes: Any, quaternions: Any, sigmas: float) -> NDArray[np.float64]:
    axes = quaternion_to_rotation(np.array(quaternions))
    variances = (np.array(half_sizes) / sigmas) ** 2
    return np.asarray((axes * variances[:, None, :]) @ axes.swapaxes(1, 2))


def test_ellipsoids_are_the_maps_and_the_covariances(seen, bundle):
    run, recorded = seen
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


def test_scan_and_images_lie_where_they_belong(seen, room, recording):
    run, recorded = seen
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


def test_without_truth_and_with_a_sensor(tmp_path, room, bundle):
    """No truth, no error; a sensor's fits are judged by no range."""
    blind = RoomRecording(room, make_path(3), SMALL_CAMERA)
    assert blind.poses is not None
    start, blind.poses = Start(blind.poses[0]), None
    rng = np.random.default_rng(0)
    with run_viewer("a run", view=False, record=tmp_path / "run.rrd") as recorder:
        localize(bundle, blind, start, bundle.settings, rng, NoProgress(), use_sensor_depth=True, viewer=recorder)
    recorded = Recorded(tmp_path / "run.rrd")
    assert "/world/truth" not in recorded.entities
    assert recorded.frames("/error_cm/estimate", "Scalars:scalars") == {}
    assert recorded.frames("/fit/lost", "Scalars:scalars") == {}
    assert len(recorded.frames("/fit/scan", "Scalars:scalars")) == 3


# --- From the command line ---


def test_localize_records(here, capfd):
    assert invoke(["localize", "room.monoloc", "walk", "--out", "plain.txt"]) == 0
    assert invoke(["localize", "room.monoloc", "walk", "--out", "way.txt", "--record", "way.rrd"]) == 0
    assert "written: way.rrd" in capfd.readouterr().err
    assert Path("plain.txt").read_bytes() == Path("way.txt").read_bytes()
    recorded = Recorded(Path("way.rrd"))
    assert recorded.static("/__properties", "RecordingInfo:name") == ["room.monoloc: walk"]
    written = np.loadtxt("way.txt")[:, 1:4]
    translations = np.concatenate(list(recorded.frames("/world/camera", "Transform3D:translation").values()))
    np.testing.assert_allclose(translations, written, atol=1e-5)


def test_map_compare_records(here, bundle, capfd):
    moved = replace(
        bundle, adapted=replace(bundle.original, means=bundle.original.means + np.array([0.03, 0.0, 0.04]))
    )
    write_bundle(here / "moved.monoloc", moved)
    assert invoke(["map", "compare", "moved.monoloc", "--record", "map.rrd", "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    recorded = Recorded(here / "map.rrd")
    assert recorded.store.application_id == "monoloc map compare"
    clouds = matched_clouds(moved.original, moved.adapted, told["points"], np.random.default_rng(0))
    for name, cloud in zip(("original", "adapted"), clouds, strict=True):
        np.testing.assert_allclose(recorded.static(f"/world/{name}", "Points3D:positions"), cloud, atol=1e-5)
        box = told[f"box_{name}_m"]
        centre = np.add(box["upper"], box["lower"]) / 2.0
        np.testing.assert_allclose(recorded.static(f"/world/boxes/{name}", "Boxes3D:centers"), [centre], atol=1e-5)
    # Bars are shares of all points, of which one in a hundred lies beyond the last.
    (bars,) = recorded.static("/distances", "BarChart:values")
    (middles,) = recorded.static("/distances", "BarChart:abscissa")
    shares, at_cm = np.array(bars["buffer"]), np.array(middles["buffer"])
    assert 98.9 < shares.sum() <= 100.0
    distances_cm = 100.0 * cloud_distances(*clouds)
    assert at_cm @ shares / shares.sum() == pytest.approx(np.mean(distances_cm), abs=0.1)
    # The farther a point, the brighter.
    brightness = np.array(recorded.static("/world/distance", "Points3D:colors"), dtype=np.uint32) >> 16 & 0xFF
    near, far = distances_cm < np.percentile(distances_cm, 10), distances_cm > np.percentile(distances_cm, 90)
    assert brightness[far].mean() > brightness[near].mean() + 50


@pytest.mark.parametrize("command", [("localize", "room.monoloc", "walk"), ("map", "compare", "room.monoloc")])
@pytest.mark.parametrize(("path", "problem"), [("no/a.rrd", "no does not exist"), ("walk", "walk is a folder")])
def test_a_recording_that_cannot_be_written_is_refused_before_the_work(here, capfd, command, path, problem):
    before = names(here)
    assert invoke([*command, "--record", path]) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1
    assert err.startswith(f"monoloc: --record: {problem}; ")
    assert names(here) == before


def test_a_run_that_fails_leaves_the_older_recording(here, capfd):
    Path("way.rrd").write_bytes(b"older")
    Path("walk/color/000004.png").write_bytes(b"no image")
    before = names(here)
    assert invoke(["localize", "room.monoloc", "walk", "--record", "way.rrd"]) == 2
    assert "000004.png" in capfd.readouterr().err
    assert names(here) == before and Path("way.rrd").read_bytes() == b"older"


def test_a_place_that_goes_away_is_named(tmp_path):
    looking = run_viewer("a run", view=False, record=tmp_path / "gone" / "a.rrd")
    with pytest.raises(DataError, match=r"gone/a\.rrd: cannot be written .*; name a file"), looking:
        pytest.fail("began all the same")


def test_a_recording_that_is_not_whole_is_not_kept(tmp_path):
    """As on a full disk, of which Rerun says nothing to its caller."""
    looking = run_viewer("a run", view=False, record=tmp_path / "way.rrd")
    with pytest.raises(DataError, match=r"way\.rrd: cannot be written"), looking:
        (partial,) = tmp_path.iterdir()
        partial.write_bytes(b"")
    assert names(tmp_path) == []


# --- The window ---


def free_port() -> int:
    with socket.socket() as chosen:
        chosen.bind(("127.0.0.1", 0))
        return int(chosen.getsockname()[1])


@pytest.fixture
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without a screen, on which nothing listens."""
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(viewer, "_PORT", free_port())


@pytest.mark.parametrize(
    "command", [("localize", "room.monoloc", "walk"), ("map", "compare", "room.monoloc"), ("demo", "--out", "out")]
)
def test_no_display_is_told_before_the_work(here, capfd, no_display, command):
    before = names(here)
    assert invoke([*command, "--view"]) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1
    assert err.startswith("monoloc: --view: there is no display; give --record FILE.rrd")
    assert names(here) == before


def test_a_window_that_does_not_open_is_told(monkeypatch, no_display):
    monkeypatch.setenv("DISPLAY", ":77")
    monkeypatch.setattr(rerun, "spawn", lambda **_: None)
    looking = run_viewer("a run", view=True, record=None)
    with pytest.raises(SettingError, match="--view: Rerun did not open its window"), looking:
        pytest.fail("began all the same")


def test_a_window_that_is_lost_is_not_the_file_s_fault(monkeypatch, tmp_path, no_display):
    def lost(stream: rerun.RecordingStream, window: rerun.GrpcSink, file: Any, **_: Any) -> None:
        viewer.partial_of(tmp_path / "way.rrd").touch()
        raise RuntimeError("no connection")

    monkeypatch.setattr(viewer, "_open_window", lambda: None)
    monkeypatch.setattr(rerun.RecordingStream, "set_sinks", lost)
    looking = run_viewer("a run", view=True, record=tmp_path / "way.rrd")
    with pytest.raises(SettingError, match=r"^--view: the window is lost \(no connection\); try again$"), looking:
        pytest.fail("began all the same")
    assert names(tmp_path) == []


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # while the listener still writes it
def test_a_viewer_that_listens_gets_the_run_live(tmp_path, no_display, bundle, recording):
    """And what it gets is what is recorded beside it."""
    program = Path(rerun_cli.__file__).with_name("rerun")
    live = tmp_path / "live.rrd"
    command = [program, "--save", live, "--port", str(viewer._PORT)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as listener:
        while not viewer._is_listening():
            assert listener.poll() is None
            time.sleep(0.05)
        with run_viewer("a run", view=True, record=tmp_path / "file.rrd") as both:
            follow(bundle, recording, both)
        recorded = Recorded(tmp_path / "file.rrd")
        expected, until = recorded.frames(*PLACES), time.monotonic() + 20.0
        while Recorded(live).frames(*PLACES) != expected:
            assert time.monotonic() < until
            time.sleep(0.1)
        listener.terminate()
    assert len(expected) == FRAMES
    assert Recorded(live).entities >= RUN_ENTITIES


def test_demo_shows_every_run(tmp_path, monkeypatch, capfd, made, bundle):
    shown = []

    def watch(name: str, view: bool, record: Path | None) -> Any:
        shown.append((name, view, record))
        return run_viewer(name, view=False, record=None)

    trials = tuple(demo._Trial(name, None, str(made / "walk"), True) for name in ("one", "other"))
    study = demo._Study("a walk", str(made / "walk"), "::", "none", {}, trials)
    monkeypatch.setattr(demo, "_embedded", lambda: study)
    monkeypatch.setattr(demo, "_build", lambda *_: read_bundle(made / "room.monoloc"))
    monkeypatch.setattr(demo, "check_viewing", lambda view: None)
    monkeypatch.setattr(demo, "run_viewer", watch)
    assert invoke(["demo", "--out", str(tmp_path / "out"), "--view", "--json"]) == 0
    assert shown == [("one", True, None), ("other", True, None)]
