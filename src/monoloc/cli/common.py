"""Shared parts of the commands: options, what they open, output streams and tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.files import json_text
from monoloc.geometry import FloatArray
from monoloc.io.camera_file import read_camera
from monoloc.io.cloud_files import read_cloud
from monoloc.io.corrected import DEPTH_FIXES, Fixes, corrected
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Selection
from monoloc.io.registry import FORMATS, open_recording, select_frames
from monoloc.io.upright import Turned
from monoloc.printable import printable
from monoloc.structure_from_motion.scale_option import SCALE_FORMS


class PlainConsole(Console):
    """Prints text as it is: brackets, colons and control characters in it, as in paths, are not interpreted."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False, emoji=False)

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text), **options)


stderr = PlainConsole(stderr=True)

# By what a key in JSON ends with.
_UNITS = {"m": " m", "m3": " m³", "deg": "°", "s": " s", "ms": " ms", "px": " px", "hz": " Hz", "mb": " MB"}

SourceArgument = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help=f"Recording: FORMAT:PATH ({', '.join(FORMATS)}) or a path.",
        show_default=False,
    ),
]
FramesOption = Annotated[
    str, typer.Option("--frames", help="Frames START:STOP:STEP, in order of time; several with commas.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, everything else on stderr.")]
ThreadsOption = Annotated[
    int | None,
    typer.Option("--threads", metavar="1|2", help="With 2, depth and landmarks beside odometry. [the bundle's: 1]"),
]
BudgetOption = Annotated[
    float | None,
    typer.Option(
        "--budget-ms",
        metavar="MS",
        help="Time that a step may take. A slow computer leaves out, in this order: particles, scan points, every "
        "second depth image and every second search for landmarks.",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Random seed; the same seed gives the same result.")]
IntrinsicsOption = Annotated[
    str | None,
    typer.Option(
        "--camera",
        "--intrinsics",
        metavar="FILE.toml|W,H,FX,FY,CX,CY[,K1,K2,P1,P2,K3]",
        help="Intrinsics of the colour images, in place of the recording's own: a file from monoloc calibrate, or "
        "numbers. Without K1 to K3, the distortion is unchanged.",
    ),
]
DepthScaleOption = Annotated[
    float | None, typer.Option("--depth-scale", help="Stored depth value of one metre; overrides the format's.")
]
FixPosesOption = Annotated[
    str | None,
    typer.Option(
        "--fix-poses",
        metavar="NAME[,NAME]",
        help="What the poses are, if not camera-to-world with OpenCV's axes in metres: opengl, world-to-camera, "
        "w-first, robot, left-handed, millimetres, late:FRAMES, late:0.2s and others.",
    ),
]
FixDepthOption = Annotated[
    str | None,
    typer.Option("--fix-depth", metavar="NAME", help=f"What the depth is, if not z: {', '.join(DEPTH_FIXES)}."),
]

ScaleOption = Annotated[
    str | None,
    typer.Option(
        "--scale",
        metavar=SCALE_FORMS,
        help="Where the scale of images without poses comes from. [depth if there is some, else network]",
    ),
]

ViewOption = Annotated[bool, typer.Option("--view", help="Show a live view in Rerun's viewer.")]
RecordOption = Annotated[
    Path | None, typer.Option("--record", metavar="FILE.rrd", help="Write a recording for Rerun's viewer.")
]


@contextmanager
def naming(options: Mapping[str, str]) -> Iterator[None]:
    """Report invalid settings under the names of the options that set them: ``options`` maps setting to option."""
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
    fix_poses: str | None = None,
    fix_depth: str | None = None,
    guesses_camera: bool = False,
) -> Selection:
    """Open a recording, print its notes on stderr, and select frames.

    Args:
        source: SOURCE, see :func:`monoloc.io.registry.open_recording`.
        frames: START:STOP:STEP.
        intrinsics: value of ``--camera``.
        depth_scale: stored depth value of one metre.
        frames_option: name of the option that selected the frames, for error messages.
        fix_poses, fix_depth: what poses and depth are, see :class:`monoloc.io.corrected.Fixes`.
        guesses_camera: whether a video needs no intrinsics.

    Raises:
        DataError, SettingError: from the reader, or an option is invalid.
    """
    options = {"camera": "--camera", "depth_scale": "--depth-scale"}
    options |= {"fix_poses": "--fix-poses", "fix_depth": "--fix-depth", "frames": frames_option}
    with naming(options):
        fixes = Fixes(fix_poses, fix_depth)
        camera, keeps_distortion = (None, False) if intrinsics is None else parse_intrinsics(intrinsics)
        reading = ReaderOptions(camera, keeps_distortion, depth_scale, guesses_camera)
        recording = open_recording(source, reading)
        # The last note of turned images is theirs, and poses that are fixed do not turn them.
        is_turned = isinstance(recording, Turned) and fix_poses is not None
        for line in recording.notes[:-1] if is_turned else recording.notes:
            note(recording.name, line)
        return select_frames(corrected(recording, fixes), frames)


def open_cloud(path: Path) -> FloatArray:
    """Read a cloud file, (N, 3) metres, and print its notes on stderr.

    Raises:
        DataError: see :func:`monoloc.io.cloud_files.read_cloud`.
    """
    notes: list[str] = []
    points = read_cloud(path, notes)
    for line in notes:
        note(path, line)
    return points


def parse_intrinsics(text: str) -> tuple[Camera, bool]:
    """The camera of ``--camera``, and whether its distortion was left out.

    Raises:
        DataError: the file is that of no camera.
        SettingError: the numbers are.
    """
    if text.endswith(".toml"):
        return read_camera(Path(text)), False
    try:
        width, height, *rest = text.split(",")
        fx, fy, cx, cy, *distortion = (float(part) for part in rest)
        k1, k2, p1, p2, k3 = distortion or [0.0] * 5
        return Camera(int(width), int(height), fx, fy, cx, cy, (k1, k2, p1, p2, k3)), not distortion
    except ValueError as error:
        fix = (
            "name a .toml of monoloc calibrate, or write W,H,FX,FY,CX,CY in pixels, and K1,K2,P1,P2,K3 for distortion"
        )
        raise SettingError("--camera", f"is {text!r}", fix) from error
    except SettingError as error:
        part = error.field.removeprefix("camera.")
        raise SettingError("--camera", f"{part} {error.problem}", error.fix) from error


def refuse_frames(frames: str, what: str) -> None:
    """Reject ``--frames`` for a target without frames.

    Raises:
        SettingError: frames are selected.
    """
    if frames.strip() != "::":
        raise SettingError("--frames", f"has no meaning for {what}", "leave it out")


def say_written(*paths: Path | None) -> None:
    """Name the files that a command has written, on stderr; None where one was not asked for."""
    for path in paths:
        if path is not None:
            stderr.print(f"written: {path}", soft_wrap=True)


def warn(about: object, what: str) -> None:
    """Print a warning about a file, a recording or an option, one line on stderr."""
    stderr.print(f"warning: {about}: {what}", soft_wrap=True)


def note(about: object, what: str) -> None:
    """Print a note as :func:`warn` prints a warning."""
    stderr.print(f"note: {about}: {what}", soft_wrap=True)


def print_figures(title: str, figures: Mapping[str, object], json: bool) -> None:
    """Print a result on stdout: as one JSON object, or as a table with a line for each figure."""
    if json:
        print_json(figures)
    else:
        table = Table(show_header=False)
        table.add_column()
        table.add_column(overflow="fold")
        for name, value in figures.items():
            table.add_row(*_with_unit(name, value))
        _print_titled(title, table)


def print_json(content: Mapping[str, object]) -> None:
    """Print one JSON object on stdout; NaN and infinity, which JSON lacks, become null."""
    typer.echo(json_text(content))


def print_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """Print a table on stdout: the result of a command without ``--json``."""
    # With both paddings, a long value would break words of the header in a terminal of 80 columns.
    table = Table(header_style="", collapse_padding=True)
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", overflow="fold")  # nothing is cut off
    for row in rows:
        table.add_row(*row)
    _print_titled(title, table)


def _print_titled(title: str, table: Table) -> None:
    console = PlainConsole()
    console.print(title, style="bold", soft_wrap=True)  # the table's own title would be wrapped to its width
    console.print(table)


def _with_unit(key: str, value: object) -> tuple[str, str]:
    """A key of JSON in words, and its value with the unit that ends the key."""
    *words, last = key.split("_")
    text = text_of(value)
    if not words or last not in _UNITS or isinstance(value, dict):
        return " ".join([*words, last]), text
    return " ".join(words), text if value is None else text + _UNITS[last]


def text_of(value: object) -> str:
    """Format a value: three decimals or digits, lists with commas, one line per entry of a dict; ``-`` for None."""
    if value is None or isinstance(value, bool):
        return "-" if value is None else "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}" if abs(value) >= 0.1 else f"{value:.3g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(text_of, value))
    if isinstance(value, dict):
        return "\n".join(f"{name}: {text_of(item)}" for name, item in _flat(value))
    return str(value)


def _flat(entries: dict[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Entries of a dict, those of dicts in it as ``name.entry``."""
    for name, item in entries.items():
        if isinstance(item, dict) and item:
            yield from _flat(item, f"{prefix}{name}.")
        else:
            yield prefix + name, item
