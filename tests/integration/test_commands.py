"""Commands of mapping and localisation, end to end on a synthetic room."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import synthetic_recordings as synthetic
from cli_helpers import QUICK, UNTUNED, json_of, listing, outputs, refused, succeeds, write_workspace
from monoloc import __version__
from monoloc.bundle import digest_of, read_bundle, write_bundle
from monoloc.depth.models import shipped_file
from monoloc.evaluation.trajectory import pose_errors, summarise
from monoloc.geometry import se3_exp
from monoloc.io.pose_files import read_tum
from monoloc.io.tum_trajectory import write_tum
from monoloc.map.mixture import GaussianMixture
from synthetic_room import FRAME_RATE_HZ, SMALL_CAMERA, Room, RoomRecording, make_path, write_recording

FRAMES = 10
ACCURACY_KEYS = {
    "ate_rmse_m",
    "ate_median_m",
    "ate_max_m",
    "rot_rmse_deg",
    "rot_median_deg",
    "within_5cm_5deg",
    "within_10cm_10deg",
}
LOCALIZE_KEYS = ACCURACY_KEYS | {
    "frames",
    "lost_frames",
    "landmark_used_frames",
    "coverage_95",
    "coverage_99",
    "silent_frames_30cm",
    "silent_frames_3_5_sigma",
    "step_ms_median",
    "step_ms_p95",
    "particles",
    "scan_points",
    "motion",
    "depth_absrel",
    "depth_delta1",
    "depth_ssim",
}
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, recording: RoomRecording) -> Path:
    """A folder with a recording and a bundle built from every second frame of it."""
    folder = tmp_path_factory.mktemp("workspace")
    write_workspace(folder, recording)
    return folder


# --- Build ---


def test_build_then_localize(capfd: Capture, here: Path, recording: RoomRecording) -> None:
    """The bundle is written through a link."""
    (here / "x.monoloc").symlink_to("elsewhere.monoloc")
    report = json_of(capfd, "build", "flight", "--frames", "::2", "--out", "x.monoloc", *UNTUNED, "-k", "40")
    assert (here / "x.monoloc").is_symlink() and (here / "elsewhere.monoloc").is_dir()
    assert report["bundle"] == "x.monoloc" and report["components"] == 40 and report["frames"] == FRAMES // 2
    assert report["bytes"] == sum(file.stat().st_size for file in (here / "x.monoloc").iterdir())
    assert report["depth_scale"] is None and report["depth_shift"] is None
    assert report["kl"] == 0.0 and report["steps"] == 0 and report["shift_p95_m"] == 0.0
    assert report["pose_shift_median_m"] is None and report["pose_turn_median_deg"] is None
    bundle = read_bundle(here / "x.monoloc")
    provenance = bundle.provenance
    assert list(provenance.frames) == recording.frame_names[::2]
    assert provenance.tune == "none" and not provenance.map_transform
    assert provenance.down_world[1] > 0.97 and np.linalg.norm(provenance.down_world) == pytest.approx(1.0)
    assert np.median(Room().distance_m(bundle.adapted.means)) < 0.05
    assert report["landmarks"] == len(bundle.landmarks) > 50
    inspected = json_of(capfd, "inspect", "x.monoloc")
    assert inspected["landmarks"] == len(bundle.landmarks)
    assert inspected["landmark_bytes"] == bundle.landmarks.bytes > 44 * len(bundle.landmarks)
    assert inspected["settings"]["landmark_bias"]["sd_at_reference_m"] > 0.0
    metrics = json_of(capfd, "localize", "x.monoloc", "flight", "--start", "truth", "--out", "trajectory.txt")
    assert metrics["unseen_frames"] == FRAMES // 2 and metrics["landmark_used_frames"] == FRAMES
    assert metrics["ate_median_m"] < 0.03
    assert read_tum(here / "trajectory.txt")[1].shape == (FRAMES, 4, 4)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_build_refines_poses_stores_no_landmarks_and_tolerates_frames_without_depth(
    capfd: Capture, here: Path
) -> None:
    for index in (0, 6):
        synthetic.write_depth(here / f"flight/depth/{index:06d}.png", np.zeros((128, 160), dtype=np.uint16))
    build = ("build", "flight", "--frames", "::2", "--refine-poses", "--no-landmarks", "--out", "x.monoloc", *UNTUNED)
    report = json_of(capfd, *build, "-k", "40", "--network", "tiny-0.35-int8")
    assert report["frames"] == FRAMES // 2 and report["landmarks"] == 0
    assert "can only be run" not in str(report["warnings"])  # the options ask for no tuning
    assert 0.0 < report["pose_shift_median_m"] < 0.02 and 0.0 < report["pose_turn_median_deg"] < 1.0
    inspected = json_of(capfd, "inspect", "x.monoloc")
    assert inspected["landmarks"] == 0 and inspected["settings"]["landmark_bias"]["sd_at_reference_m"] == 0.0
    metrics = json_of(capfd, "localize", "x.monoloc", "flight", "--start", "truth", "--depth", "sensor")
    assert metrics["frames"] == FRAMES and metrics["landmark_used_frames"] == 0
    assert metrics["depth_absrel"] < 0.02


def test_settings_file_is_overridden_by_options_and_a_warning_names_a_network_that_is_not_tuned(
    capfd: Capture, here: Path
) -> None:
    (here / "s.toml").write_text("components = 25\nvoxel_m = 0.06\nlandmarks = false\n[localizer]\nparticles = 77\n")
    build = ("build", "flight", "--frames", "::2", "--out", "x.monoloc", "--network", "tiny-0.35-int8")
    _, err = outputs(capfd, *build, "--settings", "s.toml", "--landmarks")
    bundle = read_bundle(here / "x.monoloc")
    assert bundle.settings.particles == 77 and len(bundle.adapted) == 25 and len(bundle.landmarks) > 0
    assert bundle.provenance.tune == "none"
    remark = "tiny-0.35-int8 can only be run, so it was not tuned"
    advice = "; for a tuned network in 8 bits: --network tiny-0.35 --int8"
    assert f"warning: flight: {remark}{advice}\n" in err


def test_bundle_may_contain_its_network_in_8_bits(capfd: Capture, here: Path) -> None:
    report = json_of(capfd, "build", "flight", "--no-landmarks", *QUICK, "--out", "x.monoloc", "--int8")
    assert report["bytes"] < shipped_file("tiny-0.35").stat().st_size
    assert json_of(capfd, "inspect", "x.monoloc")["network"] == "tiny-0.35 in 8 bits"
    metrics = json_of(capfd, "localize", "x.monoloc", "flight", "--start", "truth", "--frames", "0:3")
    assert metrics["frames"] == 3 and metrics["depth_absrel"] < 1.0


# --- Localize and evaluate ---


def test_localize_gives_all_metrics_and_repeats(capfd: Capture, here: Path, recording: RoomRecording) -> None:
    command = ("localize", "room.monoloc", "flight", "--start", "truth", "--out", "trajectory.txt", "--seed")
    metrics = json_of(capfd, *command, "3")
    assert set(metrics) >= LOCALIZE_KEYS | {f"unseen_{key}" for key in ACCURACY_KEYS} | {"unseen_frames", "states"}
    assert metrics["frames"] == FRAMES and metrics["unseen_frames"] == FRAMES // 2
    options = {"bundle": "room.monoloc", "source": "flight", "seed": 3, "depth": "network"}
    options["digest"] = digest_of(here / "room.monoloc")
    assert {name: metrics[name] for name in options} == options
    assert metrics["motion"] == "visual" and metrics["particles"] == 600 and metrics["scan_points"] == 300
    assert sum(metrics["states"].values()) == FRAMES
    assert metrics["depth_absrel"] < 0.02 and metrics["depth_delta1"] > 0.98
    times, poses = read_tum(here / "trajectory.txt")
    assert np.allclose(times, recording.timestamps_s)
    assert recording.poses is not None
    expected = summarise(poses, recording.poses)
    for key in ACCURACY_KEYS:
        assert metrics[key] == pytest.approx(getattr(expected, key), abs=1e-6)
    # From a start 10 cm off, by predicted depth.
    assert metrics["ate_max_m"] < 0.15 and metrics["ate_median_m"] < 0.08
    succeeds(capfd, *command, "3", "--out", "trajectory.csv")
    for name in ("trajectory.txt", "trajectory.csv"):
        evaluated = json_of(capfd, "evaluate", name, "flight")
        assert evaluated["frames"] == FRAMES and evaluated["unmatched"] == evaluated["missed"] == 0
        for key in ACCURACY_KEYS:
            assert evaluated[key] == pytest.approx(metrics[key], abs=1e-6)
    first = (here / "trajectory.txt").read_bytes()
    succeeds(capfd, *command, "3")
    assert (here / "trajectory.txt").read_bytes() == first
    succeeds(capfd, *command, "4")
    assert (here / "trajectory.txt").read_bytes() != first


def test_localize_options_reach_the_filter(capfd: Capture, here: Path) -> None:
    options = ("--particles", "50", "--scan-points", "40", "--motion", "random-walk", "--frames", "0:6")
    metrics = json_of(capfd, "localize", "room.monoloc", "flight", "--start", "truth", *options)
    assert metrics["particles"] == 50 and metrics["scan_points"] == 40 and metrics["motion"] == "random-walk"
    assert metrics["frames"] == 6
    assert "odometry_ate_rmse_m" not in metrics


def test_parts_are_left_out_of_a_flight(capfd: Capture, here: Path) -> None:
    command = ("localize", "room.monoloc", "flight", "--start", "truth")
    whole = json_of(capfd, *command)
    metrics = json_of(capfd, *command, "--without", "odometry,bias")
    assert metrics["without"] == [*whole["without"], "odometry", "bias"]
    assert (whole["motion"], metrics["motion"]) == ("visual", "random-walk")
    assert "odometry_ate_rmse_m" not in metrics and metrics["ate_rmse_m"] != whole["ate_rmse_m"]


def test_localize_takes_the_motion_of_other_sensors(capfd: Capture, here: Path, recording: RoomRecording) -> None:
    """A random walk: without the odometry's file there would be no motion at all."""
    assert recording.poses is not None
    write_tum(here / "wheels.txt", recording.timestamps_s + 0.02, recording.poses)
    localize = ("localize", "room.monoloc", "flight", "--start", "truth", "--motion", "random-walk")
    metrics = json_of(capfd, *localize, "--odometry", "wheels.txt", "--odometry-delay", "0.02")
    assert metrics["odometry_ate_rmse_m"] < 0.001
    turned = se3_exp([0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2.0])
    write_tum(here / "turned.txt", recording.timestamps_s, recording.poses @ turned)
    visual = ("localize", "room.monoloc", "flight", "--start", "truth", "--odometry")
    assert json_of(capfd, *visual, "turned.txt")["motion_contradicted_frames"] > 0.5 * metrics["frames"]
    assert json_of(capfd, *visual, "wheels.txt", "--odometry-delay", "0.02")["motion_contradicted_frames"] == 0
    problem, fix = "gives no motion between frames", "bring its time stamps to the clock of the frames"
    write_tum(here / "wheels.txt", recording.timestamps_s + 100.0, recording.poses)
    refused(capfd, here, [*localize, "--odometry", "wheels.txt"], "wheels.txt", problem, fix)


