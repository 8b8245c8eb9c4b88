"""Read TOML settings files and validate them against a model; each problem is reported in one line."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from monoloc.errors import DataError, SettingError
from monoloc.files import read_regular

Settings = TypeVar("Settings", bound=BaseModel)

_MOST_BYTES = 1 << 20  # of a TOML file
_NO_NUMBER = "is true or false, not a number"


def load_settings(path: Path, model: type[Settings]) -> Settings:
    """Read a TOML file into a settings model.

    Raises:
        DataError: the file is unreadable or not TOML, or a field is unknown or out of range; the message names it.
    """
    content = read_toml(path)
    try:
        settings = model.model_validate(content)
    except ValidationError as error:
        field, _ = _first_problem(error)
        fix = "correct the field named" if field else "correct it"
        unknown = _unknown_key(error, model)
        raise DataError(path, ": ".join(unknown) if unknown else describe(error), fix) from error
    if (name := _truth_for_a_number(content, settings)) is not None:
        raise DataError(path, f"{name}: {_NO_NUMBER}", "correct the field named")
    return settings


def _truth_for_a_number(given: object, held: object, name: str = "") -> str | None:
    """The first field that is given as true or false and holds a number: Python's True is an int, which is 1."""
    if isinstance(given, bool):
        return None if isinstance(held, bool) else name
    found = (
        _truth_for_a_number(part, part_held, f"{name}.{key}" if name else str(key))
        for key, part, part_held in _parts(given, held)
    )
    return next((each for each in found if each is not None), None)


def _parts(given: object, held: object) -> Iterator[tuple[object, object, object]]:
    """The keys of what is given, tables within tables and in lists, and what is given and held there."""
    if isinstance(given, dict) and isinstance(held, BaseModel):
        yield from ((key, value, getattr(held, key)) for key, value in given.items())
    elif isinstance(given, list | tuple) and isinstance(held, list | tuple):
        yield from ((at, *both) for at, both in enumerate(zip(given, held, strict=False)))


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        DataError: the file is unreadable or not TOML.
    """
    try:
        return tomllib.loads(read_regular(path, _MOST_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "give a TOML file") from error
    except RecursionError as error:
        raise DataError(path, "is not valid TOML (it is nested too deep)", "correct it") from error
    except ValueError as error:  # of TOML, text and numbers
        raise DataError(path, f"is not valid TOML ({error})", "correct the line named") from error


def _unknown_key(error: ValidationError, model: type[BaseModel]) -> tuple[str, str] | None:
    """The first unknown field, and what is: the known one that is spelt alike, or all known ones.

    A field that is missing is often this one, misspelt.
    """
    first = next((each for each in error.errors() if each["type"] == "extra_forbidden"), None)
    if first is None:
        return None
    *within, key = first["loc"]
    known = _keys(model, within)
    nearest = get_close_matches(str(key), known, n=1)
    hint = f"the nearest is {nearest[0]}" if nearest else f"known are {', '.join(known)}"
    return ".".join(map(str, first["loc"])), f"is unknown, {hint}"


def _keys(model: type[BaseModel], within: Sequence[int | str]) -> list[str]:
    """Names of the fields of the settings at a place within a model; numbers in it are those of a list's entries."""
    for part in within:
        field = model.model_fields.get(str(part))
        if field is not None:
            model = next(_models_in(field.annotation), model)
    return list(model.model_fields)


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def describe(error: ValidationError) -> str:
    """Describe the first invalid field as ``field: problem``; a rule about several fields has the problem alone."""
    field, problem = _first_problem(error)
    return f"{field}: {problem}" if field else problem


def _first_problem(error: ValidationError) -> tuple[str, str]:
    """The first invalid field, empty for a rule about several, and its problem; of a union, with each alternative."""
    problems: dict[str, list[str]] = {}
    for problem in error.errors():
        # Pydantic adds the type of each alternative of a union to the path; it is not a field.
        field = ".".join(str(part) for part in problem["loc"] if isinstance(part, int) or part.isidentifier())
        problems.setdefault(field, []).append(in_plain_words(problem["msg"]))
    field, messages = next(iter(problems.items()))
    return field, ", or ".join(messages)


def in_plain_words(message: str) -> str:
    """A message of pydantic without how it parses."""
    message = re.sub(r"a valid dictionary( or instance of \w+)?$", "one table, as [...] and not [[...]]", message)
    return (
        message.removeprefix("Value error, ")
        .split(", unable to parse")[0]
        .replace("Input should be", "must be")
        .replace("Field required", "is missing")
        .replace("Extra inputs are not permitted", "is unknown")
        .replace("List should have", "must have")
        .replace(" after validation", "")
        .replace("Input is not a valid path for <class 'pathlib.Path'>", "must be a path, in quotes")
        .replace("integer", "whole number")
        .replace("a valid tuple", "a list, as [...] or, of tables, [[...]]")
    )


def override(settings: Settings, **values: object) -> Settings:
    """Replace some fields of settings and validate the result.

    None leaves a field unchanged. A dict replaces fields of nested settings.

    Raises:
        SettingError: a value is invalid for its field.
    """
    merged = _merged(settings.model_dump(), values)
    try:
        changed = type(settings).model_validate(merged)
    except ValidationError as error:
        if (unknown := _unknown_key(error, type(settings))) is not None:
            raise SettingError(*unknown, "correct its name") from error
        field, problem = _first_problem(error)
        raise SettingError(field or "settings", problem, "correct its value") from error
    if (name := _truth_for_a_number(merged, changed)) is not None:
        raise SettingError(name, _NO_NUMBER, "correct its value")
    return changed


def _merged(base: dict[str, object], values: dict[str, object]) -> dict[str, object]:
    merged = dict(base)
    for name, value in values.items():
        inner = merged.get(name)
        if isinstance(value, dict) and isinstance(inner, dict):
            merged[name] = _merged(inner, value)
        elif value is not None:
            merged[name] = value
    return merged
