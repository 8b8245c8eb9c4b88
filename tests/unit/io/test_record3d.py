"""Record3D's .r3d files, zipped and unpacked, and what may be wrong with them."""

from __future__ import annotations

import json
import pickle
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture_writers import (
    HIGH,
    Capture,
    check_opened,
    confidence_of,
    doubled,
    halved,
    record3d_members,
    write_record3d,
)
from monoloc.errors import MissingExtraError
from monoloc.io.record3d import UNKNOWN_UPRIGHT
from monoloc.io.registry import open_recording
from monoloc.io.stray_scanner import NO_CONFIDENCE
from refusals import refuses, refuses_data, refuses_to_open
from synthetic_recordings import check_recording

lzfse = pytest.importorskip("lzfse")


def from_first_pose(capture: Capture) -> Capture:
    """In Record3D's world, whose axes are those of the first camera, y up."""
    arkit_from_opencv = np.diag([1.0, -1.0, -1.0, 1.0])
    T_world_first = capture.poses[0] @ arkit_from_opencv
    return replace(capture, poses=np.linalg.inv(T_world_first) @ capture.poses)


def certain_depths_mm(capture: Capture) -> list[np.ndarray]:
    kept = [np.where(confidence_of(halved(each)) == HIGH, halved(each), 0) for each in capture.depths_mm]
    for each in kept:
        each[0, 0] = 0  # stored as NaN
    return [doubled(each) for each in kept]


@pytest.fixture
def members(capture: Capture) -> dict[str, bytes]:
    return record3d_members(capture)


@pytest.mark.parametrize("unpacked", [False, True])
def test_recording_opens(tmp_path: Path, capture: Capture, members: dict[str, bytes], unpacked: bool) -> None:
    path = tmp_path / ("walk" if unpacked else "walk.r3d")
    write_record3d(path, members, unpacked)
    recording = open_recording(str(path))
    check_recording(recording, len(capture))
    check_opened(recording, from_first_pose(capture), certain_depths_mm(capture))
    np.testing.assert_array_equal(recording.timestamps_s, capture.times_s)
    assert recording.camera == capture.camera and recording.name == "walk" and recording.notes == [UNKNOWN_UPRIGHT]


def test_recording_that_was_packed_again_with_its_folder_opens(tmp_path: Path, members: dict[str, bytes]) -> None:
    """As the Finder packs one, with a file of its own beside each."""
    packed = {f"walk/{name}": content for name, content in members.items()}
    write_record3d(tmp_path / "walk.r3d", packed | {f"__MACOSX/walk/._{name}": b"" for name in ("metadata", "icon")})
    recording = open_recording(str(tmp_path / "walk.r3d"))
    assert len(recording) == 12 and recording.has_depth
    assert recording.color(3).shape == (128, 160, 3) and recording.depth(3).any()


