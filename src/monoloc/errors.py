"""Errors that a user can fix.

Invalid input raises a :class:`MonolocError`, which the command line reports as one line on stderr with exit code 2.
Any other exception is a bug in monoloc (exit code 1).
"""

from __future__ import annotations

from pathlib import Path


class MonolocError(Exception):
    """Base class of all errors caused by input; the message is one line that names the fix."""


class DataError(MonolocError):
    """A file or folder cannot be used. Message: ``path: problem; fix``."""

    def __init__(self, path: str | Path, problem: str, fix: str) -> None:
        self.path = Path(path)
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

    def __init__(self, what: str, extra: str, package: str = "monoloc") -> None:
        folder = {"monoloc": ".", "monoloc-lab": "./lab"}[package]
        fix = f'in a checkout of monoloc, run: pip install "{folder}[{extra}]"'
        super().__init__(f'{what} needs the extra "{extra}" of {package}; {fix}')
