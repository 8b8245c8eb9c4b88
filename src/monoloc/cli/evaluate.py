"""``monoloc evaluate``: compare a trajectory with reference poses."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.cli.common import (
    FixDepthOption,
    FixPosesOption,
    FramesOption,
    JsonOption,
    open_source,
    print_figures,
    refuse_frames,
    warn,
)
from monoloc.cli.pose_warning import other_reading, warn_of_poses
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.trajectory import relative_pose_errors, summarise
from monoloc.geometry import FloatArray
from monoloc.io.pose_files import read_tum
from monoloc.io.pose_table import read_pose_table
from monoloc.io.registry import FORMATS
from monoloc.io.tum_recording import MAX_TIME_DIFFERENCE_S, mutual_nearest


def evaluate(
    trajectory: Annotated[
        Path,
        typer.Argument(
            metavar="TRAJECTORY",
            help="TUM trajectory (t tx ty tz qx qy qz qw), or .csv of localize or fly, without its lost frames.",
            show_default=False,
        ),
    ],
    truth: Annotated[
        str,
        typer.Argument(
            metavar="TRUTH", help="Reference: a recording with poses, or a TUM trajectory.", show_default=False
        ),
    ],
    frames: FramesOption = "::",
    fix_poses: FixPosesOption = None,
    fix_depth: FixDepthOption = None,
    json: JsonOption = False,
) -> None:
    """Compare a trajectory with reference poses, without alignment.

    Both are in the map's frame. A pose and a reference are compared if each is the nearest of the other in time,
    and within 0.02 s. Other poses count as unmatched, other references as missed.

    \b
    Examples:
      monoloc evaluate trajectory.txt 7scenes:redkitchen
      monoloc evaluate trajectory.csv groundtruth.txt --json
      monoloc evaluate trajectory.csv my-recording --fix-poses opengl
    """
    read = read_pose_table if trajectory.suffix.lower() == ".csv" else read_tum
    times, poses = read(trajectory)
    true_times, true_poses = _read_truth(truth, frames, fix_poses, fix_depth)
    partner = mutual_nearest(times, true_times)
    matched = partner >= 0
    if not matched.any():
        fix = "check that both use the same clock: fly stamps by its own, and by a recording's with --fast"
        if frames != "::":
            fix += "; and that --frames chooses frames of this trajectory"
        times_of, true_of = (f"{each[0]:.1f} to {each[-1]:.1f} s" for each in (times, true_times))
        problem = f"of {times_of}, has no pose within {MAX_TIME_DIFFERENCE_S} s of the truth's, of {true_of}"
        raise DataError(trajectory, problem, fix)
    estimated, true = poses[matched], true_poses[partner[matched]]
    metrics: dict[str, object] = {
        "frames": int(matched.sum()),
        "unmatched": int((~matched).sum()),
        "missed": len(true_times) - int(matched.sum()),
        **asdict(summarise(estimated, true)),
    }
    if len(estimated) > 1:
        relative = relative_pose_errors(estimated, true, 1)
        metrics["rpe_rmse_m"] = float(np.sqrt(np.mean(relative.position_m**2)))
        metrics["rpe_rot_rmse_deg"] = float(np.rad2deg(np.sqrt(np.mean(relative.rotation_rad**2))))
    fix = "convert them" if _is_trajectory(Path(truth)) else "give {}"
    if fix_poses is None and (other := other_reading(estimated, true, fix)) is not None:
        warn(trajectory, other)
    print_figures(f"{trajectory.name} against {truth}", metrics, json)


def _is_trajectory(path: Path) -> bool:
    return path.is_file() and path.suffix in {".txt", ".tum"}


def _read_truth(
    truth: str, frames: str, fix_poses: str | None, fix_depth: str | None
) -> tuple[FloatArray, FloatArray]:
    path = Path(truth)
    if _is_trajectory(path):
        refuse_frames(frames, "a trajectory")
        for option, fix in (("--fix-poses", fix_poses), ("--fix-depth", fix_depth)):
            if fix is not None:
                raise SettingError(option, "has no meaning for a trajectory", "leave it out")
        return read_tum(path)
    if path.is_file() and not any(known.recognises(path) for known in FORMATS.values()):
        fix = "name it NAME.txt if it is a TUM trajectory, or give a recording"
        raise DataError(path, "is not recognised as a truth", fix)
    recording = open_source(truth, frames, fix_poses=fix_poses, fix_depth=fix_depth)
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "give a recording or TUM trajectory that has them")
    warn_of_poses(recording)
    return recording.timestamps_s, recording.poses
