"""What a release installs on this machine's kind of computer, pinned and with the hashes of the files, for pip.

    python -m monoloc_lab.make.release_requirements [EXTRA]... > requirements.txt
    pip install --require-hashes -r requirements.txt && pip install --no-deps monoloc-*.whl

pip chooses, within ``constraints.txt``. Hashes are of the files for this processor, system and Python.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parents[3]


def specifiers(project: Mapping[str, Any], extras: Iterable[str]) -> list[str]:
    """What a project depends on, with some of its extras.

    Raises:
        KeyError: there is no such extra.
    """
    return [*project["dependencies"], *(each for name in extras for each in project["optional-dependencies"][name])]


def pinned(report: Mapping[str, Any]) -> Iterator[str]:
    """Lines of a requirements file, from pip's report of an installation.

    Raises:
        ValueError: pip does not tell the SHA-256 of a file.
    """
    for entry in sorted(report["install"], key=lambda entry: str(entry["metadata"]["name"]).lower()):
        name, version = entry["metadata"]["name"], entry["metadata"]["version"]
        sha256 = entry["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256")
        if sha256 is None:
            raise ValueError(f"{name} {version} has no SHA-256")
        yield f"{name}=={version} --hash=sha256:{sha256}"


def main(extras: list[str]) -> None:
    project = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet"]
    command += ["--only-binary=:all:", "--constraint", str(_ROOT / "constraints.txt"), "--report", "-"]
    report = subprocess.run([*command, *specifiers(project, extras)], check=True, stdout=subprocess.PIPE).stdout
    print("\n".join(pinned(json.loads(report))))


if __name__ == "__main__":
    main(sys.argv[1:])
