"""Command lines: help for every command, and one line for what cannot be parsed."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from typer.core import TyperGroup

from cli_helpers import succeeds
from monoloc.cli.app import command_line
from monoloc.cli.main import invoke
from monoloc.version import version_facts

BUNDLE = "kitchen.monoloc"


def commands(group: TyperGroup, *path: str) -> Iterator[tuple[str, ...]]:
    for name, command in group.commands.items():
        if isinstance(command, TyperGroup):
            # An argument of a group stands before the subcommand.
            arguments = [BUNDLE for parameter in command.params if parameter.param_type_name == "argument"]
            yield from commands(command, *path, name, *arguments)
        else:
            yield (*path, name)


COMMANDS = list(commands(command_line([])))


def test_commands_are_those_expected() -> None:
    own = {("build",), ("localize",), ("evaluate",), ("inspect",)}
    own |= {("map", name) for name in ("fit", "info", "compare")}
    own |= {("depth", name) for name in ("train", "evaluate", "export", "list")}
    assert own <= set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_describes_the_command_and_shows_valid_examples_first(
    capfd: pytest.CaptureFixture[str], command: tuple[str, ...]
) -> None:
    text = succeeds(capfd, *command, "--help")
    name = " ".join(("monoloc", *command))
    description = re.search(r"^  [A-Z][^.]+\.$", text, re.MULTILINE)
    assert description is not None
    examples, options = text.index("Examples:"), text.index("Options:")
    assert text.index(f"Usage: {name.replace(BUNDLE, '{BUNDLE}')}") < description.start() < examples < options
    assert text[examples:].splitlines()[1].startswith(f"    {name}")
    assert "--json" in text
    for option in re.findall(r"(?<= )--?[a-z][a-z0-9-]*", text[examples:options]):
        assert re.search(rf"(^|[ ,/]){option}\b", text[options:], re.MULTILINE), option


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_arguments_of_a_usage_are_in_capitals_and_differ(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    usage = succeeds(capfd, *command, "--help").splitlines()[0].partition("[OPTIONS]")[2].split()
    for argument in usage:
        assert re.fullmatch(r"[{[][A-Z]\w*(\|[A-Z]\w*(\.toml)?)*[]}](\.\.\.)?", argument), usage
    assert len(set(usage)) == len(usage)


def test_help_lists_every_command(capfd: pytest.CaptureFixture[str]) -> None:
    text = succeeds(capfd, "--help")
    for command in COMMANDS:
        assert re.search(rf"^  {command[0]} ", text, re.MULTILINE), command


def test_version(capfd: pytest.CaptureFixture[str]) -> None:
    assert succeeds(capfd, "--version").splitlines() == [f"{name} {fact}" for name, fact in version_facts().items()]


def test_list_of_commands_fits_a_screen(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = succeeds(capfd, "--help").splitlines()
    assert len(lines) < 40 and max(map(len, lines)) <= 80
    assert not [line for line in lines[1:] if line.endswith("...")]  # each description is whole


def test_shells_complete_commands(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"_MONOLOC_COMPLETE": "complete_bash", "COMP_WORDS": "monoloc lo", "COMP_CWORD": "1"}.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as ended:
        invoke([])
    assert ended.value.code == 0 and capfd.readouterr().out.split() == ["localize"]


@pytest.mark.parametrize("group", [(), ("map",), ("depth",)], ids=str)
def test_group_without_a_command_shows_its_help(capfd: pytest.CaptureFixture[str], group: tuple[str, ...]) -> None:
    assert invoke(list(group)) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith(f"Usage: {' '.join(('monoloc', *group))} [OPTIONS] COMMAND")
    assert "Commands:" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("soar", r"No such command 'soar'\. \(see: monoloc --help\)"),
        ("map fly", r"No such command 'fly'\. \(see: monoloc map --help\)"),
        ("build room --out x.monoloc --fast", "No such option: --fast.*build --help"),
        ("build room --out", r"Option '--out' requires an argument\. \(see: monoloc build --help\)"),
        ("map edit room.monoloc move --by", r"requires an argument\. \(see: monoloc map edit move --help\)"),
        ("build room", r"Missing option '--out' / '-o'\. \(see: monoloc build --help\)"),
        ("localize room.monoloc", r"Missing argument 'SOURCE'\. \(see: monoloc localize --help\)"),
        (
            "build room --out x --tune most",
            "^monoloc: --tune: 'most' is not one of 'none', .*'all' .see: .*build --help",
        ),
        ("localize room.monoloc flight --seed -1", "^monoloc: --seed: must be greater than or equal to 0 "),
        ("localize room.monoloc flight --seed a", "^monoloc: --seed: must be a valid whole number "),
        *(
            (f"localize room.monoloc flight --start-error-cm {v}", "^monoloc: --start-error-cm: must be ")
            for v in ("nan", "inf", "1e6")
        ),
        ("localize room.monoloc flight --start-error-deg 181", "^monoloc: --start-error-deg: must be "),
    ],
)
def test_usage_errors_are_one_line_that_names_the_help(
    capfd: pytest.CaptureFixture[str], arguments: str, message: str
) -> None:
    assert invoke(arguments.split()) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1
    assert re.search(message, err), err
