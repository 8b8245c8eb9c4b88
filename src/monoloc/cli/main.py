"""The ``monoloc`` command: one launcher, which turns known errors into one line and an exit code."""

from __future__ import annotations

import sys

import typer
from typer.exceptions import Abort, TyperException

from monoloc.cli import bench, build, demo, depth, evaluate, inspect, localize, map_, reproduce, synth
from monoloc.errors import MonolocError

_INTERRUPTED = 130  # 128 and the number of SIGINT, as shells have it

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


def run() -> None:
    """Entry point: exit code 0 when done, 2 for bad input with one line on stderr, 130 for Ctrl-C, 1 for a fault."""
    sys.exit(invoke(sys.argv[1:]))


def invoke(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    try:
        result = app(arguments, prog_name="monoloc", standalone_mode=False)
        if result == _INTERRUPTED:  # what typer makes of Ctrl-C
            raise KeyboardInterrupt
        return result if isinstance(result, int) else 0
    except MonolocError as error:
        message, code = str(error), 2
    except TyperException as error:
        context = getattr(error, "ctx", None)
        problem = error.format_message()
        if "\n" in problem:  # a group alone: the answer is its help
            print(problem, file=sys.stderr)
            return 2
        message, code = f"{problem} (see: {context.command_path if context else 'monoloc'} --help)", 2
    except (KeyboardInterrupt, Abort):
        message, code = "interrupted; nothing half-written is left", _INTERRUPTED
    print("monoloc: " + " ".join(message.split()), file=sys.stderr)
    return code
