"""The machine that this program runs on, and the versions of what it runs."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def machine_facts() -> dict[str, str]:
    """Processor, cores, system and Python, as text."""
    return {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
    }


def library_versions(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of packages by name, or that one is not installed."""
    found = {}
    for library in libraries:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            found[library] = "not installed"
    return found


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = {line.partition(":")[0].strip(): line.partition(":")[2].strip() for line in lines}
    return names.get("model name") or names.get("Model") or platform.processor() or "unknown"
