"""Tests of an installed wheel without extras: kernels against their NumPy twins, bundles, and a drone's commands.

python tests/wheel_tests.py needs pytest, hypothesis and onnx beside monoloc.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import monoloc

TESTS = Path(__file__).parent
CHOSEN = (
    "unit/map/test_numpy_twins.py",
    "unit/test_bundle.py",
    "unit/test_localizer.py",
    "unit/test_version.py",
    "integration/test_runtime_without_torch.py",
)

if __name__ == "__main__":
    if Path(monoloc.__file__).is_relative_to(TESTS.parent):
        sys.exit(f"{monoloc.__file__} is of the checkout, not of a wheel")
    sys.exit(pytest.main(["-p", "no:cacheprovider", *(str(TESTS / name) for name in CHOSEN)]))