def test_localize_a_video_from_a_given_start(capfd: Capture, here: Path, recording: RoomRecording) -> None:
    writer = cv2.VideoWriter("flight.avi", cv2.VideoWriter.fourcc(*"MJPG"), 15.0, (160, 128))
    for index in range(6):
        writer.write(recording.color(index)[..., ::-1])
    writer.release()
    assert recording.poses is not None
    line = synthetic.tum_lines(np.zeros(1), recording.poses[:1]).splitlines()[1]
    start, camera = ",".join(line.split()[1:]), ("--intrinsics", "160,128,136,136,79.5,63.5")
    command = ("localize", "room.monoloc", "flight.avi", "--start", start, *camera, "--out", "trajectory.txt")
    metrics = json_of(capfd, *command)
    assert metrics["frames"] == 6
    assert not any(key.startswith(("ate", "unseen_ate", "coverage")) for key in metrics)
    first = read_tum(here / "trajectory.txt")[1][0, :3, 3]
    assert np.linalg.norm(first - recording.poses[0, :3, 3]) < 0.2


def test_localize_searches_the_room_where_no_start_is_known(capfd: Capture, here: Path) -> None:
    """Neither a start nor a true pose is given."""
    flight = RoomRecording(Room(), make_path(24), SMALL_CAMERA)
    write_recording(here / "long", flight)
    description = here / "long" / "dataset.toml"
    description.write_text(description.read_text().replace('poses = "poses.txt"', f"rate_hz = {FRAME_RATE_HZ}"))
    metrics = json_of(capfd, "localize", "room.monoloc", "long", "--out", "trajectory.txt")
    verified_after = metrics["states"]["lost"]
    assert round(FRAME_RATE_HZ) <= verified_after < 20  # no pose is claimed during a second of verification
    assert flight.poses is not None
    times_s, poses = read_tum(here / "trajectory.txt")
    np.testing.assert_allclose(times_s, flight.timestamps_s[verified_after:], atol=1e-6)
    errors = pose_errors(poses, flight.poses[verified_after:])
    assert errors.position_m.max() < 0.1


