"""All commands of ``monoloc``; importing this module imports all their dependencies."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Annotated

import typer
from typer.exceptions import Abort, TyperException

from monoloc.cli import (
    build,
    calibrate_camera,
    check,
    depth,
    doctor,
    evaluate,
    fetch,
    fly,
    inspect,
    localize,
    map_,
    place,
    reconstruct,
    replay,
    signature,
)
from monoloc.errors import MonolocError
from monoloc.version import version_facts

_INTERRUPTED = 130  # typer's result after Ctrl-C
_LAB_COMMANDS = ("bench", "demo", "reproduce", "synth")


class _LabMissingError(MonolocError):
    page = "how-to/install"


app = typer.Typer(
    name="monoloc",
    help="Localise a drone indoors with one camera.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command("build")(build.build)
app.command("check")(check.check)
app.command("fetch")(fetch.fetch)
app.command("reconstruct")(reconstruct.reconstruct_command)
app.command("localize")(localize.localize_command)
app.command("evaluate")(evaluate.evaluate)
app.command("inspect")(inspect.inspect)
app.command("fly")(fly.fly)
app.command("doctor")(doctor.doctor)
app.command("replay")(replay.replay)
app.add_typer(map_.app, name="map")
app.add_typer(place.app, name="place")
app.add_typer(depth.app, name="depth")
app.add_typer(calibrate_camera.app, name="calibrate")
app.add_typer(signature.app, name="signature")


def _add_installed_commands() -> None:
    """Add the commands of other packages, from entry points in the group ``monoloc.commands``."""
    for entry in sorted(entry_points(group="monoloc.commands"), key=lambda entry: entry.name):
        command = entry.load()
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=entry.name)
        else:
            app.command(entry.name)(command)


_add_installed_commands()


def _show_version(is_requested: bool) -> None:
    if is_requested:
        for name, value in version_facts().items():
            typer.echo(f"{name} {value}")
        raise typer.Exit


@app.callback()
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


def carry_out(arguments: list[str]) -> int:
    """Run a command line and return its exit code.

    Raises:
        MonolocError: the command raised it, or typer rejected the arguments.
        KeyboardInterrupt: the command was interrupted.
    """
    try:
        result = app(arguments, prog_name="monoloc", standalone_mode=False)
    except Abort as error:
        raise KeyboardInterrupt from error
    except TyperException as error:
        context = getattr(error, "ctx", None)
        problem = error.format_message()
        if arguments and arguments[0] in _LAB_COMMANDS and context is not None and context.parent is None:
            raise _LabMissingError(
                f"monoloc {arguments[0]} comes with monoloc-lab; run: pip install monoloc-lab"
            ) from error
        if "\n" in problem:  # a group without a command: the message is its help
            typer.echo(problem, err=True)
            return 2
        raise MonolocError(f"{problem} (see: {context.command_path if context else 'monoloc'} --help)") from error
    if result == _INTERRUPTED:
        raise KeyboardInterrupt
    return result if isinstance(result, int) else 0
