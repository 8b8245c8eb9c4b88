"""Every command on real frames, its numbers checked. A small build, not the real one: minutes are for benchmarks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cli_helpers import python
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pose_refinement import PosePrior, refine_poses
from monoloc.builder.room_map import fit_map
from monoloc.bundle import read_bundle
from monoloc.depth.model_files import read_model
from monoloc.depth.models import DEFAULT, shipped_file
from monoloc.depth.predictor import DepthPredictor
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import se3_exp
from monoloc.io.pose_files import read_tum
from monoloc.io.recording import Selection
from monoloc.io.registry import open_recording, select_frames
from monoloc.landmarks.pnp import OrbLandmarkLocalizer
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress

pytestmark = [pytest.mark.data, pytest.mark.slow]

BUILD_FRAMES, RUN_FRAMES = "0:200:8", "0:120"
# A tenth of the real build's steps, on a quarter of its frames.
QUICK_TOML = """\
components = 100
landmarks = false
[adapt]
steps = 60
synthesised_views = 25
batch_views = 8
"""
ACCURACY_KEYS = ("ate_rmse_m", "ate_median_m", "ate_max_m", "rot_rmse_deg", "rot_median_deg", "within_5cm_5deg")


def monoloc(*arguments: str | Path) -> dict[str, Any]:
    """The JSON of a command that must succeed, run as a person runs it."""
    result = python("from monoloc.cli.main import run; run()", *arguments, "--json")
    assert result.returncode == 0, result.stderr
    parsed = json.loads(result.stdout)
    assert isinstance(parsed, dict)
    return parsed


@pytest.fixture(scope="module")
def kitchen(data_root) -> str:
    folder = data_root / "7scenes" / "redkitchen"
    if not folder.is_dir():
        pytest.skip(f"no recording at {folder}")
    return f"7scenes:{folder}"


@pytest.fixture(scope="module")
def nyu(data_root) -> str:
    folder = data_root / "nyu-labelled"
    if not folder.is_dir():
        pytest.skip(f"no pairs at {folder}")
    return f"folder:{folder}"


@pytest.fixture(scope="module")
def here(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("kitchen")


@pytest.fixture(scope="module")
def plain(kitchen, here) -> tuple[Path, dict[str, Any]]:
    """A bundle whose network and map are as they were."""
    path = here / "plain.monoloc"
    options = ("--tune", "none", "--no-map-transform", "--no-landmarks", "-k", "100")
    return path, monoloc("build", kitchen, "--frames", BUILD_FRAMES, "--out", path, *options)


@pytest.fixture(scope="module")
def adapted(kitchen, here) -> tuple[Path, dict[str, Any]]:
    path, settings = here / "adapted.monoloc", here / "quick.toml"
    settings.write_text(QUICK_TOML)
    return path, monoloc("build", kitchen, "--frames", BUILD_FRAMES, "--out", path, "--settings", settings)


@pytest.fixture(scope="module")
def sensor_run(kitchen, plain, here) -> dict[str, Any]:
    options = ("--depth", "sensor", "--out", here / "sensor.txt", "--plot", here / "sensor.png")
    return monoloc("localize", plain[0], kitchen, "--frames", RUN_FRAMES, *options)


@pytest.fixture(scope="module")
def adapted_run(kitchen, adapted, here) -> dict[str, Any]:
    return monoloc("localize", adapted[0], kitchen, "--frames", RUN_FRAMES, "--out", here / "adapted.txt")


# --- build ---


def test_build_improves_depth_on_frames_it_did_not_tune_on(adapted):
    path, report = adapted
    assert report["frames"] == 25 and report["components"] == 100
    assert 20_000 < report["cloud_points"] < 80_000
    assert 0 < report["steps"] <= 60
    # 0.190 before, 0.169 after the thirty steps of its rehearsal; what all steps give is judged below.
    assert report["depth_absrel_after"] < report["depth_absrel_before"]
    assert report["nll_end"] < report["nll_start"]
    assert 0.0 < report["kl"] < 2.0
    # The map is bent by centimetres: it has not run away to make the depth look right.
    assert 0.001 < report["shift_median_m"] <= report["shift_p95_m"] < 0.15
    bundle = read_bundle(path)
    shift = np.linalg.norm(bundle.adapted.means - bundle.original.means, axis=1)
    assert np.median(shift) == pytest.approx(report["shift_median_m"], abs=1e-5)
    assert report["bytes"] < 4e6
    assert report["warnings"] == []


def test_build_without_adaptation_changes_nothing(plain):
    path, report = plain
    assert report["shift_p95_m"] == 0.0 and report["kl"] == 0.0 and report["steps"] == 0
    bundle = read_bundle(path)
    assert np.array_equal(bundle.adapted.means, bundle.original.means)


def test_build_is_repeatable(kitchen, plain, here):
    again = here / "again.monoloc"
    options = ("--tune", "none", "--no-map-transform", "--no-landmarks", "-k", "100")
    monoloc("build", kitchen, "--frames", BUILD_FRAMES, "--out", again, *options)
    first, second = read_bundle(plain[0]), read_bundle(again)
    assert np.array_equal(first.adapted.means, second.adapted.means)
    assert first.settings == second.settings and first.healthy == second.healthy


# --- localize, evaluate ---


def test_sensor_depth_follows_the_camera(sensor_run, here):
    """The upper bound: 2.3 to 2.6 cm and 1.0 to 1.1 degrees in the median over two seeds and two maps."""
    assert sensor_run["frames"] == 120 and sensor_run["unseen_frames"] == 105
    for prefix in ("", "unseen_"):
        assert sensor_run[f"{prefix}ate_median_m"] < 0.05
        assert sensor_run[f"{prefix}rot_median_deg"] < 2.5
    assert sensor_run["ate_max_m"] < 0.2
    assert sensor_run["lost_frames"] <= 12
    assert sensor_run["depth_absrel"] == pytest.approx(0.0, abs=1e-3)  # it is the truth it is compared with
    picture = cv2.imread(str(here / "sensor.png"))
    assert picture is not None and min(picture.shape[:2]) > 300


def test_odometry_alone_follows_for_a_while(sensor_run):
    # 1.9 m of way in 8 s; 6 cm in the median with depth of a sensor.
    assert sensor_run["odometry_ate_median_m"] < 0.15


def test_the_map_wins_over_odometry_from_the_same_start(sensor_run):
    """3 against 10 cm; with a network, the real build's figures are in benchmarks/reports."""
    assert sensor_run["ate_rmse_m"] < 0.5 * sensor_run["odometry_from_start_ate_rmse_m"]


