"""Errors a person can act on.

Everything that can be wrong with what a user hands over raises a :class:`MonolocError`; the command
line turns it into one line on stderr and exit code 2. Any other exception is a fault of ours (exit 1).
"""

from __future__ import annotations

from pathlib import Path


class MonolocError(Exception):
    """Root of all errors caused by input; the message is one line that names the fix."""


class DataError(MonolocError):
    """A file or folder that cannot be used: ``path: what is wrong; how to mend it``."""

    def __init__(self, path: str | Path, problem: str, fix: str) -> None:
        self.path = Path(path)
        super().__init__(f"{path}: {problem}; {fix}")


class SettingError(MonolocError):
    """A setting or argument that cannot be used: ``field: what is wrong; how to mend it``."""

    def __init__(self, field: str, problem: str, fix: str) -> None:
        self.field, self.problem, self.fix = field, problem, fix
        super().__init__(f"{field}: {problem}; {fix}")


class BundleError(DataError):
    """A bundle that is incomplete, edited, or of an unknown schema."""


class MissingExtraError(MonolocError):
    """Something was asked for whose libraries are not installed.

    Args:
        what: needs them.
        extra: of the package, which brings them.
        package: ``monoloc`` or ``monoloc-lab``.
    """

    def __init__(self, what: str, extra: str, package: str = "monoloc") -> None:
        folder = {"monoloc": ".", "monoloc-lab": "./lab"}[package]
        fix = f'in a checkout of monoloc, run: pip install "{folder}[{extra}]"'
        super().__init__(f'{what} needs the extra "{extra}" of {package}; {fix}')
