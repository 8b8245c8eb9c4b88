"""What it is worth to know which way is down: flights with a made-up flight controller's attitude, and without.

    python benchmarks/known_down.py room.monoloc folder:lab/monoloc_lab/rooms/living/test/L2 --down 0 0 -1

The attitude errs by half a degree an axis all flight long, and by 0.3 degrees anew in every frame.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from monoloc.bundle import read_bundle
from monoloc.cli.common import open_source
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, so3_exp
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start

_LASTING_RAD, _NOISE_RAD = np.deg2rad(0.5), np.deg2rad(0.3)


def measured(poses: FloatArray, down: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, 3) down in the frames of cameras (N, 4, 4), as a flight controller would have it."""
    errors = so3_exp(_LASTING_RAD * rng.normal(size=3) + _NOISE_RAD * rng.normal(size=(len(poses), 3)))
    return np.asarray(errors @ (down @ poses[:, :3, :3])[..., None])[..., 0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("source", help="recording with true poses")
    parser.add_argument("--frames", default="::")
    parser.add_argument("--down", type=float, nargs=3, help="in the recording's world; by default the map's")
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args()
    room, recording = read_bundle(arguments.bundle), open_source(arguments.source, arguments.frames)
    poses = recording.poses
    assert poses is not None and room.down is not None
    down = room.down if arguments.down is None else np.array(arguments.down)
    print(f"down by the map: {np.rad2deg(np.arccos(min(1.0, float(room.down @ down)))):.2f} degrees off")
    print("| down | median (seeds) | RMSE | rotation | coverage |\n|---|---|---|---|---|")
    for name in ("unknown", "known"):
        runs: list[Run] = []
        for seed in range(arguments.seeds):
            rng = np.random.default_rng(seed)
            start = Start.disturbed(poses[0], rng)
            seen = measured(poses, down, np.random.default_rng(seed)) if name == "known" else None
            runs.append(localize(room, recording, start, room.settings, rng, NoProgress(), down=seen))
        errors = [pose_errors(run.poses, poses) for run in runs]
        medians = 100.0 * np.array([np.median(e.position_m) for e in errors])
        rmse = 100.0 * np.median([np.sqrt(np.mean(e.position_m**2)) for e in errors])
        turned = np.rad2deg(np.median([np.median(e.rotation_rad) for e in errors]))
        covered = np.median([run.metrics()["coverage_95"] for run in runs])
        spread = f"{np.median(medians):.1f} cm ({medians.min():.1f}-{medians.max():.1f})"
        print(f"| {name} | {spread} | {rmse:.1f} cm | {turned:.1f}° | {covered:.2f} |", flush=True)


if __name__ == "__main__":
    main()
