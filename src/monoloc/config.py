"""Settings files: TOML checked against a model, with one clear line for what is wrong."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from monoloc.errors import DataError

Settings = TypeVar("Settings", bound=BaseModel)


def load_settings(path: Path, model: type[Settings]) -> Settings:
    """Read a TOML file into a settings model.

    Raises:
        DataError: unreadable, not TOML, an unknown field, or a value out of range; the field is named.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(path, "cannot be read", "give a TOML settings file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(path, f"is not TOML ({error})", "mend the line named") from error
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise DataError(path, describe(error), "mend the field named") from error


def describe(error: ValidationError) -> str:
    """The first problem of a validation, as ``field: what is wrong``."""
    first = error.errors()[0]
    field = ".".join(str(part) for part in first["loc"]) or "settings"
    return f"{field}: {first['msg']}"