def test_adapted_depth_beats_unadapted_depth_on_the_same_frames(kitchen, plain, adapted_run):
    unadapted = monoloc("depth", "evaluate", plain[0], kitchen, "--frames", "1:120:4")
    # 0.21 against 0.11, on frames beside those that were tuned on.
    assert unadapted["absrel"] > 0.15
    assert adapted_run["unseen_depth_absrel"] < 0.75 * unadapted["absrel"]
    assert adapted_run["unseen_depth_delta1"] > unadapted["delta1"]
    # So few steps do not give the real build's accuracy; they must not lose the camera either.
    assert adapted_run["ate_median_m"] < 0.5


def test_a_stretch_away_is_followed_about_as_well_as_by_odometry_alone(kitchen, adapted, here):
    """Where so little tuned a network errs most. Over three starts, 10 cm off, since one of them may be lucky.

    Eight builds of 60 and 160 steps gave 0.77 to 1.24, 1.00 together; the particles alone were at 1.63. That a whole
    build is never worse by more than a tenth is for the reports to show.
    """
    squares = []
    for seed in range(3):
        options = ("--frames", "200:300", "--seed", str(seed), "--out", here / f"away-{seed}.txt")
        run = monoloc("localize", adapted[0], kitchen, *options)
        squares.append([run["ate_rmse_m"] ** 2, run["odometry_from_start_ate_rmse_m"] ** 2])
    joined, odometry = np.sqrt(np.mean(squares, axis=0))
    assert joined < 1.4 * odometry


@pytest.fixture(scope="module")
def landmarked(kitchen, here) -> tuple[Path, dict[str, Any]]:
    """A network that nothing adapted, and landmarks of frames half a second apart."""
    path = here / "landmarked.monoloc"
    options = ("--tune", "none", "--no-map-transform", "-k", "100")
    return path, monoloc("build", kitchen, "--frames", BUILD_FRAMES, "--out", path, *options)


def test_landmarks_hold_the_camera_though_depth_is_a_fifth_off(kitchen, landmarked):
    """2.1 cm where nothing else has under 15; near errors are measured as about what they are."""
    path, report = landmarked
    assert 400 < report["landmarks"] < 2500
    run = monoloc("localize", path, kitchen, "--frames", RUN_FRAMES)
    assert run["depth_absrel"] > 0.15 and run["landmark_used_frames"] >= 110
    assert run["unseen_ate_median_m"] < 0.04 and run["unseen_rot_median_deg"] < 1.5
    assert run["unseen_ate_rmse_m"] < 0.3 * run["unseen_odometry_from_start_ate_rmse_m"]
    assert 0.003 < read_bundle(path).settings.sighted.sd_at_reference_m < 0.03


