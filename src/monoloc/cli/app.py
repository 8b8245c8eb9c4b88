"""All commands of ``monoloc``. Those that a command line does not name are not imported, nor what they depend on."""

from __future__ import annotations

import re
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated

import typer
from typer.core import TyperGroup
from typer.exceptions import Abort, TyperException
from typer.main import get_command

from monoloc.errors import MonolocError
from monoloc.version import version_facts

_INTERRUPTED = 130  # typer's result after Ctrl-C
_LAB_COMMANDS = ("bench", "demo", "reproduce", "synth")


class _LabMissingError(MonolocError):
    page = "how-to/install"


_ENTRY_GROUP = "monoloc.commands"  # entry points with which other packages add commands
_OWN_COMMANDS = {
    "build": "build:build",
    "check": "check:check",
    "fetch": "fetch:fetch",
    "reconstruct": "reconstruct:reconstruct_command",
    "localize": "localize:localize_command",
    "evaluate": "evaluate:evaluate",
    "inspect": "inspect:inspect",
    "fly": "fly:fly",
    "doctor": "doctor:doctor",
    "replay": "replay:replay",
    "map": "map_:app",
    "place": "place:app",
    "depth": "depth:app",
    "calibrate": "calibrate_camera:app",
    "signature": "signature:app",
}


def command_line(arguments: list[str]) -> TyperGroup:
    """Import what a command line needs: the command that it names, or else, as for help, all of them."""
    return _with_command(arguments[0] if arguments and arguments[0] in _entries() else None)


@cache
def _entries() -> dict[str, EntryPoint]:
    """Every command, in the order of the help."""
    own = [EntryPoint(name, f"monoloc.cli.{place}", _ENTRY_GROUP) for name, place in _OWN_COMMANDS.items()]
    added = sorted(entry_points(group=_ENTRY_GROUP), key=lambda entry: entry.name)
    return {entry.name: entry for entry in (*own, *added)}


@cache
def _with_command(name: str | None) -> TyperGroup:
    """The command line with one command, or with all."""
    app = typer.Typer(
        name="monoloc",
        help="Localise a drone indoors with one camera.",
        callback=_before_all,
        no_args_is_help=True,
        rich_markup_mode=None,
    )
    for each in _entries().values() if name is None else [_entries()[name]]:
        command = each.load()
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=each.name)
        else:
            app.command(each.name)(command)
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    return group


def _show_version(is_requested: bool) -> None:
    if is_requested:
        for name, value in version_facts().items():
            typer.echo(f"{name} {value}")
        raise typer.Exit


def _before_all(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_show_version,
            is_eager=True,
            help="Show version, commit and processor path, and exit.",
        ),
    ] = False,
) -> None:
    pass


def _option_first(message: str) -> str:
    """A message of typer on a value as other errors are: the option, and the problem in plain words."""
    from monoloc.config import in_plain_words

    option = re.match(r"Invalid value for '([^']+)'(?: / '[^']+')*: ", message)
    if option is None:
        return message
    return f"{option[1]}: {in_plain_words(message[option.end() :]).removesuffix('.')}"


def _named_command(arguments: list[str]) -> str:
    """The command that arguments name, for errors of typer that do not know it."""
    command: object = command_line(arguments)
    names = ["monoloc"]
    for argument in arguments:
        if isinstance(command, TyperGroup) and argument in command.commands:
            command = command.commands[argument]
            names.append(argument)
    return " ".join(names)


def carry_out(arguments: list[str]) -> int:
    """Run a command line and return its exit code.

    Raises:
        MonolocError: the command raised it, or typer rejected the arguments.
        KeyboardInterrupt: the command was interrupted.
    """
    try:
        result = command_line(arguments)(arguments, prog_name="monoloc", standalone_mode=False)
    except Abort as error:
        raise KeyboardInterrupt from error
    except TyperException as error:
        context = getattr(error, "ctx", None)
        problem = _option_first(error.format_message())
        if arguments and arguments[0] in _LAB_COMMANDS and context is not None and context.parent is None:
            raise _LabMissingError(
                f"monoloc {arguments[0]} comes with monoloc-lab; run: pip install monoloc-lab"
            ) from error
        if "\n" in problem:  # a group without a command: the message is its help
            typer.echo(problem, err=True)
            return 2
        command = _named_command(arguments) if context is None else context.command_path
        raise MonolocError(f"{problem} (see: {command} --help)") from error
    if result == _INTERRUPTED:
        raise KeyboardInterrupt
    return result if isinstance(result, int) else 0
