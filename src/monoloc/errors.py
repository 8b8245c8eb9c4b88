"""Errors that a user can fix.

Invalid input raises a :class:`MonolocError`, which the command line reports as one line on stderr with exit code 2.
Any other exception is a bug in monoloc (exit code 1).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any


class MonolocError(Exception):
    """Base class of all errors caused by input; the message is one line that names the fix.

    Attributes:
        page: of the documentation, as ``how-to/install``, where it says more than the message; the command line adds
            its address.
    """

    page: str | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """As another process gets it: with its message and attributes, whatever its constructor takes."""
        return _restored, (type(self), self.args, self.__dict__)


def _restored(kind: type[MonolocError], arguments: tuple[Any, ...], attributes: dict[str, Any]) -> MonolocError:
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(attributes)
    return error


class DataError(MonolocError):
    """A file or folder cannot be used. Message: ``path: problem; fix``."""

    def __init__(self, path: str | Path, problem: str, fix: str, page: str | None = None) -> None:
        self.path = Path(path)
        if page is not None:
            self.page = page
        super().__init__(f"{path}: {problem}; {fix}")


class SettingError(MonolocError):
    """A setting or argument cannot be used. Message: ``field: problem; fix``."""

    def __init__(self, field: str, problem: str, fix: str) -> None:
        self.field, self.problem, self.fix = field, problem, fix
        super().__init__(f"{field}: {problem}; {fix}")


class BundleError(DataError):
    """A bundle is incomplete, was edited, or has an unknown schema."""


class MissingExtraError(MonolocError):
    """A feature needs libraries that are not installed.

    Args:
        what: the feature, as the subject of the message.
        extra: name of the extra that installs the libraries.
        package: package that defines the extra, ``monoloc`` or ``monoloc-lab``.
    """

    page = "how-to/install"

    def __init__(self, what: str, extra: str, package: str = "monoloc") -> None:
        super().__init__(f'{what} needs the extra "{extra}" of {package}; run: pip install "{package}[{extra}]"')
