"""Check that a tag, both packages and the changelog name one version.

python3 .github/check_release.py v0.1.0
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
_PROJECTS = ("pyproject.toml", "lab/pyproject.toml")


def problems(tag: str) -> list[str]:
    """What does not name the version of the tag."""
    version = tag.removeprefix("v")
    stated = {name: tomllib.loads((ROOT / name).read_text())["project"]["version"] for name in _PROJECTS}
    stated["src/monoloc/version.py"] = _found(r'^__version__ = "(.+)"$', "src/monoloc/version.py")
    stated["CITATION.cff"] = _found(r"^version: (.+)$", "CITATION.cff")
    wrong = [f"{file} says {found}, the tag {tag}" for file, found in stated.items() if found != version]
    if _found(rf"^## \[{re.escape(version)}\] - (\d{{4}}-\d{{2}}-\d{{2}})$", "CHANGELOG.md") is None:
        wrong.append(f"CHANGELOG.md has no heading '## [{version}] - YYYY-MM-DD'")
    return wrong


def _found(pattern: str, file: str) -> str | None:
    match = re.search(pattern, (ROOT / file).read_text(), re.MULTILINE)
    return None if match is None else match.group(1)


if __name__ == "__main__":
    sys.exit("\n".join(problems(sys.argv[1])))