@pytest.mark.parametrize("frames", ["0:120", "100:220", "200:300", "300:400"])
def test_no_sequence_is_followed_worse_than_by_its_own_odometry(kitchen, landmarked, frames):
    """By more than a tenth, that is; with landmarks, though nothing adapted depth. It is 0.1 to 0.6 of it."""
    run = monoloc("localize", landmarked[0], kitchen, "--frames", frames)
    assert run["unseen_ate_rmse_m"] < 1.1 * run["unseen_odometry_from_start_ate_rmse_m"]


def test_landmarks_find_a_camera_of_which_nothing_is_known(kitchen, landmarked):
    """By images that built nothing, in usual light; a pose that is told is one of centimetres, or none is."""
    room, recording = read_bundle(landmarked[0]), open_recording(kitchen)
    sight, found = OrbLandmarkLocalizer(room.landmarks, recording.camera), []
    for index in range(4, 200, 16):
        sighting = sight.anywhere(recording.color(index))
        if sighting is not None:
            found.append(np.linalg.norm(sighting.pose[:3, 3] - recording.poses[index, :3, 3]))
    assert len(found) >= 10 and np.median(found) < 0.04 and max(found) < 0.3
    # And nowhere, where the room was never seen from: a part of the kitchen that lies behind.
    for index in range(320, 360, 10):
        sighting = sight.anywhere(recording.color(index))
        assert sighting is None or np.linalg.norm(sighting.pose[:3, 3] - recording.poses[index, :3, 3]) < 0.5


def test_golden_run_is_identical_for_the_same_seed(kitchen, adapted, here):
    trajectories = []
    for number, seed in enumerate((5, 5, 6)):
        out = here / f"golden-{number}.txt"
        monoloc("localize", adapted[0], kitchen, "--frames", "0:30", "--seed", str(seed), "--out", out)
        trajectories.append(out.read_bytes())
    assert trajectories[0] == trajectories[1]
    assert trajectories[0] != trajectories[2]


@pytest.mark.parametrize("name", ["sensor", "adapted"])
def test_evaluate_says_what_localize_said(request, kitchen, here, name):
    run = request.getfixturevalue(f"{name}_run")
    evaluated = monoloc("evaluate", here / f"{name}.txt", kitchen, "--frames", RUN_FRAMES)
    assert evaluated["frames"] == 120 and evaluated["unmatched"] == 0
    for key in ACCURACY_KEYS:
        assert evaluated[key] == pytest.approx(run[key], abs=1e-5)
    times, poses = read_tum(here / f"{name}.txt")
    assert np.all(np.diff(times) > 0.0) and poses.shape == (120, 4, 4)


# --- inspect, map ---


def test_inspect_the_recording(kitchen):
    content = monoloc("inspect", kitchen)
    assert content["frames"] == 400 and content["image"] == [640, 480]
    assert content["intrinsics"] == [525.5, 525.5, 320.0, 240.0]
    assert content["has_poses"] and content["has_depth"]
    assert 0.5 < content["depth_share"] < 1.0 and 1.0 < content["depth_median_m"] < 3.0
    assert 2.0 < content["path_m"] < 20.0 and content["seconds"] == pytest.approx(798 / 30, abs=0.1)


def test_inspect_the_bundle(plain):
    path, report = plain
    content = monoloc("inspect", path)
    assert content["components"] == 100 and content["map_bytes"] == 4000 and content["frames"] == 25
    assert content["bytes"] == report["bytes"]
    assert content["tune"] == "none" and content["recording"] == "redkitchen"
    assert all(1.0 < size < 12.0 for size in content["size_m"])


def test_map_fit_and_info(kitchen, here):
    path = here / "kitchen.npz"
    fitted = monoloc("map", "fit", kitchen, "--frames", "0:400:20", "--out", path, "-k", "60")
    assert fitted["components"] == 60 and fitted["bytes"] == 2400 and fitted["cloud_points"] > 10_000
    mixture = GaussianMixture.load(path)
    # Better than knowing only the box that the room lies in, by far.
    assert fitted["log_likelihood"] > -np.log(mixture.volume_m3) + 1.0
    info = monoloc("map", "info", path)
    assert info["components"] == 60
    size = np.array(info["upper_m"]) - np.array(info["lower_m"])
    assert np.all(size > 1.0) and np.all(size < 12.0)
    assert info["thickness_median_m"] < 0.3 * info["length_median_m"]  # surfaces, not balls


def test_map_compare(adapted, here):
    path, report = adapted
    content = monoloc("map", "compare", path, "--out", here / "compare.png")
    assert content["shift_median_m"] == pytest.approx(report["shift_median_m"], abs=1e-5)
    assert 0.0 < content["c2c_median_m"] < content["c2c_p95_m"] < content["c2c_max_m"] < 0.3
    assert content["correspondence_kept"] >= 0.95  # what the default penalty is there for
    size = np.subtract(content["box_original_m"]["upper"], content["box_original_m"]["lower"])
    assert np.all(size > 1.0) and np.all(size < 12.0)
    assert cv2.imread(str(here / "compare.png")) is not None


