"""Read TOML settings files and validate them against a model; each problem is reported in one line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from monoloc.errors import DataError, SettingError

Settings = TypeVar("Settings", bound=BaseModel)


def load_settings(path: Path, model: type[Settings]) -> Settings:
    """Read a TOML file into a settings model.

    Raises:
        DataError: the file is unreadable or not TOML, or a field is unknown or out of range; the message names it.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise DataError(path, "cannot be read", "give a TOML settings file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(path, f"is not TOML ({error})", "mend the line named") from error
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise DataError(path, describe(error), "mend the field named") from error


def describe(error: ValidationError) -> str:
    """Describe the first invalid field as ``field: problem``; for a union, the problem with each alternative."""
    problems: dict[str, list[str]] = {}
    for problem in error.errors():
        # Pydantic adds the type of each alternative of a union to the path; it is not a field.
        field = ".".join(str(part) for part in problem["loc"] if isinstance(part, int) or part.isidentifier())
        problems.setdefault(field or "settings", []).append(problem["msg"])
    field, messages = next(iter(problems.items()))
    return f"{field}: {', or '.join(messages)}"


def override(settings: Settings, **values: object) -> Settings:
    """Replace some fields of settings and validate the result.

    None leaves a field unchanged. A dict replaces fields of nested settings.

    Raises:
        SettingError: a value is invalid for its field.
    """
    try:
        return type(settings).model_validate(_merged(settings.model_dump(), values))
    except ValidationError as error:
        field, problem = describe(error).split(": ", 1)
        raise SettingError(field, problem, "see the command's --help") from error


def _merged(base: dict[str, object], values: dict[str, object]) -> dict[str, object]:
    merged = dict(base)
    for name, value in values.items():
        inner = merged.get(name)
        if isinstance(value, dict) and isinstance(inner, dict):
            merged[name] = _merged(inner, value)
        elif value is not None:
            merged[name] = value
    return merged