def test_unknown_start_is_refused_where_nothing_can_find_the_camera(capfd: Capture, here: Path) -> None:
    room = read_bundle(here / "room.monoloc")
    precise = room.sensor.model_copy(update={"search_precision": 0.9})
    integrity = room.integrity.model_copy(update={"scan_search_precision": 0.1})
    write_bundle(here / "room.monoloc", replace(room, integrity=integrity, sensor=precise))
    command = ("localize", "room.monoloc", "flight", "--start", "unknown", "--out", "trajectory.txt")
    problem = "is unknown, and neither scans nor landmarks can find the camera in this room"
    fix = "write TX,TY,TZ,QX,QY,QZ,QW, or truth for the recording's first pose"
    refused(capfd, here, command, "--start", problem, fix)
    description = here / "flight" / "dataset.toml"
    posed = description.read_text()
    description.write_text(posed.replace('poses = "poses.txt"', f"rate_hz = {FRAME_RATE_HZ}"))
    by_truth = (*command, "--start", "truth")
    refused(capfd, here, by_truth, "--start", "is truth, but the recording has no poses", "or unknown")
    description.write_text(posed)
    by_sensor = json_of(capfd, *command, "--depth", "sensor")
    assert by_sensor["depth"] == "sensor" and by_sensor["frames"] == FRAMES
    assert "odometry_ate_rmse_m" in by_sensor and "odometry_from_start_ate_rmse_m" not in by_sensor


