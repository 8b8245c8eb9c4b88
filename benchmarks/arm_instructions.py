"""Count the instructions of the core on ARM, with NEON and without, where no ARM processor is at hand.

    python benchmarks/arm_instructions.py [--steps N] > arm-instructions.json

Needs Debian's packages g++-aarch64-linux-gnu and qemu-user (version 7.2; plugins of later versions differ), gcc and
cmake. The core is compiled twice: as for every ARM processor of 64 bits, which has NEON, and lane by lane with
`-march=armv8-a+nosimd`, which leaves one number to an instruction. QEMU counts the instructions that a program
executes. A program runs with one round and with two; the difference is what one round takes.

A flight of the demo room is recorded first: N of its steps, evenly spread, give the calls that are counted, with
their arguments; all of them, the number of calls a step. Functions that these steps do not call are left out. The
kernels, of which these functions and builds consist, are called on values that are made up in arm_instructions.cpp.
Not counted: Python, NumPy, OpenCV, and the depth network. Prints one JSON object, and the tables as Markdown on
standard error.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
HERE = ROOT / "benchmarks"
COMPILER = "aarch64-linux-gnu-g++"
BUILDS = {"plain": ("-march=armv8-a+nosimd", "ON"), "neon": ("", "OFF")}  # options, and MONOLOC_LANES
WARM_UP = 5  # first steps, which are left out
LIGHT = "L2"

# Functions that a flight calls, and the sizes that the tables show: index of the argument, and what it holds.
SIZES: dict[str, tuple[tuple[int, str], ...]] = {
    "RayMixture.weigh": ((3, "particles"), (5, "points"), (0, "components")),
    "match_descriptors": ((1, "landmarks"), (3, "keypoints")),
    "nearest_descriptors": ((0, "keypoints"), (1, "landmarks")),
    "find_consensus": ((0, "landmarks"),),
    "fit_pose": ((0, "landmarks"),),
    "leverages": ((0, "landmarks"),),
    "fit_log_focal": ((0, "landmarks"),),
    "fit_log_aspect": ((0, "landmarks"),),
    "adjust_window": ((1, "corners"), (0, "keyframes")),
    "se3_exp": ((0, "twists"),),
    "se3_log": ((0, "poses"),),
    "pose_distances": ((1, "poses"),),
}


# --- The flight ---


@dataclass
class Flight:
    """Calls of the core: how many, and, of the chosen steps, with their arguments."""

    chosen: frozenset[int]
    step: int = -1
    calls: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SIZES, 0))
    kept: dict[str, list[list[np.ndarray[Any, Any]]]] = field(default_factory=lambda: {name: [] for name in SIZES})

    def add(self, name: str, arguments: list[Any]) -> None:
        if self.step >= WARM_UP:
            self.calls[name] += 1
        if self.step in self.chosen:
            empty = np.empty(0)
            self.kept[name].append([empty if value is None else np.array(value, order="C") for value in arguments])

    def size(self, name: str) -> str:
        means = [(float(np.mean([len(call[at]) for call in self.kept[name]])), what) for at, what in SIZES[name]]
        return ", ".join(f"{mean:.0f} {what}" for mean, what in means)

    def write(self, name: str, path: Path) -> None:
        with path.open("wb") as file:
            file.write(name.encode().ljust(32, b"\0"))
            for call in self.kept[name]:
                file.write(struct.pack("<Q", len(call)))
                for value in call:
                    # Numbers as float64; arrays as they are.
                    data = (value if value.ndim else value.astype(np.float64)).tobytes()
                    file.write(struct.pack("<Q", len(data)) + data)


class RecordedMixture:
    """A mixture for rays of the core, whose calls are recorded with the mixture before the arguments."""

    def __init__(self, native: Any, mixture: list[Any], flight: Flight) -> None:
        self._native, self._mixture, self._flight = native, mixture, flight

    def weigh(self, *arguments: Any) -> Any:
        self._flight.add("RayMixture.weigh", [*self._mixture, *arguments])
        return self._native.weigh(*arguments)


@contextmanager
def recorded(flight: Flight) -> Iterator[None]:
    """Within the context, the functions of the core that flights call are recorded."""
    from monoloc import _core
    from monoloc.localizer import Localizer

    def of_core(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            flight.add(name, list(arguments))
            return function(*arguments)

        return call

    def mixture(*arguments: Any) -> RecordedMixture:
        return RecordedMixture(made(*arguments), list(arguments), flight)

    def step(*arguments: Any, **named: Any) -> Any:
        flight.step += 1
        return stepped(*arguments, **named)

    made, stepped = _core.RayMixture, Localizer.step
    names = [name for name in SIZES if "." not in name]
    replaced: list[tuple[Any, str, Any]] = [(_core, name, of_core(name, getattr(_core, name))) for name in names]
    replaced += [(_core, "RayMixture", mixture), (Localizer, "step", step)]
    before = [(place, name, getattr(place, name)) for place, name, _ in replaced]
    try:
        for place, name, value in replaced:
            setattr(place, name, value)
        yield
    finally:
        for place, name, value in before:
            setattr(place, name, value)


def fly(steps: int) -> tuple[Flight, int]:
    """A flight through the demo room, and its number of steps after the first."""
    import cv2

    import monoloc_lab
    from monoloc.bundle import read_bundle
    from monoloc.io.registry import open_recording
    from monoloc.progress import NoProgress
    from monoloc.run import localize
    from monoloc.start import Start

    cv2.setNumThreads(1)
    room = Path(monoloc_lab.__file__).parent / "rooms" / "living"
    recording = open_recording(f"folder:{room / 'test' / LIGHT}")
    assert recording.poses is not None
    count = len(recording.poses)
    chosen = frozenset(int(step) for step in np.linspace(WARM_UP, count - 1, min(steps, count - WARM_UP)))
    flight, rng = Flight(chosen), np.random.default_rng(0)
    bundle = read_bundle(room / "living.monoloc")
    start = Start.disturbed(recording.poses[0], rng)
    with recorded(flight):
        localize(bundle, recording, start, rng, NoProgress())
    return flight, count - WARM_UP


# --- Counting ---


def run(*words: str | Path) -> str:
    return subprocess.run([str(word) for word in words], check=True, stdout=subprocess.PIPE, text=True).stdout


def tool(name: str) -> str:
    """A program, beside this Python first."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        sys.exit(f"{name} is not installed")
    return found


