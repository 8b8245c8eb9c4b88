"""Maps from colour images alone beside maps from depth and poses, flown over frames that come after them.

    python benchmarks/video_map.py SOURCE BUILD FLIGHT [--seeds N] [--flights N] >> figures.jsonl

For each seed, three bundles are built from the frames BUILD: from depth and poses, and from the colour images with
the scale by ten depth frames and by the network. Each flies over FLIGHT from starts 10 cm and 3 degrees beside the
truth. Prints one JSON object a bundle. Nothing is tuned. The true poses are brought into a reconstructed map by the
similarity that fits those of its keyframes, and errors are given in the true metres.
"""

from __future__ import annotations

import argparse
import json

import cv2
import numpy as np

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle
from monoloc.config import override
from monoloc.geometry import FloatArray, nearest_rotation, rotation_angle
from monoloc.io.corrected import with_poses
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording, select_frames
from monoloc.progress import NoProgress
from monoloc.run import localize
from monoloc.start import Start
from monoloc.structure_from_motion.depth_scale import DepthScale, NetworkScale
from monoloc.structure_from_motion.metric_scale import ScaleSource
from monoloc.structure_from_motion.reconstruction import reconstruct

UNTUNED = override(BuildConfig(), adapt={"tune": "none", "map_transform": False})


class Similarity:
    """``x -> s R x + t`` from the world of the true poses to that of a map; the identity without keyframes."""

    def __init__(self, truth: FloatArray | None = None, poses: FloatArray | None = None) -> None:
        self.scale, self.R, self.t = 1.0, np.eye(3), np.zeros(3)
        if truth is None or poses is None:
            return
        self.R = nearest_rotation(np.einsum("nij,nkj->ik", poses[:, :3, :3], truth[:, :3, :3]))
        away, near = truth[:, :3, 3] - truth[:, :3, 3].mean(0), poses[:, :3, 3] - poses[:, :3, 3].mean(0)
        self.scale = float(np.sum(near * (away @ self.R.T)) / np.sum(away**2))
        self.t = poses[:, :3, 3].mean(0) - self.scale * self.R @ truth[:, :3, 3].mean(0)

    def __call__(self, poses: FloatArray) -> FloatArray:
        moved = np.tile(np.eye(4), (len(poses), 1, 1))
        moved[:, :3, :3] = self.R @ poses[:, :3, :3]
        moved[:, :3, 3] = self.scale * poses[:, :3, 3] @ self.R.T + self.t
        return moved


def fly(bundle: Bundle, recording: Recording, to_map: Similarity, flights: int) -> dict[str, object]:
    """Errors of flights: median and RMSE of position and rotation, the median over the flights."""
    assert recording.poses is not None
    moved = with_poses(recording, to_map(recording.poses))
    assert moved.poses is not None
    rows = []
    for flight in range(flights):
        rng = np.random.default_rng(flight)
        run = localize(bundle, moved, Start.disturbed(moved.poses[0], rng), rng, NoProgress())
        figures = run.metrics()
        names = ("ate_median_m", "ate_rmse_m", "rot_median_deg", "coverage_95")
        rows.append([float(str(figures[name])) for name in names])
    median_m, rmse_m, rotation_deg, coverage = np.median(rows, axis=0)
    return {
        "median_m": median_m / to_map.scale,
        "rmse_m": rmse_m / to_map.scale,
        "rotation_median_deg": rotation_deg,
        "coverage_95": coverage,
    }


def from_colour(recording: Recording, scale: ScaleSource, seed: int) -> tuple[Bundle, Similarity, dict[str, object]]:
    """A bundle from colour images, how true poses come into its map, and errors of the reconstruction."""
    found = reconstruct(recording, scale, refine_camera=False, seed=seed)
    assert recording.poses is not None
    truth, poses = recording.poses[found.model.frames], found.model.poses
    to_map = Similarity(truth, poses)
    moved = to_map(truth)
    errors = {
        "keyframes": len(poses),
        "keyframe_median_m": np.median(np.linalg.norm(moved[:, :3, 3] - poses[:, :3, 3], axis=1)) / to_map.scale,
        "keyframe_rotation_median_deg": np.rad2deg(
            np.median(rotation_angle(np.swapaxes(moved[:, :3, :3], 1, 2) @ poses[:, :3, :3]))
        ),
        "scale_error": to_map.scale - 1.0,
        "scale_sd": found.recording.scale_sd,
    }
    return build_bundle(found.recording, UNTUNED, seed, NoProgress())[0], to_map, errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source")
    parser.add_argument("build", help="frames START:STOP:STEP")
    parser.add_argument("flight", help="frames START:STOP:STEP")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--flights", type=int, default=3)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    recording = open_recording(arguments.source)
    build, flight = (select_frames(recording, frames) for frames in (arguments.build, arguments.flight))
    for seed in range(arguments.seeds):
        bundle, _ = build_bundle(build, UNTUNED, seed, NoProgress())
        kinds = {"depth and poses": (bundle, Similarity(), {})}
        for name, scale in (("colour, scale by depth", DepthScale()), ("colour, scale by network", NetworkScale())):
            kinds[name] = from_colour(build, scale, seed)
        for kind, (made, to_map, errors) in kinds.items():
            figures = fly(made, flight, to_map, arguments.flights)
            where = {"source": recording.name, "build": arguments.build, "flight": arguments.flight, "seed": seed}
            print(json.dumps(where | {"map": kind} | figures | errors, default=float), flush=True)


if __name__ == "__main__":
    main()