# --- Poses of another system ---


def test_noisy_poses_are_refined(kitchen):
    """2 cm and 1 degree per axis; over two draws 3.1 and 2.65 cm became 1.75 on average, and 1.45 degrees 0.7."""
    recording = select_frames(open_recording(kitchen), "0:200:4")
    rng = np.random.default_rng(0)
    prior = PosePrior(0.02, np.deg2rad(1.0))
    sd = np.repeat([prior.position_sd_m, prior.rotation_sd_rad], 3)
    noisy = Selection(recording, np.arange(len(recording)))
    noisy.poses = recording.poses @ se3_exp(rng.normal(scale=sd, size=(len(recording), 6)))

    def remap(moved):
        return fit_map(moved, None, BuildConfig(), rng, NoProgress())[1]

    refined = refine_poses(noisy, remap(noisy), remap, prior, rng)
    before, after = (pose_errors(r.poses, recording.poses) for r in (noisy, refined))
    assert np.median(after.position_m) < 0.8 * np.median(before.position_m)
    assert np.median(after.rotation_rad) < 0.7 * np.median(before.rotation_rad)


# --- depth ---


def test_depth_evaluate_on_pairs_it_was_not_trained_on(nyu, here):
    metrics = monoloc("depth", "evaluate", "full-0.35", nyu, "--frames", "1349::5", "--plot", here / "nyu.png")
    assert metrics["frames"] == 20 and metrics["scale"] == 1.0
    # Guessing the mean depth gives AbsRel 0.4 or more.
    assert metrics["absrel"] < 0.3 and metrics["delta1"] > 0.5
    assert metrics["rmse_m"] < 1.2
    assert cv2.imread(str(here / "nyu.png")) is not None


def test_depth_evaluate_fits_a_scale(kitchen):
    command = ("depth", "evaluate", "full-0.35", kitchen, "--frames", "0:400:40")
    as_is, fitted = monoloc(*command), monoloc(*command, "--fit-scale")
    assert as_is["frames"] == fitted["frames"] == 10
    assert 0.5 < fitted["scale"] < 2.0 and fitted["scale"] != 1.0
    assert fitted["delta1"] >= as_is["delta1"] - 0.05


def test_depth_export_gives_the_shipped_network(kitchen, here):
    out = here / "exported.onnx"
    report = monoloc("depth", "export", shipped_file(DEFAULT), "--out", out)
    assert report["bytes"] == out.stat().st_size and report["bytes"] < 3e6
    assert report["parity_mean"] <= report["parity_max"] < 1e-3
    command = ("depth", "evaluate", "full-0.35", kitchen, "--frames", "0:400:100")
    exported = ("depth", "evaluate", out, *command[3:])
    assert monoloc(*exported)["absrel"] == pytest.approx(monoloc(*command)["absrel"], rel=1e-3)


def test_depth_train_learns(nyu, data_root, here):
    encoder = data_root.parent / "weights" / "mobilenet_v2_0.35_imagenet.npz"
    if not encoder.is_file():
        pytest.skip(f"no weights at {encoder}")
    (here / "train.toml").write_text("batch_size = 8\nema_decay = 0.5\nlearning_rate = 0.004\n")
    out = here / "trained"
    options = ("--validate", "1349:1357", "--encoder", encoder, "--settings", here / "train.toml", "--epochs", "3")
    last = monoloc("depth", "train", nyu, "--frames", "0:1300:40", "--out", out, *options)
    history = json.loads((out / "history.json").read_text())
    assert len(history) == 3 and last["epoch"] == 2
    assert history[-1]["train_loss"] < history[0]["train_loss"]
    assert last["absrel"] == history[-1]["absrel"] < 1.0
    assert sorted(path.name for path in out.iterdir()) == [
        "curves.png",
        "history.json",
        "network.safetensors",
        "resume.pt",
    ]
    # What was written is what was judged.
    network = out / "network.safetensors"
    evaluated = monoloc("depth", "evaluate", network, nyu, "--frames", "1349:1357")
    assert evaluated["absrel"] == pytest.approx(last["absrel"], rel=0.1)
    exported = here / "trained.onnx"
    assert monoloc("depth", "export", network, "--out", exported)["parity_max"] < 1e-3
    recording = open_recording(nyu)
    depth = DepthPredictor(read_model(exported), recording.camera)(recording.color(1350)).depth_m
    assert np.all(depth > 0.1) and np.all(depth < 20.0)