def compiled(name: str, folder: Path) -> Path:
    """The driver with a core of its own."""
    options, lanes = BUILDS[name]
    cmake, core, driver = tool("cmake"), folder / f"core-{name}", folder / name
    system = (
        "-DCMAKE_SYSTEM_NAME=Linux",
        "-DCMAKE_SYSTEM_PROCESSOR=aarch64",
        f"-DCMAKE_CXX_COMPILER={tool(COMPILER)}",
    )
    kind = ("-DMONOLOC_BUILD_PYTHON=OFF", f"-DCMAKE_CXX_FLAGS={options}", f"-DMONOLOC_LANES={lanes}")
    run(cmake, "-S", ROOT, "-B", core, f"-DCMAKE_CXX_COMPILER={tool(COMPILER)}", *system, *kind)
    run(cmake, "--build", core)
    include = (f"-I{ROOT / 'cpp' / 'include'}", f"-I{ROOT / 'cpp' / 'tests'}")
    sources = (HERE / "arm_instructions.cpp", core / "libmonoloc_core.a")
    run(tool(COMPILER), "-std=c++17", "-O2", "-static", *options.split(), *include, *sources, "-o", driver)
    return driver


@dataclass
class Counter:
    """Counts instructions of the driver of each build."""

    plugin: Path
    drivers: dict[str, Path]

    def executed(self, build: str, *words: str | Path) -> int:
        """Of a whole run."""
        command = [tool("qemu-aarch64"), "-plugin", str(self.plugin), str(self.drivers[build]), *map(str, words)]
        return int(subprocess.run(command, check=True, stderr=subprocess.PIPE, text=True).stderr.split()[-1])

    def a_round(self, build: str, *words: str | Path) -> int:
        one, two = (self.executed(build, *words, rounds) for rounds in ("1", "2"))
        return two - one

    def each(self, calls: int, *words: str | Path) -> dict[str, Any]:
        """Instructions a call of each build, and how many times as many the first build takes."""
        counts = {build: self.a_round(build, *words) / calls for build in BUILDS}
        return {**{name: round(count) for name, count in counts.items()}, "ratio": counts["plain"] / counts["neon"]}

    def verify(self) -> None:
        """Of a loop of four instructions."""
        for build in BUILDS:
            found = self.executed(build, "loop", "20000") - self.executed(build, "loop", "10000")
            if found != 40000:
                sys.exit(f"a loop of 40000 instructions counted as {found}: this QEMU counts otherwise")


