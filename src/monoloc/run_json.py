"""What ``monoloc localize --json`` printed, read from a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from monoloc.config import describe
from monoloc.errors import DataError
from monoloc.files import read_regular

GIVE_RUN = "give the output of: monoloc localize BUNDLE SOURCE --json"
"""What to do about a file that is not that."""

_MOST_BYTES = 1 << 26

Figures = TypeVar("Figures", bound=BaseModel)
"""Some of a run's figures."""


def read_run_json(path: Path) -> Any:
    """The content of a file.

    Raises:
        DataError: it cannot be read, or is no JSON.
    """
    try:
        return json.loads(read_regular(path, _MOST_BYTES))
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", GIVE_RUN) from error
    except (ValueError, RecursionError) as error:
        raise DataError(path, "is no JSON", GIVE_RUN) from error


def figures_of(path: Path, content: Any, figures: type[Figures]) -> Figures:
    """Some figures of a file's content.

    Raises:
        DataError: they are missing, or of another type.
    """
    try:
        return figures.model_validate(content)
    except ValidationError as error:
        raise DataError(path, describe(error), GIVE_RUN) from error
