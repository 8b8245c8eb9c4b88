"""What documents say of instructions on ARM is what was counted."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from types import ModuleType
from typing import Any

import pytest

from repository import REPOSITORY

COUNTED: dict[str, Any] = json.loads((REPOSITORY / "docs" / "results" / "arm-instructions.json").read_text())
TABLES, EXAMPLE = (
    (REPOSITORY / "docs" / page).read_text(encoding="utf-8")
    for page in ("reference/arm-instructions.md", "how-to/companion-computer.md")
)
BUILDS = ("plain", "neon")
# Functions of the core that no flight with the default likelihood calls.
NOT_IN_FLIGHTS = {
    "log_density",
    "expectation",
    "max_pool",
    "max_pool_gradient",
    "chain_pools",
    "chain_pools_gradient",
    "draw_points",
    "instruction_set",
    "multiply_add",
    "MixtureIndex",
}


def script() -> ModuleType:
    name = "arm_instructions"
    spec = importlib.util.spec_from_file_location(name, REPOSITORY / "benchmarks" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look there for their module
    spec.loader.exec_module(module)
    return module


def test_tables_are_those_of_the_script() -> None:
    module = script()
    assert module.table_of_functions(COUNTED) + "\n" in TABLES
    assert module.table_of_kernels(COUNTED) + "\n" in TABLES


def test_sums_and_ratios() -> None:
    for build in BUILDS:
        total = sum(row["calls_a_step"] * row[build] for row in COUNTED["functions"])
        assert COUNTED["step"][build] == pytest.approx(total, abs=1.0)
    for row in COUNTED["functions"] + COUNTED["kernels"]:
        assert row["ratio"] == pytest.approx(row["plain"] / row["neon"], rel=0.01)


def test_example_divides_the_counted_instructions() -> None:
    ((million, clock, one, two),) = re.findall(
        r"(\d+) million instructions at ([\d.]+) GHz take (\d+) ms at one instruction per cycle, and (\d+) ms at two",
        EXAMPLE,
    )
    assert int(million) == round(COUNTED["step"]["neon"] / 1e6)
    for text, per_cycle in ((one, 1.0), (two, 2.0)):
        assert int(text) == round(COUNTED["step"]["neon"] / (1e6 * float(clock) * per_cycle))


def test_every_function_that_a_flight_calls_is_counted() -> None:
    text = (REPOSITORY / "src" / "monoloc" / "_core.pyi").read_text(encoding="utf-8")
    functions = set(re.findall(r"^(?:def|class) (\w+)", text, flags=re.MULTILINE))
    assert {name.split(".")[0] for name in script().SIZES} == functions - NOT_IN_FLIGHTS


def test_every_kernel_is_counted() -> None:
    text = (REPOSITORY / "cpp" / "include" / "monoloc" / "kernels.hpp").read_text(encoding="utf-8")
    kernels = re.findall(r"\(\*(\w+)\)\(", text)
    assert len(kernels) >= 18
    assert set(kernels) <= {row["name"] for row in COUNTED["kernels"]}


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0"),
        (999, "999"),
        (999.6, "1.00 k"),
        (1234, "1.23 k"),
        (99_960, "100 k"),
        (999_600, "1.00 M"),
        (5.678e7, "56.8 M"),
    ],
)
def test_counts_have_three_digits(count: float, text: str) -> None:
    assert script().shown(count) == text
