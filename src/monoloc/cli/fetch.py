"""``monoloc fetch``: download a public recording by its name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pydantic import TypeAdapter

from monoloc.cli.common import (
    JsonOption,
    print_json,
    print_table,
    stderr,
)
from monoloc.cli.output_checks import check_folder
from monoloc.errors import DataError, SettingError
from monoloc.fetch.data_sets import DATA_SETS, DataSet
from monoloc.fetch.download import download
from monoloc.fetch.unpack import unpack
from monoloc.files import json_text, read_regular, target_of, write_whole
from monoloc.io.identity import file_sha256
from monoloc.partial_files import whole_folder
from monoloc.progress import ConsoleProgress

_CHECKSUMS = "monoloc-checksums.json"  # of archives by address, as they were first downloaded
_Checksums = TypeAdapter(dict[str, str])


def fetch(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Recording; none lists them.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to put it into, under its name.")] = Path(),
    accept_terms: Annotated[
        bool, typer.Option("--accept-terms", help="The recording's terms, which are shown, are accepted.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Download a public recording by its name.

    Its terms are those of its publisher: their page is shown first, and nothing is downloaded before they are
    accepted. An interrupted download continues when the command is run again.

    \b
    Examples:
      monoloc fetch
      monoloc fetch redkitchen --out recordings
      monoloc fetch fr1-desk --accept-terms --json
    """
    if name is None:
        _list(json)
        return
    if name not in DATA_SETS:
        raise SettingError("NAME", f"{name!r} is not known", f"known names: {', '.join(DATA_SETS)}")
    data_set = DATA_SETS[name]
    check_folder(out, "--out")
    source = _source(data_set, out / name)
    if (out / name).exists():
        stderr.print(f"{out / name} is there already", soft_wrap=True)
    else:
        _accept(data_set, accept_terms)
        out.mkdir(exist_ok=True)
        _fetch(data_set, name, out)
    if json:
        print_json({"name": name, "source": source, "terms": data_set.terms})
    else:
        stderr.print(f"next: monoloc check {source}", soft_wrap=True)


def _list(json: bool) -> None:
    if json:
        print_json({name: {"title": each.title, "terms": each.terms} for name, each in DATA_SETS.items()})
    else:
        print_table("Recordings", ["name", "what it is"], [[name, each.title] for name, each in DATA_SETS.items()])
        for terms in dict.fromkeys(each.terms for each in DATA_SETS.values()):  # whole, so that they can be opened
            names = ", ".join(name for name, each in DATA_SETS.items() if each.terms == terms)
            typer.echo(f"terms of {names}: {terms}")


def _accept(data_set: DataSet, is_accepted: bool) -> None:
    stderr.print(f"{data_set.title}; terms: {data_set.terms}", soft_wrap=True)
    if not is_accepted and not (stderr.is_terminal and typer.confirm("Do you accept these terms?", err=True)):
        raise SettingError("--accept-terms", "was not given", f"read {data_set.terms}, then give it")


def _fetch(data_set: DataSet, name: str, out: Path) -> None:
    archive, record = out / Path(data_set.archive).name, out / _CHECKSUMS
    download(data_set.archive, archive, ConsoleProgress(stderr))
    found = file_sha256(archive)
    recorded = _read_checksums(record)
    _check(data_set, archive, found, recorded, record)
    with whole_folder(target_of(out / name), is_synced=False) as folder:
        unpack(archive, folder)
    if data_set.sha256 is None and data_set.archive not in recorded:  # a page in its place could not be unpacked
        write_whole(record, json_text({**recorded, data_set.archive: found}).encode() + b"\n")
        stderr.print(f"no checksum is published; recorded in {record}: {found}", soft_wrap=True)
    archive.unlink()


def _read_checksums(record: Path) -> dict[str, str]:
    try:
        return _Checksums.validate_json(read_regular(record)) if record.exists() else {}
    except ValueError as error:
        fix = "remove it; the next download records its checksum"
        raise DataError(record, "holds no checksums by address", fix) from error


def _check(data_set: DataSet, archive: Path, found: str, recorded: dict[str, str], record: Path) -> None:
    """Compare an archive with its checksum: the known one, else that of the first download, if it was recorded."""
    expected = data_set.sha256 or recorded.get(data_set.archive, found)
    if found != expected:
        archive.unlink()
        fix = f"fetch it again, or ask its publisher whether it was changed ({record} holds the first)"
        raise DataError(data_set.archive, f"has SHA-256 {found}, not {expected}", fix)


def _source(data_set: DataSet, folder: Path) -> str:
    format_name, _, path = data_set.source.partition(":")
    return f"{format_name}:{folder / path}"
