"""ORB and SIFT keypoints with PnP, image by image, beside the flights of a recording.

    python benchmarks/keypoints.py ROOM SOURCE BUILT_FROM SCORED ...

Prints a row of CSV for each kind and each selection of frames that is scored. Errors are those of the images that
give a pose; the others are counted.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import cv2
import numpy as np
from rendered_flights import print_table

from monoloc.geometry import invert, rotation_angle
from monoloc.io.registry import open_recording, select_frames
from monoloc.progress import NoProgress
from monoloc_lab.baselines.keypoints import KeypointConfig, KeypointLocalizer, build_keypoint_map
from monoloc_lab.baselines.pose_run import localize_all


def rows(room: str, source: str, built_from: str, *scored: str) -> Iterator[dict[str, object]]:
    recording = open_recording(source)
    for config in (KeypointConfig(kind="orb"), KeypointConfig(kind="sift")):
        keypoints = build_keypoint_map(select_frames(recording, built_from), config, NoProgress())
        for frames in scored:
            images = select_frames(recording, frames)
            pose_of = KeypointLocalizer(keypoints, images.camera, config)
            poses = localize_all(images, lambda color, _, pose_of=pose_of: pose_of(color), NoProgress()).poses
            found = np.isfinite(poses).all(axis=(1, 2))
            assert images.poses is not None
            offset = invert(images.poses[found]) @ poses[found]
            errors_cm = 100.0 * np.linalg.norm(offset[:, :3, 3], axis=1)
            yield {
                "room": room,
                "built_from": built_from,
                "scored": frames,
                "keypoints": config.kind,
                "megabytes": f"{1e-6 * keypoints.bytes:.1f}",
                "images": len(images),
                "without_pose": int((~found).sum()),
                "median_cm": f"{np.median(errors_cm):.2f}",
                "rmse_cm": f"{np.sqrt(np.mean(errors_cm**2)):.2f}",
                "rotation_median_deg": f"{np.rad2deg(np.median(rotation_angle(offset[:, :3, :3]))):.2f}",
            }


if __name__ == "__main__":
    cv2.setNumThreads(1)
    print_table(rows(*sys.argv[1:]))
