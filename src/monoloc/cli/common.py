"""What the commands share: options, the two streams, and tables."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.extras import require_plotting, require_viewing
from monoloc.files import json_text, target_of
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Selection
from monoloc.io.registry import open_recording, select_frames
from monoloc.viz.viewer import require_window

# Paths are printed as they are, whatever Rich would read in their brackets and colons.
stderr = Console(stderr=True, highlight=False, markup=False, emoji=False)

EXTENT_SIGMAS = math.sqrt(3.0)  # how far a surface reaches from its component's mean, if it is covered evenly

SourceArgument = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="A recording: FORMAT:PATH (7scenes, tum, rgbd-scenes-v2, nyu, folder, video) or a path.",
        show_default=False,
    ),
]
FramesOption = Annotated[str, typer.Option("--frames", help="Which frames, START:STOP:STEP, in order of time.")]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, everything else on stderr.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="The same seed gives the same result.")]
IntrinsicsOption = Annotated[
    str | None,
    typer.Option(
        "--intrinsics",
        metavar="W,H,FX,FY,CX,CY[,K1,K2,P1,P2,K3]",
        help="Of the colour images, where the files have none or err; distortion stays theirs without K1 and so on.",
    ),
]
DepthScaleOption = Annotated[
    float | None, typer.Option("--depth-scale", help="Stored depth value of one metre, in place of the format's.")
]

ViewOption = Annotated[bool, typer.Option("--view", help="Show it in Rerun's viewer, live.")]
RecordOption = Annotated[
    Path | None, typer.Option("--record", metavar="FILE.rrd", help="Recording to write for Rerun's viewer.")
]


@contextmanager
def naming(options: Mapping[str, str]) -> Iterator[None]:
    """Problems of settings whose values came from options are those options': their names, by the settings'."""
    try:
        yield
    except SettingError as error:
        if error.field not in options:
            raise
        raise SettingError(options[error.field], error.problem, error.fix) from error


def open_source(
    source: str,
    frames: str,
    intrinsics: str | None = None,
    depth_scale: float | None = None,
    frames_option: str = "--frames",
) -> Selection:
    """The chosen frames of a recording.

    Args:
        frames_option: by which they were chosen.

    Raises:
        DataError, SettingError: as the readers'.
    """
    with naming({"frames": frames_option, "camera": "--intrinsics", "depth_scale": "--depth-scale"}):
        camera, keeps_distortion = (None, False) if intrinsics is None else _parse_camera(intrinsics)
        options = ReaderOptions(camera, keeps_distortion, depth_scale)
        return select_frames(open_recording(source, options), frames)


def _parse_camera(text: str) -> tuple[Camera, bool]:
    """The camera, and whether its distortion is left open."""
    try:
        width, height, *rest = text.split(",")
        fx, fy, cx, cy, *distortion = (float(part) for part in rest)
        k1, k2, p1, p2, k3 = distortion or [0.0] * 5
        return Camera(int(width), int(height), fx, fy, cx, cy, (k1, k2, p1, p2, k3)), not distortion
    except ValueError as error:
        fix = "write W,H,FX,FY,CX,CY in pixels, and K1,K2,P1,P2,K3 behind them for distortion"
        raise SettingError("--intrinsics", f"is {text!r}", fix) from error
    except SettingError as error:
        part = error.field.removeprefix("camera.")
        raise SettingError("--intrinsics", f"{part} {error.problem}", error.fix) from error


def refuse_frames(frames: str, what: str) -> None:
    """Refuse a choice of frames where there are none to choose.

    Raises:
        SettingError: frames are chosen.
    """
    if frames.strip() != "::":
        raise SettingError("--frames", f"has no meaning for {what}", "leave it out")


def check_outputs(outputs: Mapping[str, Path | None], inputs: Sequence[str | Path | None] = ()) -> None:
    """Refuse output files that cannot be written, or in whose place something else lies, before the work is done.

    Args:
        outputs: by option, None where it is not given.
        inputs: as :func:`check_apart` takes them.

    Raises:
        SettingError: naming the option.
    """
    options: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        if path.is_dir():
            raise SettingError(option, f"{path} is a folder", "name a file")
        if path.exists() and not path.is_file():
            raise SettingError(option, f"{path} is neither a file nor a folder", "name a file")
        _check_parent(target_of(path) if path.is_symlink() else path, option)
        check_apart(path, option, inputs)
        other = options.setdefault(target_of(path), option)
        if other != option:
            raise SettingError(option, f"{path} is what {other} writes", "name another file")


def check_apart(path: Path, option: str, inputs: Sequence[str | Path | None]) -> None:
    """Refuse an output in the place of an input, or within a bundle that is one.

    Args:
        inputs: files, folders and SOURCEs that the command reads; None where there is none.

    Raises:
        SettingError: naming the option.
    """
    target = target_of(path)
    texts = [str(given) for given in inputs if given is not None]
    for text in (*texts, *(text.partition(":")[2] for text in texts)):  # PATH or FORMAT:PATH
        source = Path(os.path.realpath(os.path.expanduser(text)))  # noqa: PTH111 - pathlib's raise for odd paths
        if text and source == target:
            raise SettingError(option, f"{path} is read by this command", "name another place")
        if text and source in target.parents and (source / "manifest.json").is_file():
            raise SettingError(option, f"{path} lies in the bundle {text}", "name another place")


def check_picture(path: Path | None, option: str) -> None:
    """Refuse a picture under the name of something else, and one that nothing can draw, before the work is done.

    Raises:
        SettingError: naming the option.
        MissingExtraError: matplotlib is not installed.
    """
    if path is None:
        return
    if path.suffix.lower() != ".png":
        raise SettingError(option, f"{path} is a PNG by another name", "name it NAME.png")
    require_plotting()


def check_folder(path: Path, option: str) -> None:
    """Refuse an output folder, which may exist, that cannot be made or written to, before the work is done.

    Raises:
        SettingError: naming the option.
    """
    if not path.exists():
        _check_parent(path, option)
    elif not path.is_dir():
        raise SettingError(option, f"{path} is a file", "name a folder")
    elif not os.access(path, os.W_OK | os.X_OK):
        raise SettingError(option, f"{path} cannot be written to", "choose another folder")


def check_viewing(view: bool, record: Path | None = None) -> None:
    """Refuse a window or a recording that there is nothing to show or write with, before the work is done.

    Raises:
        MissingExtraError, SettingError: naming the extra or the option.
    """
    if view or record is not None:
        require_viewing()
    if view:
        require_window()


def _check_parent(path: Path, option: str) -> None:
    parent = path.absolute().parent
    if not parent.is_dir():
        raise SettingError(option, f"{path.parent} does not exist", "make the folder first")
    if not os.access(parent, os.W_OK):
        raise SettingError(option, f"{path.parent} cannot be written to", "choose another folder")


def print_json(content: Mapping[str, object]) -> None:
    """One object on stdout; figures that are not numbers become null, as JSON has no NaN."""
    typer.echo(json_text(content))


def print_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """A table for people: the result of a command without ``--json``, so on stdout."""
    table = Table(header_style="")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right")
    for row in rows:
        table.add_row(*row)
    console = Console(highlight=False, markup=False, emoji=False)
    console.print(title, style="bold", soft_wrap=True)  # not the table's own, which is wrapped to its width
    console.print(table)


def text_of(value: object) -> str:
    """A value as a person reads it: three decimals or digits, lists with commas, a dict's entries on lines."""
    if isinstance(value, float):
        return f"{value:.3f}" if abs(value) >= 0.1 else f"{value:.3g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(text_of, value))
    if isinstance(value, dict):
        return "\n".join(f"{name}: {text_of(item)}" for name, item in value.items())
    return str(value)