def test_localize_prints_a_table_and_draws_a_plot(capfd: Capture, here: Path) -> None:
    (here / "[kitchen]").mkdir()
    path = "[kitchen]/:a:.txt"
    command = ("localize", "room.monoloc", "flight", "--start", "truth", "--out", path, "--plot", "plot.png")
    out, err = outputs(capfd, *command)
    assert re.search(r"all .* cm .*°.* %.* %", out) and "unseen" in out and "coverage" in out
    picture = cv2.imread("plot.png")
    assert picture is not None and min(picture.shape[:2]) > 300
    assert f"written: {path}\n" in err
    assert re.search(rf"{FRAMES} frames: \d+ tracking, \d+ uncertain, \d+ lost, 0 map-changed; ", err)


# --- Maps ---


def test_map_fit_and_info(capfd: Capture, here: Path) -> None:
    fitted = json_of(capfd, "map", "fit", "flight", "--out", "room.npz", "-k", "30")
    mixture = GaussianMixture.load(here / "room.npz")
    assert fitted["components"] == len(mixture) == 30 and fitted["bytes"] == 1200
    info = json_of(capfd, "map", "info", "room.npz")
    assert info["components"] == 30 and info["bytes"] == 1200
    assert np.all(info["lower_m"] < mixture.means.min(axis=0)) and np.all(info["upper_m"] > mixture.means.max(axis=0))
    assert np.all(info["lower_m"] > np.array([-2.5, -1.4, -2.0]) - 0.5)
    assert np.all(info["upper_m"] < np.array([2.5, 1.2, 3.0]) + 0.5)
    assert 0.0 < info["thickness_median_m"] < 0.05 < info["length_median_m"]
    assert json_of(capfd, "map", "info", "room.monoloc")["components"] == 250
    np.savetxt(here / "room.xyz", Room().cloud(0.1), fmt="%.4f")
    of_cloud = json_of(capfd, "map", "fit", "room.xyz", "--out", "cloud.npz", "-k", "20")
    assert of_cloud["components"] == 20
    shutil.copy(here / "room.xyz", here / "room.txt")
    assert json_of(capfd, "map", "fit", "room.txt", "--out", "cloud.npz", "-k", "20") == of_cloud


