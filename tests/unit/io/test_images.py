"""Image files: what becomes of other kinds of them, and those that are damaged."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.io.registry import open_recording
from refusals import refuses_data
from synthetic_recordings import check_recording


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A described folder with three frames of JPEG colour and PNG depth, 32x24."""
    synthetic.write_folder(tmp_path)
    return tmp_path


@pytest.mark.parametrize("value", [0, 65535])
def test_depth_image_may_be_all_missing(tmp_path: Path, value: int) -> None:
    synthetic.write_folder(tmp_path)
    synthetic.write_depth(tmp_path / "depth/000015.png", np.full((24, 32), value, dtype=np.uint16))
    recording = open_recording(str(tmp_path))
    check_recording(recording, 3)
    assert not recording.depth(1).any() and recording.depth(2).any()


@pytest.mark.parametrize("kind", ["grey", "rgba", "16-bit", "16-bit grey"])
def test_colour_images_of_other_kinds_become_rgb(tmp_path: Path, kind: str) -> None:
    synthetic.write_folder(tmp_path, synthetic.SEQUENCE_TOML.replace(".jpg", ".png"))
    rgb = synthetic.make_color(32, 24)
    grey = rgb[..., 0]
    stored, expected = {
        "grey": (grey, np.repeat(grey[..., None], 3, axis=-1)),
        "rgba": (np.dstack([rgb[..., ::-1], grey]), rgb),
        "16-bit": (rgb[..., ::-1].astype(np.uint16) * 257, rgb),
        "16-bit grey": (grey.astype(np.uint16) * 257, np.repeat(grey[..., None], 3, axis=-1)),
    }[kind]
    for index in (10, 15, 20):
        cv2.imwrite(str(tmp_path / f"color/{index:06d}.png"), stored)
    np.testing.assert_array_equal(open_recording(str(tmp_path)).color(0), expected)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, None])
@pytest.mark.parametrize("kind", ["color", "depth"])
def test_truncated_image_is_refused(
    folder: Path, kind: str, share: float | None, capfd: pytest.CaptureFixture[str]
) -> None:
    """Where only a share of the file is left, or all but its last byte; the decoder itself says nothing."""
    recording = open_recording(str(folder))
    image = folder / kind / ("000015.jpg" if kind == "color" else "000015.png")
    data = image.read_bytes()
    image.write_bytes(data[: -1 if share is None else int(share * len(data))])
    refuses_data(lambda: getattr(recording, kind)(1), image, "is cut short", "copy the file again")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("appended", [bytes(4096), b"\0\0\0\x18ftypmp42" + bytes(range(200)) * 20])
def test_jpeg_may_be_followed_by_more(folder: Path, appended: bytes) -> None:
    """Phones append a video to their photos, and some cameras fill a block with zeros."""
    image = folder / "color/000015.jpg"
    expected, data = open_recording(str(folder)).color(1), image.read_bytes()
    image.write_bytes(data + appended)
    np.testing.assert_array_equal(open_recording(str(folder)).color(1), expected)
    thumbnail = b"\xff\xe2\x00\x08EXIF\xff\xd9"  # its end is not that of the image
    image.write_bytes(data[:2] + thumbnail + data[2:-2])
    refuses_data(lambda: open_recording(str(folder)).color(1), image, "is cut short", "copy the file again")


def test_image_that_vanished_is_refused(folder: Path) -> None:
    recording, image = open_recording(str(folder)), folder / "depth/000015.png"
    image.write_bytes(b"")
    refuses_data(lambda: recording.depth(1), image, "is empty", "copy the file again")
    image.unlink()
    refuses_data(lambda: recording.depth(1), image, "cannot be read", "restore the file")


def test_file_that_is_no_image_is_refused(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    recording = open_recording(str(folder))
    (folder / "color/000015.jpg").write_text("not an image")
    refuses_data(lambda: recording.color(1), folder / "color/000015.jpg", "cannot be decoded", "copy or convert")
    assert capfd.readouterr().err == ""


def test_colour_of_another_size_is_refused(folder: Path) -> None:
    synthetic.write_color(folder / "color/000015.jpg", synthetic.make_color(16, 12))
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.color(1), folder / "color/000015.jpg", "is 16x12.*for 32x24", "intrinsics")


@pytest.mark.parametrize(("width", "height"), [(16, 12), (64, 48), (11, 8), (32, 24)])
def test_depth_of_another_size_has_the_same_field_of_view(folder: Path, width: int, height: int) -> None:
    """Each pixel has the depth of the stored pixel that its centre lies in."""
    v, u = np.mgrid[0:height, 0:width]
    stored = (1000 + 100 * v + u).astype(np.uint16)
    synthetic.write_depth(folder / "depth/000015.png", stored)
    rows, columns = (np.arange(24) + 0.5) * height / 24, (np.arange(32) + 0.5) * width / 32
    expected = stored[rows.astype(int)[:, None], columns.astype(int)] / 1000.0
    np.testing.assert_allclose(open_recording(str(folder)).depth(1), expected, atol=1e-6)


def test_depth_of_another_shape_is_refused(folder: Path) -> None:
    synthetic.write_depth(folder / "depth/000015.png", synthetic.constant_depth(16, 14, 1000))
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.depth(1), folder / "depth/000015.png", "is 16x14.*for 32x24", "depth_width")


