"""All commands of ``monoloc``, and with them all that they import."""

from __future__ import annotations

from typing import Annotated

import typer
from typer.exceptions import Abort, TyperException

from monoloc import __version__
from monoloc.cli import bench, build, demo, depth, evaluate, inspect, localize, map_, reproduce, synth
from monoloc.errors import MonolocError

_OF_CTRL_C = 130  # the result that typer makes of it

app = typer.Typer(
    name="monoloc",
    help="Where a drone is indoors, from one camera and a map of a few kilobytes.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("build")(build.build)
app.command("localize")(localize.localize_command)
app.command("evaluate")(evaluate.evaluate)
app.command("reproduce")(reproduce.reproduce)
app.command("inspect")(inspect.inspect)
app.add_typer(map_.app, name="map")
app.add_typer(depth.app, name="depth")
app.add_typer(bench.app, name="bench")
app.add_typer(synth.app, name="synth")


def _show_version(is_asked: bool) -> None:
    if is_asked:
        typer.echo(f"monoloc {__version__}")
        raise typer.Exit


@app.callback()
def _before_all(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def carry_out(arguments: list[str]) -> int:
    """Do what a command line says and return its exit code.

    Raises:
        MonolocError: what the command raises, and what typer has to say of the arguments.
        KeyboardInterrupt: it was interrupted.
    """
    try:
        result = app(arguments, prog_name="monoloc", standalone_mode=False)
    except Abort as error:
        raise KeyboardInterrupt from error
    except TyperException as error:
        context = getattr(error, "ctx", None)
        problem = error.format_message()
        if "\n" in problem:  # a group alone: the answer is its help
            typer.echo(problem, err=True)
            return 2
        raise MonolocError(f"{problem} (see: {context.command_path if context else 'monoloc'} --help)") from error
    if result == _OF_CTRL_C:
        raise KeyboardInterrupt
    return result if isinstance(result, int) else 0
