"""Bundles: written whole or not at all, read only when nothing is missing or changed."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import ModelProto

from edit_helpers import bend
from map_helpers import make_mixture
from monoloc import bundle, bundle_manifest
from monoloc.bundle import (
    Bundle,
    CloudSize,
    Provenance,
    check_bytes,
    check_target,
    fingerprint,
    read_bundle,
    write_bundle,
)
from monoloc.bundle_manifest import SCHEMA, digest, manifest_content
from monoloc.camera import Camera
from monoloc.depth.spec import DepthModel, ModelSpec
from monoloc.edit_record import Edit, EditRecord
from monoloc.errors import BundleError, DataError
from monoloc.files import read_regular
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import se3_exp
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc.particle_filter.motion_model import MotionConfig
from monoloc.supervision.integrity import Classes, IntegrityModel, SensorModel
from onnx_networks import onnx_network
from refusals import refuses_data


def make_bundle(seed: int = 0) -> Bundle:
    rng = np.random.default_rng(seed)
    used = ModelSpec(
        width=256,
        height=192,
        mean=(0.485, 0.456, 0.406),
        std=(0.229, 0.224, 0.225),
        channels="bgr",
        output="disparity",
        metric=False,
        scale=1.0 / 3.0,
        shift=-1.0 / 7.0,
    )
    return Bundle(
        original=make_mixture(12, seed),
        adapted=make_mixture(12, seed + 1),
        depth_model=DepthModel(onnx_network(used, scale=1.0 + seed), used, "another"),
        settings=LocalizerConfig(
            particles=321,
            motion="random-walk",
            likelihood=LikelihoodConfig(noise_sd_m=0.1 / 3.0),
            particle_bias=BiasModel(sd_at_reference_m=0.1 / 3.0, sd_growth_rad=1.0 / 7.0),
            motion_noise=MotionConfig(speed_sd_m_s=1.0 / 7.0),
        ),
        camera=Camera(640, 480, 525.5, 526.1, 320.0, 240.0, (0.1, -0.2, 0.0, 0.001, 0.0)),
        provenance=Provenance(
            recording="redkitchen",
            frames={"seq-01/frame-000000": 123456789, "seq-01/frame-000004": 2**32 - 1},
            tune="decoder",
            map_transform=True,
            lambda_kl=0.1,
            seed=7,
            brightness=(114.0 / 7.0, 19.0),
        ),
        thresholds=LikelihoodThresholds(low=-1.5, lost=-2.25),
        reference_poses=ReferencePoses(se3_exp(rng.normal(size=(5, 6))), *(0.02 * rng.normal(size=(2, 5, 6)))),
        landmarks=Landmarks(
            rng.normal(size=(7, 3)).astype(np.float32), rng.integers(0, 256, (7, 32)).astype(np.uint8)
        ),
        integrity=IntegrityModel(
            scan=Classes(edges=(-1.0 / 3.0,), right=(0.1, 0.9), wrong=(2.0 / 3.0, 1.0 / 3.0)),
            landmarks=Classes(edges=(3.5, 7.5), right=(0.1, 0.2, 0.7), wrong=(0.8, 0.1, 0.1)),
            unseen_share=1.0 / 7.0,
            scan_search_precision=0.9,
            focal_mean=0.01 / 3.0,
            focal_sd=0.01,
        ),
        sensor=SensorModel(
            thresholds=LikelihoodThresholds(low=-0.5, lost=-1.0 / 3.0),
            scan=Classes(edges=(0.5,), right=(0.2, 0.8), wrong=(0.9, 0.1)),
            search_precision=0.8,
        ),
    )


@pytest.fixture
def written(tmp_path) -> Path:
    path = tmp_path / "room.monoloc"
    write_bundle(path, make_bundle())
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def refuses(action: Callable[[], object], path: Path, problem: str) -> None:
    """The action raises BundleError in one line: the path, what is wrong, then the fix."""
    with pytest.raises(BundleError) as raised:
        action()
    message = str(raised.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    what, _, fix = message.removeprefix(f"{path}: ").partition("; ")
    assert problem in what and fix, message


# --- Written and read ---


def test_bundle_is_read_as_written(written):
    bundle, expected = read_bundle(written), make_bundle()
    for name in ("original", "adapted"):
        read, wrote = getattr(bundle, name), getattr(expected, name)
        assert np.allclose(read.weights, wrote.weights, rtol=1e-6)
        assert np.allclose(read.means, wrote.means, atol=1e-6)
        assert np.allclose(read.covariances, wrote.covariances, rtol=1e-5, atol=1e-8)
    assert not np.allclose(bundle.original.means, bundle.adapted.means)
    assert bundle.depth_model == expected.depth_model
    # Settings to the last bit, so that the same seed gives the same trajectory after a copy.
    assert bundle.settings == expected.settings
    assert bundle.camera == expected.camera
    assert bundle.provenance == expected.provenance
    assert bundle.thresholds == expected.thresholds
    assert bundle.integrity == expected.integrity and bundle.sensor == expected.sensor
    for name in ("poses", "forward_bias", "backward_bias"):  # single precision
        read, wrote = getattr(bundle.reference_poses, name), getattr(expected.reference_poses, name)
        np.testing.assert_allclose(read, wrote, atol=1e-6)
    np.testing.assert_array_equal(bundle.landmarks.points, expected.landmarks.points)
    np.testing.assert_array_equal(bundle.landmarks.descriptors, expected.landmarks.descriptors)


def test_bundle_at_the_end_of_a_notebook_cell_is_not_printed_with_the_bytes_of_its_files():
    record = EditRecord(time="", kind="remove", parameters={}, changes={})
    printed = repr(replace(make_bundle(), edits=(Edit(record, b"undo"),)))
    assert "DepthModel(spec=" in printed and "b'" not in printed


def test_camera_of_any_lens_is_read_as_written_and_one_without_a_model_is_browns(written):
    lens = Camera(640, 480, 330.0, 331.0, 320.0, 240.0, (-0.01, 0.01, -0.006, 0.001), "fisheye")
    write_bundle(written, replace(make_bundle(), camera=lens))
    assert read_bundle(written).camera == lens
    write_bundle(written, make_bundle())
    manifest = written / "manifest.json"
    body = json.loads(manifest.read_bytes())
    for name in ("manifest_sha256", "distortion_model", "is_window"):
        (body if name in body else body["camera"]).pop(name)
    manifest.write_text(json.dumps(body | {"manifest_sha256": digest(body)}))
    assert read_bundle(written).camera == make_bundle().camera


def test_bundle_written_again_is_the_same(written, tmp_path):
    again = tmp_path / "again.monoloc"
    write_bundle(again, read_bundle(written))
    first, second = read_bundle(written), read_bundle(again)
    assert first.settings == second.settings and first.depth_model == second.depth_model
    assert np.allclose(first.adapted.covariances, second.adapted.covariances, rtol=1e-6)


def test_size_is_that_of_the_files(tmp_path):
    path = tmp_path / "room.monoloc"
    size = write_bundle(path, make_bundle())
    assert size == sum(len(content) for content in contents(path).values())
    assert sorted(contents(path)) == ["depth.onnx", "landmarks.npz", "manifest.json", "map.npz"]


def test_map_is_float32_without_pickles(written):
    with np.load(io.BytesIO((written / "map.npz").read_bytes()), allow_pickle=False) as arrays:
        assert all(arrays[name].dtype == np.float32 for name in arrays.files)
        assert sum(arrays[name].nbytes for name in arrays.files) == 2 * 12 * 40 + 3 * 5 * 24


def test_bundle_is_readable_by_others(written):
    """Although it is made in a private temporary folder."""
    assert written.stat().st_mode & 0o055 == 0o055
    assert (written / "map.npz").stat().st_mode & 0o044 == 0o044


def test_older_bundle_is_replaced_whole(written, tmp_path):
    write_bundle(written, make_bundle(seed=5))
    assert read_bundle(written).depth_model == make_bundle(seed=5).depth_model
    assert [path.name for path in tmp_path.iterdir()] == ["room.monoloc"]


def test_bundle_that_is_replaced_while_it_is_read_is_read_again(written, monkeypatch):
    """As by an edit: the manifest of one and the contents of the other do not fit."""
    checked, replaced = bundle.parse_manifest, []

    def parse(content, path):
        if not replaced:
            replaced.append(path)
            write_bundle(written, make_bundle(seed=5))
        return checked(content, path)

    monkeypatch.setattr(bundle, "parse_manifest", parse)
    assert read_bundle(written).depth_model == make_bundle(seed=5).depth_model and replaced


def test_relative_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_bundle(Path("room.monoloc"), make_bundle())
    assert read_bundle(Path("room.monoloc")).settings.particles == 321


# --- Paths that are refused ---


def test_folder_that_is_not_a_bundle_is_refused(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "one.jpg").write_bytes(b"1")
    for action in (lambda: write_bundle(folder, make_bundle()), lambda: check_target(folder)):
        refuses(action, folder, "exists and is not a bundle")
    assert contents(folder) == {"one.jpg": b"1"}


def test_file_is_refused(tmp_path):
    file = tmp_path / "room.monoloc"
    file.write_text("mine")
    refuses(lambda: write_bundle(file, make_bundle()), file, "exists and is not a bundle")
    assert file.read_text() == "mine"


def test_missing_parent_folder_is_refused(tmp_path):
    path = tmp_path / "no" / "room.monoloc"
    refuses(lambda: write_bundle(path, make_bundle()), path, "its folder does not exist")
    assert not path.parent.exists()


def test_bundle_that_holds_other_files_is_refused(written):
    """Replacing it would delete them."""
    (written / "flight.txt").write_text("a week's work")
    before = contents(written)
    for action in (lambda: write_bundle(written, make_bundle()), lambda: check_target(written)):
        refuses(action, written, "holds more than a bundle (flight.txt)")
    assert contents(written) == before


def test_bundle_in_a_bundle_is_refused(written):
    """The outer one would hold more than a bundle, and be replaced with it."""
    for inner in (written / "room.monoloc", written / "a" / "room.monoloc"):
        refuses(lambda path=inner: check_target(path), inner, f"lies in the bundle {written}")


def test_bundle_that_a_copy_went_into_is_refused(written, tmp_path):
    """As by ``cp -r`` to a name that is there already: the outer one, which would fly, is the older."""
    shutil.copytree(written, tmp_path / "new.monoloc")
    (tmp_path / "new.monoloc").rename(written / "new.monoloc")
    for action in (lambda: read_bundle(written), lambda: check_bytes(written, manifest_content(written))):
        refuses(action, written, "has another bundle in it (new.monoloc), which a copy put there")


def test_manifest_of_another_program_is_refused(tmp_path):
    (tmp_path / "page").mkdir()
    (tmp_path / "page" / "manifest.json").write_text('{"name": "a web page"}')
    (tmp_path / "page" / "index.html").write_text("")
    refuses(lambda: check_target(tmp_path / "page"), tmp_path / "page", "holds more than a bundle (index.html)")


def test_unwritable_folder_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    refuses(lambda: check_target(tmp_path / "room.monoloc"), tmp_path / "room.monoloc", "cannot be written to")


@pytest.mark.parametrize("part", ["", "map.npz"])
def test_write_protected_bundle_is_refused(written, monkeypatch, part):
    """As that of another user is."""
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path != written / part and access(path, mode))
    before = contents(written)
    for action in (lambda: write_bundle(written, make_bundle()), lambda: check_target(written)):
        refuses(action, written, "is write-protected")
    assert contents(written) == before


@pytest.mark.parametrize("part", ["", "map.npz"])
def test_write_protection_holds_for_root_too(written, part):
    (written / part).chmod(0o555)
    refuses(lambda: check_target(written), written, "is write-protected")
    (written / part).chmod(0o755)
    check_target(written)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_broken_bundle_is_replaced(written, share):
    """As an interrupted copy leaves it."""
    manifest = (written / "manifest.json").read_bytes()
    (written / "manifest.json").write_bytes(manifest[: int(share * len(manifest))])
    write_bundle(written, make_bundle(seed=5))
    assert read_bundle(written).provenance.seed == 7


# --- Writing that fails ---


def failing_write(monkeypatch, on: str, error: BaseException) -> None:
    write_bytes = Path.write_bytes

    def fail(self: Path, content: bytes) -> int:
        if self.name == on:
            write_bytes(self, content[: len(content) // 2])
            raise error
        return write_bytes(self, content)

    monkeypatch.setattr(Path, "write_bytes", fail)


@pytest.mark.parametrize("on", ["map.npz", "manifest.json"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_failed_write_leaves_the_older_bundle(written, tmp_path, monkeypatch, on, error):
    before = contents(written)
    failing_write(monkeypatch, on, error)
    with pytest.raises((DataError, KeyboardInterrupt)):
        write_bundle(written, make_bundle(seed=5))
    assert contents(written) == before
    assert [path.name for path in tmp_path.iterdir()] == ["room.monoloc"]


def test_bundle_is_written_through_links(tmp_path):
    room, link = tmp_path / "rooms" / "room.monoloc", tmp_path / "current.monoloc"
    link.symlink_to(room)
    refuses(lambda: write_bundle(link, make_bundle()), link, "its folder does not exist")
    room.parent.mkdir()
    for seed in (1, 2):
        write_bundle(link, make_bundle(seed=seed))
        assert contents(room) == contents(link)
    assert sorted(tmp_path.iterdir()) == [link, room.parent] and link.is_symlink()
    assert list(room.parent.iterdir()) == [room]


def test_failed_write_leaves_nothing(tmp_path, monkeypatch):
    failing_write(monkeypatch, "manifest.json", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        write_bundle(tmp_path / "room.monoloc", make_bundle())
    assert list(tmp_path.iterdir()) == []


def test_full_disk_gives_one_line(tmp_path, monkeypatch):
    path = tmp_path / "room.monoloc"
    failing_write(monkeypatch, "depth.onnx", OSError(28, "No space left on device"))
    full = r"cannot be written \(No space left on device\)"
    refuses_data(lambda: write_bundle(path, make_bundle()), path, full, "make room")


# --- Damaged bundles ---


@pytest.mark.parametrize("name", ["map.npz", "landmarks.npz", "depth.onnx", "manifest.json"])
@pytest.mark.parametrize("share", [0.0, 0.999])
def test_truncated_file_is_named(written, name, share):
    content = (written / name).read_bytes()
    (written / name).write_bytes(content[: int(share * len(content))])
    refuses(
        lambda: read_bundle(written), written / name, "is cut short" if name == "manifest.json" else "is not what"
    )


@pytest.mark.parametrize("name", ["map.npz", "landmarks.npz", "depth.onnx"])
def test_changed_byte_is_found(written, name):
    content = bytearray((written / name).read_bytes())
    content[len(content) // 2] ^= 1
    (written / name).write_bytes(bytes(content))
    refuses(lambda: read_bundle(written), written / name, "is not what was written")


@pytest.mark.parametrize("name", ["map.npz", "landmarks.npz", "depth.onnx"])
def test_missing_file_is_named(written, name):
    (written / name).unlink()
    refuses(lambda: read_bundle(written), written / name, "is missing")


@pytest.mark.parametrize("name", ["manifest.json", "map.npz"])
def test_a_file_that_may_not_be_read_is_not_called_missing(written, name, monkeypatch):
    def read(file, *most_bytes):
        if file.name == name:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return read_regular(file, *most_bytes)

    monkeypatch.setattr(bundle_manifest, "read_regular", read)
    monkeypatch.setattr(bundle, "read_regular", read)
    refuses(lambda: read_bundle(written), written / name, "cannot be read (Permission denied)")


def test_missing_manifest_is_named(written):
    (written / "manifest.json").unlink()
    refuses(lambda: read_bundle(written), written, "is not a bundle")


def test_path_that_is_not_there_is_to_be_checked(tmp_path):
    path = tmp_path / "room.monoloc"
    refuses(lambda: read_bundle(path), path, "there is no such folder")


@pytest.mark.parametrize("make", [lambda path: path.mkdir(), lambda path: path.write_text("")])
def test_path_without_a_bundle_is_named(tmp_path, make):
    path = tmp_path / "room.monoloc"
    make(path)
    refuses(lambda: read_bundle(path), path, "is not a bundle")


def edit(written: Path, old: str, new: str) -> Path:
    file = written / "manifest.json"
    text = file.read_text()
    assert text.count(old) >= 1, old
    file.write_text(text.replace(old, new, 1))
    return file


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"channels": "bgr"', '"channels": "rgb"'),
        ('"particles": 321', '"particles": 322'),
        ('"fx": 525.5', '"fx": 525.6'),
        ('"low": -1.5', '"low": -9.5'),
        ('"seed": 7', '"seed": 8'),
        ("123456789", "123456788"),
        ('"tune": "decoder"', '"tune": "none"'),
        ('"lambda_kl"', '"lambda_xx"'),
    ],
)
def test_edited_manifest_is_refused(written, old, new):
    file = edit(written, old, new)
    refuses(lambda: read_bundle(written), file, "was edited")


def test_deeply_nested_manifest_is_refused(written):
    file = written / "manifest.json"
    file.write_text(100_000 * "[")
    refuses(lambda: read_bundle(written), file, "is cut short or edited")


def test_manifest_without_checksum_is_refused(written):
    file = written / "manifest.json"
    body = json.loads(file.read_text())
    del body["manifest_sha256"]
    file.write_text(json.dumps(body))
    refuses(lambda: read_bundle(written), file, "was edited")


def test_reindented_manifest_is_read(written):
    """The checksum is of the content, not of its layout."""
    file = written / "manifest.json"
    file.write_text(json.dumps(json.loads(file.read_text()), sort_keys=True, indent=4))
    assert read_bundle(written).settings.particles == 321


@pytest.mark.parametrize("schema", [99, "1"])
def test_unknown_schema_is_refused(written, schema):
    file = written / "manifest.json"
    body = json.loads(file.read_text())
    body["schema_version"] = schema
    file.write_text(json.dumps(body))
    refuses(lambda: read_bundle(written), file, f"has schema {schema}, this monoloc reads 9 to {SCHEMA}")
    for path, page in ((written, "reference/versions"), (written / "no", None)):
        with pytest.raises(BundleError) as raised:
            read_bundle(path)
        assert raised.value.page == page


def test_older_schema_says_what_to_rebuild_from_and_a_newer_one_what_reads_it(written):
    file = written / "manifest.json"
    body = json.loads(file.read_text())
    for schema, fix in (
        (
            8,
            "rebuild it with this version from the 2 frames seq-01/frame-000000 to seq-01/frame-000004 of redkitchen",
        ),
        (99, "read it with the monoloc that wrote it, or a newer one"),
    ):
        file.write_text(json.dumps(body | {"schema_version": schema}))
        with pytest.raises(BundleError, match=f"; {fix}$"):
            read_bundle(written)
    file.write_text(json.dumps({"schema_version": 3, "provenance": "lost"}))
    with pytest.raises(BundleError, match=r"; rebuild it with this version$"):
        read_bundle(written)


def test_manifest_of_schema_9_is_converted(written):
    """It was written by the last version of that schema; the transform is fitted again between the two maps."""
    body = json.loads(Path(__file__).with_name("manifest_of_schema_9.json").read_text())
    assert body["schema_version"] == 9 and "cloud" not in body and "edits" not in body
    current = json.loads((written / "manifest.json").read_text())
    body |= {"sha256": current["sha256"], "network_spec": current["network_spec"]}
    body.pop("manifest_sha256")
    body["manifest_sha256"] = digest(body)
    (written / "manifest.json").write_text(json.dumps(body))
    bundle = read_bundle(written)
    assert bundle.settings.particles == 321 and bundle.provenance.recording == "redkitchen"
    assert bundle.cloud is None and bundle.edits == ()
    assert bundle.transform is not None
    write_bundle(written, bundle)
    assert json.loads((written / "manifest.json").read_text())["schema_version"] == SCHEMA
    assert np.allclose(read_bundle(written).transform.output_weight, bundle.transform.output_weight, rtol=1e-5)


def test_edits_and_transform_are_read_as_written(written):
    record = EditRecord(
        time="2026-01-02T03:04:05+00:00", kind="remove", parameters={"yaw": 1.5}, changes={"a": [1, 2]}
    )
    edits = (Edit(record, b"one"), Edit(record.model_copy(update={"kind": "move"}), b"another"))
    cloud = CloudSize(points=5000, voxel_m=0.03)
    write_bundle(written, replace(make_bundle(), edits=edits, cloud=cloud, transform=bend()))
    bundle = read_bundle(written)
    assert bundle.edits == edits and bundle.cloud == cloud
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3))
    np.testing.assert_allclose(bundle.transform(points), bend()(points), atol=1e-6)
    content = (written / "edits.npz").read_bytes()
    (written / "edits.npz").write_bytes(content[:-1])
    refuses(lambda: read_bundle(written), written / "edits.npz", "is not what was written")
    (written / "edits.npz").unlink()
    refuses(lambda: read_bundle(written), written / "edits.npz", "is missing")
    write_bundle(written, make_bundle())
    assert not (written / "edits.npz").exists()


def test_list_of_edits_without_what_undoes_them_is_refused(written):
    record = EditRecord(time="2026-01-02T03:04:05+00:00", kind="add", parameters={}, changes={})
    write_bundle(written, replace(make_bundle(), edits=(Edit(record, b"one"),)))
    resealed(written, lambda body: body["edits"].append(body["edits"][0]))
    refuses(lambda: read_bundle(written), written / "edits.npz", "does not hold the edits")


@pytest.mark.parametrize("content", ["[]", "null"])
def test_manifest_that_is_not_an_object_is_refused(written, content):
    (written / "manifest.json").write_text(content)
    refuses(lambda: read_bundle(written), written / "manifest.json", "has schema None")


def test_unknown_setting_with_valid_checksum_is_named(written):
    """As another version might write it under the same schema by mistake."""
    file = written / "manifest.json"
    body = json.loads(file.read_text())
    body["settings"]["teleport"] = True
    del body["manifest_sha256"]
    body["manifest_sha256"] = digest(body)
    file.write_text(json.dumps(body))
    refuses(lambda: read_bundle(written), file, "settings.teleport")


def resealed(written: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Change the manifest, and seal it again as anybody can."""
    file = written / "manifest.json"
    body = json.loads(file.read_text())
    change(body)
    del body["manifest_sha256"]
    body["manifest_sha256"] = digest(body)
    file.write_text(json.dumps(body))
    return file