def count_all(flight: Flight, steps: int, folder: Path) -> dict[str, Any]:
    plugin = folder / "libinstruction_counter.so"
    run(tool("gcc"), "-std=c17", "-O2", "-shared", "-fPIC", HERE / "instruction_counter.c", "-o", plugin)
    counter = Counter(plugin, {name: compiled(name, folder) for name in BUILDS})
    counter.verify()
    functions = []
    for name in filter(flight.kept.get, SIZES):
        flight.write(name, folder / "calls")
        counts = counter.each(len(flight.kept[name]), "calls", folder / "calls")
        calls = {"calls_a_step": flight.calls[name] / steps, "calls_counted": len(flight.kept[name])}
        functions.append({"name": name, "size": flight.size(name), **calls, **counts})
    kernels = []
    for line in run(tool("qemu-aarch64"), counter.drivers["neon"], "list").splitlines():
        name, size = line.split("\t")
        kernels.append({"name": name, "size": size, **counter.each(1, "kernel", name)})
    return {
        "compiler": run(tool(COMPILER), "--version").splitlines()[0],
        "emulator": run(tool("qemu-aarch64"), "--version").splitlines()[0],
        "steps": steps,
        "functions": functions,
        "kernels": kernels,
        "step": {build: round(sum(row["calls_a_step"] * row[build] for row in functions)) for build in BUILDS},
    }


# --- Tables ---


def shown(count: float) -> str:
    """Three digits, in thousands or millions where there are more."""
    for factor, unit in ((1e6, " M"), (1e3, " k")):
        if count >= 0.9995 * factor:
            value = count / factor
            return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f}{unit}"
    return f"{count:.0f}"


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def table_of_functions(figures: dict[str, Any]) -> str:
    head = ("Function", "Mean size", "Calls a step", "Plain", "NEON", "Plain / NEON", "NEON a step")
    rows = [
        (
            f"`{row['name']}`",
            row["size"],
            f"{row['calls_a_step']:.2f}",
            shown(row["plain"]),
            shown(row["neon"]),
            f"{row['ratio']:.2f}",
            shown(row["calls_a_step"] * row["neon"]),
        )
        for row in figures["functions"]
    ]
    step = figures["step"]
    ratio = step["plain"] / step["neon"]
    rows.append(
        ("all, a step", "", "", shown(step["plain"]), shown(step["neon"]), f"{ratio:.2f}", shown(step["neon"]))
    )
    return table(head, rows)


def table_of_kernels(figures: dict[str, Any]) -> str:
    rows = [
        (f"`{row['name']}`", row["size"], shown(row["plain"]), shown(row["neon"]), f"{row['ratio']:.2f}")
        for row in figures["kernels"]
    ]
    return table(("Kernel", "Size", "Plain", "NEON", "Plain / NEON"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=15, help="whose calls are counted")
    options = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    flight, steps = fly(options.steps)
    with tempfile.TemporaryDirectory() as name:
        figures = count_all(flight, steps, Path(name))
    print(json.dumps(figures, indent=2))
    print(table_of_functions(figures), table_of_kernels(figures), sep="\n\n", file=sys.stderr)


if __name__ == "__main__":
    main()