METRES = np.array([[1.5, np.nan], [np.inf, -1.0]]).repeat(12, axis=0).repeat(16, axis=1)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("kind", ["tiff", "npy"])
def test_depth_of_floating_point_numbers(folder: Path, kind: str, dtype: type) -> None:
    """NaN, infinity and negative depth are unknown."""
    toml = synthetic.SEQUENCE_TOML.replace("depth_scale = 1000", "depth_scale = 1").replace("}.png", f"}}.{kind}")
    (folder / "dataset.toml").write_text(toml)
    for index in (10, 15, 20):
        file = folder / f"depth/{index:06d}.{kind}"
        if kind == "npy":
            np.save(file, METRES.astype(dtype))
        else:
            assert cv2.imwrite(str(file), METRES.astype(dtype))
    np.testing.assert_array_equal(open_recording(str(folder)).depth(1), np.where(METRES == 1.5, 1.5, 0.0))


def test_depth_in_a_numpy_file_of_millimetres(folder: Path) -> None:
    np.save(folder / "depth/000015.npy", synthetic.constant_depth(32, 24, 1500))
    (folder / "depth/000015.npy").rename(folder / "depth/000015.png")  # the content counts
    recording = open_recording(str(folder))
    np.testing.assert_array_equal(recording.depth(1), recording.depth(0))


def numpy_header(shape: tuple[int, ...]) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return file.getvalue()


@pytest.mark.parametrize(
    ("content", "problem", "fix"),
    [
        (b"v/1\x01\x02\x00\x00\x00", "is OpenEXR", "oiiotool"),
        (numpy_header((10**6, 10**6)), "cannot be read as a NumPy array .it is cut short", "copy the file again"),
        (b"\x93NUMPY", "cannot be read as a NumPy array", "copy the file again"),
        (numpy_header((2, 3, 4)) + bytes(96), "is not a depth image", "one channel"),
        (cv2.imencode(".tiff", np.zeros((24, 32), np.float32))[1].tobytes()[:50], "is cut short", "copy the file"),
        (struct.pack(">8sI4sII", b"\x89PNG\r\n\x1a\n", 13, b"IHDR", 1 << 20, 1 << 20), "1048576x1048576", "camera's"),
    ],
)
def test_depth_that_is_no_image_is_refused(
    folder: Path, content: bytes, problem: str, fix: str, capfd: pytest.CaptureFixture[str]
) -> None:
    recording = open_recording(str(folder))
    (folder / "depth/000015.png").write_bytes(content)
    refuses_data(lambda: recording.depth(1), folder / "depth/000015.png", problem, fix)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"BM" + struct.pack("<IHHIIii", 54, 0, 0, 54, 40, 60000, 60000), "says it is 60000x60000"),
        (b"P6 100000 100000 255\n", "says it is 100000x100000"),
        (b"GIF89a\xff\xff\xff\xff\x80\0\0" + bytes(40), "cannot be decoded"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 100000 +X 100000\n", "cannot be decoded"),
    ],
)
def test_colour_of_a_large_or_unknown_size_is_refused(folder: Path, content: bytes, problem: str) -> None:
    recording = open_recording(str(folder))
    (folder / "color/000015.jpg").write_bytes(content)
    refuses_data(lambda: recording.color(1), folder / "color/000015.jpg", problem, "")


def test_image_of_another_size_is_refused_before_it_is_decoded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synthetic.write_color(folder / "color/000015.jpg", synthetic.make_color(64, 48))
    recording = open_recording(str(folder))
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("was decoded"))
    refuses_data(lambda: recording.color(1), folder / "color/000015.jpg", "is 64x48.*for 32x24", "intrinsics")


# --- Orientation tags ---


def tag_orientation(path: Path, orientation: int, order: str) -> None:
    """Put an EXIF segment with the tag after the start of a JPEG."""
    tiff = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(f"{order}IHHHIHHI", 8, 1, 274, 3, 1, orientation, 0, 0)
    body = b"Exif\0\0" + tiff
    data = path.read_bytes()
    path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("orientation", "quarter_turns"), [(6, -1), (8, 1)])
def test_image_is_turned_as_tagged_to_the_size_of_the_intrinsics(
    folder: Path, orientation: int, quarter_turns: int, order: str
) -> None:
    """A phone held upright stores a lying image; intrinsics are of the image as shown."""
    shown = synthetic.make_color(32, 24)
    synthetic.write_color(folder / "color/000015.jpg", np.rot90(shown, -quarter_turns))
    tag_orientation(folder / "color/000015.jpg", orientation, order)
    assert np.abs(open_recording(str(folder)).color(1).astype(float) - shown).mean() < 4.0


def test_tag_is_ignored_where_the_intrinsics_are_of_the_stored_image(folder: Path) -> None:
    expected = open_recording(str(folder)).color(1)
    tag_orientation(folder / "color/000015.jpg", 6, "<")
    np.testing.assert_array_equal(open_recording(str(folder)).color(1), expected)


def test_tag_that_leaves_two_readings_is_refused(folder: Path) -> None:
    tag_orientation(folder / "color/000015.jpg", 3, "<")
    recording = open_recording(str(folder))
    refuses_data(
        lambda: recording.color(1), folder / "color/000015.jpg", "EXIF orientation 3", "mogrify -auto-orient"
    )


def test_tag_of_no_meaning_is_ignored(folder: Path) -> None:
    tag_orientation(folder / "color/000015.jpg", 9, "<")
    check_recording(open_recording(str(folder)), 3)


def test_colour_image_is_no_depth(folder: Path) -> None:
    synthetic.write_color(folder / "depth/000015.png", synthetic.make_color(32, 24))
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.depth(1), folder / "depth/000015.png", "is not a depth image", "one channel")


def test_recording_without_depth_refuses_to_give_it(folder: Path) -> None:
    toml = synthetic.SEQUENCE_TOML.replace('depth = "', '# "')
    (folder / "dataset.toml").write_text(toml)
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.depth(0), folder, "has no depth images", "predicted depth")