@pytest.mark.parametrize(
    ("part", "key", "value"),
    [
        ("settings", "particles", 10_000_000),
        ("settings.odometry", "min_distance_px", 1e19),
        ("settings.odometry", "width", 1_000_000),
        ("settings.particle_bias", "sd_growth_m", float("inf")),
        ("settings.likelihood", "effective_points", float("nan")),
        ("thresholds", "low", float("nan")),
        ("thresholds", "lost", float("-inf")),
        ("integrity.scan", "right", [0.5, 0.2, 0.3]),
        ("integrity", "unseen_share", float("nan")),
        ("provenance", "lambda_kl", float("nan")),
        ("provenance", "brightness", [114.0, 1e9]),
    ],
)
def test_sealed_nonsense_is_named(written, part, key, value):
    """The seal is a checksum, which proves no author."""

    def change(body: dict[str, Any]) -> None:
        for name in part.split("."):
            body = body[name]
        body[key] = value

    file = resealed(written, change)
    refuses(lambda: read_bundle(written), file, part if part == "integrity.scan" else f"{part}.{key}")


def test_bundle_that_does_not_tell_the_builds_brightness_is_read(written):
    """As those of schema 9 that were built before it was measured."""
    resealed(written, lambda body: body["provenance"].pop("brightness"))
    assert read_bundle(written).provenance.brightness is None


