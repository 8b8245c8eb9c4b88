"""Checks of what a command writes and shows, before long work starts."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from monoloc.bundle_manifest import container_of
from monoloc.errors import SettingError
from monoloc.extras import require_extra
from monoloc.files import at_home, target_of
from monoloc.io import dataset_description, nerfstudio
from monoloc.viz.viewer import RECORD_INSTEAD, require_window

_DESCRIPTIONS = {dataset_description.FILE_NAME, nerfstudio.FILE_NAME}  # each a SOURCE that stands for its folder


def check_outputs(outputs: Mapping[str, Path | None], inputs: Sequence[str | Path | None] = ()) -> None:
    """Reject output paths that cannot be written or that would replace something else, before long work starts.

    Args:
        outputs: path of each option, or None if the option is not given.
        inputs: see :func:`check_apart`.

    Raises:
        SettingError: an output is rejected; the error names the option.
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
    """Reject an output that is an input, replaces a file of a folder that is one, or is inside a bundle or a place.

    A new file may lie in a folder that is read. That an older one there is not of the recording is not known before
    it is opened, so all are kept. So are files outside it that its ``dataset.toml`` names.

    Args:
        path: the output.
        option: its option.
        inputs: files, folders and SOURCEs that the command reads; None is ignored.

    Raises:
        SettingError: the output is rejected; the error names the option.
    """
    _check_outside(path, option)
    target = target_of(path)
    for text in _paths_in(inputs):
        source = Path(os.path.realpath(at_home(text)))
        if source == target:
            raise SettingError(option, f"{path} is read by this command", "name another place")
        folder = source.parent if source.name in _DESCRIPTIONS else source
        if folder in target.parents and target.is_file():
            problem = f"{path} lies in {text}, which is read by this command"
            raise SettingError(option, problem, "name a new file, or another place")
        for named in (Path(os.path.realpath(each)) for each in dataset_description.named_in(folder)):
            if target.is_file() and (named == target or named in target.parents):
                problem = f"{path} is read by this command, as {text} names it"
                raise SettingError(option, problem, "name a new file, or another place")


def _paths_in(inputs: Sequence[str | Path | None]) -> Iterator[str]:
    """The paths that inputs may stand for: PATH, FORMAT:PATH, or either with #TOPIC of a bag."""
    for given in inputs:
        for text in () if given is None else (str(given), str(given).partition(":")[2]):
            yield from (each for each in dict.fromkeys((text, text.rpartition("#")[0])) if each)


def _check_outside(path: Path, option: str) -> None:
    if (container := container_of(path)) is not None:
        raise SettingError(option, f"{path} lies in {container}", "name another place")


def check_suffix(path: Path | None, option: str, suffix: str, kind: str) -> None:
    """Reject an output that is not named as what it is, such as ``a PNG``.

    Raises:
        SettingError: the path has another suffix; the error names the option.
    """
    if path is not None and path.suffix.lower() != suffix:
        raise SettingError(option, f"{path} would be {kind} by another name", f"name it NAME{suffix}")


def check_picture(path: Path | None, option: str) -> None:
    """Reject a picture that is not named as PNG, or that cannot be drawn, before long work starts.

    Raises:
        SettingError: the path does not end in .png; the error names the option.
        MissingExtraError: matplotlib is not installed.
    """
    check_suffix(path, option, ".png", "a PNG")
    if path is not None:
        require_extra("report")


def check_folder(path: Path, option: str) -> None:
    """Reject an output folder that cannot be created or written to, or is a bundle or a place, or inside one.

    Raises:
        SettingError: the folder is rejected; the error names the option.
    """
    if (container := container_of(path / "file")) is not None:
        raise SettingError(option, f"{path} is or lies in {container}", "name another place")
    if not path.exists():
        _check_parent(path, option)
    elif not path.is_dir():
        raise SettingError(option, f"{path} is a file", "name a folder")
    elif not os.access(path, os.W_OK | os.X_OK):
        raise SettingError(option, f"{path} cannot be written to", "choose another folder")


def check_viewing(view: bool, record: Path | None = None, instead: str = RECORD_INSTEAD) -> None:
    """Check that the viewer can open its window and write its recording, before long work starts.

    Args:
        view, record: values of the options.
        instead: what to do without a display.

    Raises:
        MissingExtraError: Rerun is not installed.
        SettingError: no window can be opened, or the recording is not named as one.
    """
    check_suffix(record, "--record", ".rrd", "a recording of Rerun")
    if view or record is not None:
        require_extra("view")
    if view:
        require_window(instead)


def _check_parent(path: Path, option: str) -> None:
    parent = path.absolute().parent
    if not parent.is_dir():
        if parent.exists():
            raise SettingError(option, f"{path.parent} is a file", "name a place in a folder")
        raise SettingError(option, f"{path.parent} does not exist", "make the folder first")
    if not os.access(parent, os.W_OK):
        raise SettingError(option, f"{path.parent} cannot be written to", "choose another folder")
