"""The version of monoloc, and what of it is run."""

from __future__ import annotations

import subprocess
from pathlib import Path

__version__ = "0.1.0"

_BUILT_FROM = Path(__file__).with_name("build_commit.txt")  # CMakeLists.txt writes it into wheels
_CHECKOUT = Path(__file__).parents[2]
_CORES = {"avx512": "AVX-512", "avx2": "AVX2", "neon": "NEON", "plain": "plain"}


def version_facts() -> dict[str, str]:
    """Version, commit, instruction set of the core on this processor, and version of ONNX Runtime, as text."""
    import onnxruntime

    from monoloc import _core

    return {
        "monoloc": __version__,
        "commit": commit() or "unknown",
        "core": _CORES[_core.instruction_set()],
        "ONNX Runtime": onnxruntime.__version__,
    }


def commit() -> str | None:
    """Commit of the source: of the build, or of the checkout that runs; None if neither is known.

    A checkout with changes that are not committed has the suffix ``-dirty``.
    """
    if _BUILT_FROM.is_file():
        return _BUILT_FROM.read_text(encoding="utf-8").strip() or None
    if not (_CHECKOUT / ".git").exists():
        return None
    command = ("git", "describe", "--always", "--exclude=*", "--abbrev=12", "--dirty")
    try:
        result = subprocess.run(command, cwd=_CHECKOUT, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return result.stdout.strip()