def replace_content(written: Path, name: str, content: bytes) -> None:
    """Replace a file, with a matching checksum."""
    (written / name).write_bytes(content)
    resealed(written, lambda body: body["sha256"].update({name: hashlib.sha256(content).hexdigest()}))


def test_network_that_reads_other_files_is_refused(written):
    model = ModelProto.FromString((written / "depth.onnx").read_bytes())
    model.graph.initializer[0].external_data.add(key="location", value="../secret.bin")
    replace_content(written, "depth.onnx", model.SerializeToString())
    refuses(lambda: read_bundle(written), written / "depth.onnx", "keeps weights outside its file")


def replace_arrays(written: Path, name: str, **arrays: object) -> None:
    """Replace a file by other arrays, with a matching checksum."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    replace_content(written, name, buffer.getvalue())


def test_pipe_in_place_of_a_file_is_named(written):
    (written / "map.npz").unlink()
    os.mkfifo(written / "map.npz")
    refuses(lambda: read_bundle(written), written / "map.npz", "it is not a regular file")


def test_reference_poses_and_biases_of_other_numbers_are_named(written):
    with np.load(written / "map.npz") as file:
        arrays = dict(file)
    name = next(name for name, values in arrays.items() if values.shape[1:] == (6,) and "bias" in name)
    replace_arrays(written, "map.npz", **{**arrays, name: arrays[name][:-1]})
    refuses(
        lambda: read_bundle(written), written / "map.npz", "poses and biases must be (V, 4, 4), (V, 6) and (V, 6)"
    )


def test_more_reference_poses_than_any_build_has_are_named(written):
    with np.load(written / "map.npz") as file:
        arrays = dict(file)
    many = {name: np.zeros((20_001, 6), np.float32) for name in arrays if name.endswith("bias") or "poses" in name}
    assert len(many) == 3
    replace_arrays(written, "map.npz", **{**arrays, **many})
    refuses(lambda: read_bundle(written), written / "map.npz", "there are 20001 poses, more than 20000")


def test_map_without_a_mixture_is_named(written):
    """Bytes that match their checksum and still are no map."""
    replace_arrays(written, "map.npz", something=np.zeros(3))
    refuses(lambda: read_bundle(written), written / "map.npz", "key 'original_weights' is missing")


@pytest.mark.parametrize(
    ("arrays", "problem"),
    [
        ({"points": np.zeros((4, 3), np.float32)}, "descriptors"),
        (
            {"points": np.zeros((4, 3), np.float32), "descriptors": np.zeros((5, 32), np.uint8)},
            "points and descriptors must be (L, 3) and (L, 32), got (4, 3) and (5, 32)",
        ),
        (
            {"points": np.full((4, 3), np.nan, np.float32), "descriptors": np.zeros((4, 32), np.uint8)},
            "points must be finite",
        ),
    ],
)
def test_file_without_landmarks_is_named(written, arrays, problem):
    replace_arrays(written, "landmarks.npz", **arrays)
    refuses(lambda: read_bundle(written), written / "landmarks.npz", problem)


# --- Fingerprints of frames ---


def test_fingerprint_is_of_the_pixels():
    image = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    assert fingerprint(image) == fingerprint(image.copy(order="F"))
    assert 0 <= fingerprint(image) < 2**32
    other = image.copy()
    other[5, 6, 1] ^= 1
    assert fingerprint(other) != fingerprint(image)


def test_fingerprint_is_the_same_in_another_process():
    image = np.arange(24 * 32 * 3, dtype=np.uint8).reshape(24, 32, 3)
    code = (
        "import numpy as np; from monoloc.bundle import fingerprint;"
        "print(fingerprint(np.arange(24 * 32 * 3, dtype=np.uint8).reshape(24, 32, 3)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(result.stdout) == fingerprint(image)