@pytest.mark.slow
def test_map_compare(capfd: Capture, here: Path) -> None:
    """A map that did not change, and one that is 5 cm from its original."""
    same = json_of(capfd, "map", "compare", "room.monoloc")
    assert same["c2c_max_m"] < 1e-6 and same["correspondence_share"] == 1.0 and same["shift_median_m"] == 0.0
    np.testing.assert_allclose(same["box_original_m"]["lower"], [-2.5, -1.4, -2.0], atol=0.6)
    np.testing.assert_allclose(same["box_adapted_m"]["upper"], [2.5, 1.2, 3.0], atol=0.6)
    assert (here / same["picture"]).read_bytes().startswith(b"\x89PNG")
    bundle = read_bundle(here / "room.monoloc")
    shifted = replace(bundle.original, means=bundle.original.means + np.array([0.03, 0.0, 0.04]))
    write_bundle(here / "shifted.monoloc", replace(bundle, adapted=shifted))
    change = json_of(capfd, "map", "compare", "shifted.monoloc", "--out", "shifted.png")
    assert (here / "shifted.png").is_file()
    assert change["shift_median_m"] == pytest.approx(0.05, abs=1e-4)
    assert 0.01 < change["c2c_median_m"] < change["c2c_p95_m"] < change["c2c_max_m"] <= 0.05 + 1e-6
    shift = np.subtract(change["box_adapted_m"]["lower"], change["box_original_m"]["lower"])
    np.testing.assert_allclose(shift, [0.03, 0.0, 0.04], atol=1e-5)


def test_inspect_a_bundle(capfd: Capture, here: Path) -> None:
    content = json_of(capfd, "inspect", "room.monoloc")
    assert content["kind"] == "bundle" and content["components"] == 250 and content["frames"] == FRAMES // 2
    assert content["map_bytes"] == 250 * 40
    assert content["bytes"] == sum(file.stat().st_size for file in (here / "room.monoloc").iterdir())
    assert np.allclose(content["size_m"], [5.0, 2.6, 5.0], atol=0.6)
    assert content["monoloc_version"] == __version__
    assert content["image"] == [160, 128] and content["intrinsics"] == [136.0, 136.0, 79.5, 63.5]
    assert content["distortion"] == [0.0] * 5
    assert content["known_bias_m"] is None and content["known_bias_deg"] is None
    bundle = read_bundle(here / "room.monoloc")
    bias = np.zeros((len(bundle.reference_poses), 6))
    bias[::2] = [0.03, 0.0, -0.04, 0.0, np.deg2rad(2.0), 0.0]
    known = replace(bundle.reference_poses, forward_bias=bias, backward_bias=bias)
    write_bundle(here / "known.monoloc", replace(bundle, reference_poses=known))
    content = json_of(capfd, "inspect", "known.monoloc")
    share = np.sqrt(np.mean(np.arange(len(bias)) % 2 == 0))
    # A screw's translation is its twist's to first order.
    assert content["known_bias_m"] == pytest.approx(0.05 * share, rel=0.01)
    assert content["known_bias_deg"] == pytest.approx(2.0 * share, rel=1e-6)


# --- Outputs ---


def test_outputs_are_written_through_links_and_replaced(capfd: Capture, here: Path) -> None:
    (here / "elsewhere").mkdir()
    for name in ("trajectory.txt", "trajectory.rrd"):
        (here / name).symlink_to(here / "elsewhere" / name)
    (here / "elsewhere" / "trajectory.txt").write_text("older")
    command = ("localize", "room.monoloc", "flight", "--start", "truth", "--frames", "0:4")
    succeeds(capfd, *command, "--out", "trajectory.txt", "--record", "trajectory.rrd")
    assert all((here / name).is_symlink() for name in ("trajectory.txt", "trajectory.rrd"))
    assert len(read_tum(here / "elsewhere" / "trajectory.txt")[0]) == 4
    assert sorted(listing(here / "elsewhere")) == ["trajectory.rrd", "trajectory.txt"]