def test_archive_is_opened_once_by_each_process(
    tmp_path: Path, members: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording of minutes has a list of 27 000 members, which was read for each image: 0.3 s."""
    write_record3d(tmp_path / "walk.r3d", members)
    opened, archive = [], zipfile.ZipFile

    def counted(path: Path) -> zipfile.ZipFile:
        opened.append(path)
        return archive(path)

    monkeypatch.setattr(zipfile, "ZipFile", counted)
    recording = open_recording(str(tmp_path / "walk.r3d"))
    expected = [recording.color(index).sum() for index in range(12)]
    assert recording.depth(3).any() and len(opened) == 1
    other = pickle.loads(pickle.dumps(recording))  # as one that another process is given
    assert [other.color(index).sum() for index in range(12)] == expected and len(opened) == 2


def test_early_recording_has_neither_times_nor_confidence(tmp_path: Path, capture: Capture) -> None:
    members = {name: content for name, content in record3d_members(capture).items() if not name.endswith(".conf")}
    metadata = json.loads(members["metadata"])
    del metadata["frameTimestamps"]
    members["metadata"] = json.dumps(metadata).encode()
    write_record3d(tmp_path / "walk.r3d", members)
    recording = open_recording(str(tmp_path / "walk.r3d"))
    np.testing.assert_allclose(recording.timestamps_s, np.arange(12) / 10.0)
    assert (recording.depth(3)[1:, 2:] > 0.0).all()
    assert recording.notes == [UNKNOWN_UPRIGHT, NO_CONFIDENCE]


def test_image_without_confidence_is_left_out_where_others_have_it(tmp_path: Path, capture: Capture) -> None:
    members = record3d_members(capture)
    del members["rgbd/3.conf"]
    write_record3d(tmp_path / "walk.r3d", members)
    notes = open_recording(str(tmp_path / "walk.r3d")).notes
    assert notes[1:] == ["1 of 12 frames are left out: 1 without confidence"]


def test_images_of_other_focal_lengths_are_rendered_as_one_camera_sees_them(tmp_path: Path, capture: Capture) -> None:
    """A focal length 2 % longer shows the room 2 % larger; one of another lens is left out."""
    factors = [1.0] * 8 + [1.02] * 3 + [2.0]
    write_record3d(tmp_path / "walk.r3d", record3d_members(capture, factors))
    recording = open_recording(str(tmp_path / "walk.r3d"))
    assert recording.camera == capture.camera and len(recording) == 11
    assert recording.notes[1:] == ["1 of 12 frames are left out: 1 of another image size or lens"]
    v, u = np.mgrid[10:118:9, 10:150:7]
    x, y = (u - 75.5) * 1.02 + 75.5, (v - 66.0) * 1.02 + 66.0
    plain = [np.where(confidence_of(halved(each)) == HIGH, halved(each), 0) for each in capture.depths_mm]
    for index in (8, 10):
        stored = capture.colors[index][np.rint(y).astype(int), np.rint(x).astype(int)].astype(float)
        assert np.abs(recording.color(index)[v, u] - stored).mean() < 5.0
        depth_mm = doubled(plain[index])[np.rint(y).astype(int), np.rint(x).astype(int)]
        np.testing.assert_allclose(recording.depth(index)[v, u], depth_mm / 1000.0, atol=1e-6)
    stored = capture.colors[0][v, u].astype(float)
    assert np.abs(recording.color(0)[v, u] - stored).mean() < 5.0


def test_incomplete_frames_are_counted(tmp_path: Path, members: dict[str, bytes]) -> None:
    for name in ("rgbd/3.jpg", "rgbd/7.depth"):
        del members[name]
    write_record3d(tmp_path / "walk.r3d", members)
    recording = open_recording(str(tmp_path / "walk.r3d"))
    assert len(recording) == 10 and "000007" not in recording.frame_names
    assert recording.notes[1:] == ["2 of 12 frames are left out: 1 without an image, 1 without depth"]


def test_recording_without_depth(tmp_path: Path, members: dict[str, bytes], capture: Capture) -> None:
    path = tmp_path / "walk.r3d"
    write_record3d(path, {name: each for name, each in members.items() if "." not in name or "jpg" in name})
    recording = open_recording(str(path))
    check_opened(recording, from_first_pose(capture), None)
    refuses_data(lambda: recording.depth(0), path, "has no depth", "LiDAR")


def test_missing_decoder_is_named(tmp_path: Path, members: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    write_record3d(tmp_path / "walk.r3d", members)
    monkeypatch.setitem(sys.modules, "lzfse", None)
    refuses(lambda: open_recording(str(tmp_path / "walk.r3d")), MissingExtraError, r'"record3d".*pip install')


def changed(key: str, value: Any) -> Callable[[dict[str, Any]], object]:
    return lambda metadata: metadata.update({key: value})


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (changed("poses", "many"), "poses is not a list of 7 numbers each"),
        (changed("poses", [[0.0] * 7] * 12), "pose 1 is not rigid"),
        (changed("frameTimestamps", [0.0]), "frameTimestamps are not the 12 numbers"),
        (changed("frameTimestamps", ["now"] * 12), "frameTimestamps are not the 12 numbers"),
        (changed("frameTimestamps", [0.0] * 12), "the time stamp of entry 2 does not increase"),
        (changed("frameTimestamps", [10**400] * 12), "frameTimestamps are not the 12 numbers"),
        (lambda metadata: metadata.update(frameTimestamps=None, fps=1e-320), "fps is .*, the rate of no camera"),
        (changed("K", None), "K is not a list of 9 numbers"),
        (changed("K", [-1.0] * 9), "camera.fx/fy: is"),
        (changed("w", "160"), "w is '160', not a number"),
        (changed("h", 0), "h is 0.0, not an image size"),
        (changed("perFrameIntrinsicCoeffs", [[1.0]]), "perFrameIntrinsicCoeffs is not a list of 4 numbers"),
        (
            changed("perFrameIntrinsicCoeffs", [[136.0, 138.0, 75.5, 66.0]]),
            "perFrameIntrinsicCoeffs has 1 rows for 12 poses",
        ),
    ],
)
def test_malformed_metadata_is_refused(
    tmp_path: Path, members: dict[str, bytes], change: Callable[[dict[str, Any]], object], problem: str
) -> None:
    metadata = json.loads(members["metadata"])
    change(metadata)
    members["metadata"] = json.dumps(metadata).encode()
    path = tmp_path / "walk.r3d"
    write_record3d(path, members)
    refuses_to_open(path, path / "metadata", problem, "")


@pytest.mark.parametrize(("text", "problem"), [("{", "is not valid JSON"), ("[]", "is not a JSON object")])
def test_metadata_that_is_no_object_is_refused(
    tmp_path: Path, members: dict[str, bytes], text: str, problem: str
) -> None:
    write_record3d(tmp_path / "walk.r3d", members | {"metadata": text.encode()})
    refuses_to_open(tmp_path / "walk.r3d", tmp_path / "walk.r3d/metadata", problem, "export the recording again")


def test_damaged_archive_is_refused(tmp_path: Path, members: dict[str, bytes]) -> None:
    path = tmp_path / "walk.r3d"
    path.write_bytes(b"no zip")
    refuses_to_open(path, path, "cannot be read as a .r3d archive", "export the .r3d")
    path.unlink()
    write_record3d(path, {"other": b""})
    refuses_to_open(path, path, "has no metadata", "again")
    refuses_data(lambda: open_recording(f"record3d:{tmp_path}/no.r3d"), tmp_path / "no.r3d", "is missing", "unpacked")
    path.unlink()
    write_record3d(path, members)
    data = bytearray(path.read_bytes())
    at = data.index(members["rgbd/4.jpg"])
    data[at + 100 : at + 200] = bytes(100)
    path.write_bytes(data)
    recording = open_recording(str(path))
    refuses_data(lambda: recording.color(4), path / "rgbd/4.jpg", "cannot be unpacked", "copy the .r3d")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"not compressed", "cannot be decompressed"),
        (lzfse.compress(bytes(100)), "holds 100 bytes, but the metadata's 80x64 pixels are 20480"),
        (bytes(30_000), "holds 30000 bytes for 80x64 pixels"),
    ],
)
def test_damaged_depth_is_refused(tmp_path: Path, members: dict[str, bytes], content: bytes, problem: str) -> None:
    write_record3d(tmp_path / "walk.r3d", members | {"rgbd/5.depth": content})
    recording = open_recording(str(tmp_path / "walk.r3d"))
    refuses_data(lambda: recording.depth(5), tmp_path / "walk.r3d/rgbd/5.depth", problem, "export the .r3d")


def test_member_that_claims_too_much_is_not_unpacked(
    tmp_path: Path, members: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monoloc.io.record3d._MOST_BYTES", 30_000)
    write_record3d(tmp_path / "walk.r3d", members | {"rgbd/5.jpg": bytes(30_001)})
    recording = open_recording(str(tmp_path / "walk.r3d"))
    refuses_data(lambda: recording.color(5), tmp_path / "walk.r3d/rgbd/5.jpg", "says it is 0 MB", "again")


def test_damaged_or_encrypted_member_is_refused(tmp_path: Path, members: dict[str, bytes]) -> None:
    """Damage to compressed data, and the bit of an encrypted member in both of its headers (APPNOTE 4.4.4)."""
    path, member = tmp_path / "walk.r3d", "rgbd/4.jpg"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, content)
        info = file.getinfo(member)
    whole = path.read_bytes()
    begin = info.header_offset + 30 + len(member)
    damaged = whole[:begin] + b"\xff" * 40 + whole[begin + 40 :]
    central = whole.index(member.encode(), begin) - 46
    encrypted = bytearray(whole)
    encrypted[info.header_offset + 6] |= 1
    encrypted[central + 8] |= 1
    for content in (damaged, bytes(encrypted)):
        path.write_bytes(content)
        recording = open_recording(str(path))
        refuses_data(lambda read=recording: read.color(4), path / member, "cannot be unpacked", "copy the .r3d")
