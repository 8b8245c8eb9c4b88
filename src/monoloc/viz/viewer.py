"""Viewers of a localisation run: none, or Rerun's viewer."""

from __future__ import annotations

import os
import socket
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from uuid import uuid4

from monoloc.bundle import Bundle
from monoloc.editing.edit_history import DrawnEdit
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.cloud_metrics import MapClouds
from monoloc.files import target_of
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.partial_files import PartialFile
from monoloc.step import LocalizedFrame

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

WINDOW_PORT = 9876  # Rerun's default; a viewer that listens there is used, also one forwarded from another machine
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")


class Viewer(Protocol):
    """Interface of viewers of a run."""

    def begin(self, room: Bundle, recording: Recording) -> None:
        """Start a run."""
        ...

    def show(self, frame: LocalizedFrame) -> None:
        """Show a frame."""
        ...


class NoViewer:
    """Shows nothing."""

    def begin(self, room: Bundle, recording: Recording) -> None:
        pass

    def show(self, frame: LocalizedFrame) -> None:
        pass


@contextmanager
def run_viewer(name: str, view: bool, record: Path | None) -> Iterator[Viewer]:
    """Context for the viewer of one run, with an optional window and file; see :func:`_rerun_stream`."""
    if not view and record is None:
        yield NoViewer()
        return
    from monoloc.viz.rerun_viewer import RerunViewer, run_blueprint

    with _rerun_stream("monoloc localize", name, run_blueprint(), view, record) as stream:
        yield RerunViewer(stream)


def show_map_change(
    name: str,
    view: bool,
    record: Path | None,
    clouds: MapClouds,
    down: FloatArray,
    edits: tuple[DrawnEdit, ...],
) -> None:
    """Show two clouds and the map's edits in an optional window and file.

    See :func:`monoloc.viz.rerun_viewer.draw_map_change`.
    """
    if not view and record is None:
        return
    from monoloc.viz.rerun_viewer import draw_map_change, map_blueprint

    with _rerun_stream("monoloc map compare", name, map_blueprint(), view, record) as stream:
        draw_map_change(stream, clouds, down, edits)


@contextmanager
def _rerun_stream(
    application: str, name: str, blueprint: Blueprint, view: bool, record: Path | None
) -> Iterator[RecordingStream]:
    """Context for a stream to Rerun's window, a file, or both; the file appears if the block ends without an error.

    Args:
        application: identifier of the application; its recordings share a layout.
        name: name of the recording.
        blueprint: default layout, which the viewer ignores if it has one for the application.
        view: whether to open the window.
        record: file to write, or None.

    Raises:
        DataError: the file cannot be written.
        SettingError: the window cannot be opened.
    """
    import rerun

    if view:
        open_window()
    with _writing(record):
        partial = None if record is None else PartialFile(target_of(record))
    window = [rerun.GrpcSink(f"rerun+http://127.0.0.1:{WINDOW_PORT}/proxy")] if view else []
    file_sink = [] if partial is None else [rerun.FileSink(partial.path)]
    stream = rerun.RecordingStream(application, recording_id=uuid4())
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    try:
        with _writing(record):
            try:
                stream.set_sinks(*window, *file_sink, default_blueprint=blueprint)
            except (RuntimeError, OSError) as error:
                if view:  # the file was started before
                    raise SettingError("--view", f"the window is lost ({error})", "try again") from error
                raise
        stream.send_recording_name(name)
        yield stream
        stream.disconnect()
        if partial is not None:
            with _writing(record):
                _check_whole(partial.path)
                partial.finish()
    finally:
        stream.disconnect()
        if partial is not None:
            partial.close()


@contextmanager
def _writing(record: Path | None) -> Iterator[None]:
    """Turn Rerun's errors about the file into DataError."""
    try:
        yield
    except (RuntimeError, OSError) as error:
        if record is None:
            raise
        raise DataError(record, f"cannot be written ({error})", "name a file in a folder with space") from error


def _check_whole(path: Path) -> None:
    """Check that a file is complete, which ends with an index. If the disk is full, Rerun only logs this.

    Raises:
        RuntimeError: the file is incomplete.
    """
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error already reports a missing index
        RrdReader(path).store()


RECORD_INSTEAD = "give --record FILE.rrd and open that elsewhere"
"""What to do without a display, in a command with this option."""


def require_window(instead: str = RECORD_INSTEAD) -> None:
    """Check that a window can be opened, before long work starts.

    Args:
        instead: what to do without a display.

    Raises:
        SettingError: there is neither a display nor a listening viewer.
    """
    if sys.platform == "linux" and not any(os.environ.get(name) for name in _DISPLAYS) and not _is_listening():
        fix = f"{instead}, or forward a viewer's port {WINDOW_PORT} to here"
        raise SettingError("--view", "there is no display", fix)


def open_window() -> None:
    """Open Rerun's window, if none is open.

    Raises:
        SettingError: it cannot be opened.
    """
    require_window()
    if _is_listening():
        return
    import rerun

    try:
        rerun.spawn(port=WINDOW_PORT, connect=False, hide_welcome_screen=True)
    except RuntimeError as error:
        raise SettingError("--view", f"Rerun does not start ({error})", "check that 'rerun' starts") from error
    if not _is_listening():
        raise SettingError("--view", "Rerun did not open its window in time", "check that 'rerun' does; try again")


def _is_listening() -> bool:
    try:
        with socket.create_connection(("127.0.0.1", WINDOW_PORT), timeout=1.0):
            return True
    except OSError:
        return False
