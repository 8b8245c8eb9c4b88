"""Compare another commit with this working tree: both run in turn, pair by pair, so that other load hits both.

    python benchmarks/compare.py COMMIT pipeline|build|flight SOURCE [--frames START:STOP] [--pairs N]

`pipeline` times the localizer's step, `build` a default build from every third frame. `flight` compares errors on
frames that built no bundle, from disturbed starts. The first and the last use untuned bundles from every third frame,
one of each side. Prints one JSON object: for each figure the median of both sides, and median, least and most of the
ratio (this tree over COMMIT), pair by pair.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import sysconfig
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMAND_LINE = ("-c", "from monoloc.cli.main import run; run()")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
FIGURES = ("step_ms_median", "step_ms_p95", "peak_memory_mb")
ERRORS = ("ate_median_m", "ate_rmse_m", "rot_median_deg", "coverage_95", "silent_frames_30cm")  # on unseen frames


class Side:
    """One version of the project, installed in a folder of its own beside the libraries of this environment."""

    def __init__(self, name: str, tree: Path, folder: Path) -> None:
        self.name, self._folder, packages = name, folder, folder / "packages"
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(packages)]
        subprocess.run([*pip, str(tree), str(tree / "lab")], check=True)
        venv.create(folder / "venv", with_pip=False)
        [site] = (folder / "venv" / "lib").glob("python*/site-packages")
        # As plain paths: an editable installation of this tree would else take the place of the packages.
        (site / "compared.pth").write_text(f"{packages}\n{sysconfig.get_path('purelib')}\n", encoding="utf-8")
        self._python = folder / "venv" / "bin" / "python"

    def run(self, *arguments: str) -> str:
        """Standard output of a run of Python on one thread."""
        return subprocess.run(
            [str(self._python), *arguments],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | ONE_THREAD,
            cwd=self._folder,
        ).stdout

    def build(self, source: str, frames: str, *options: str) -> Path:
        bundle = self._folder / "room.monoloc"
        self.run(*COMMAND_LINE, "build", source, "--frames", frames, "--out", str(bundle), *options)
        return bundle


def untuned(side: Side, source: str, frames: str) -> Path:
    return side.build(source, frames, "--tune", "none", "--no-map-transform")


def pipeline(side: Side, bundle: Path, source: str, frames: str, seed: int) -> dict[str, float]:
    figures = json.loads(side.run("-m", "monoloc_lab.bench.steps", str(bundle), source, frames, str(seed)))
    stages = {f"stage {name}": value for name, value in figures["stage_ms"].items()}
    return {name: figures[name] for name in FIGURES} | stages


def flight(side: Side, bundle: Path, source: str, frames: str, seed: int) -> dict[str, float]:
    options = ("--frames", frames, "--start", "truth", "--seed", str(seed), "--json")
    figures = json.loads(side.run(*COMMAND_LINE, "localize", str(bundle), source, *options))
    return {name: figures[f"unseen_{name}"] for name in ERRORS} | {"tracking": figures["states"].get("tracking", 0)}


def timed_build(side: Side, source: str, frames: str) -> dict[str, float]:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    side.build(source, frames)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {"processor_s": after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime}


def summary(rounds: list[list[dict[str, float]]]) -> dict[str, dict[str, float | None]]:
    """Of pairs of figures: of COMMIT, and of this tree."""
    rows: dict[str, dict[str, float | None]] = {}
    for name in rounds[0][0].keys() & rounds[0][1].keys():
        before, after = ([pair[which][name] for pair in rounds] for which in (0, 1))
        ratios = [new / old for old, new in zip(before, after, strict=True) if old]
        rows[name] = {
            "commit": statistics.median(before),
            "this": statistics.median(after),
            "ratio": statistics.median(ratios) if ratios else None,
            "least": min(ratios, default=None),
            "most": max(ratios, default=None),
        }
    return dict(sorted(rows.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("kind", choices=("pipeline", "build", "flight"))
    parser.add_argument("source", help="a posed recording, as monoloc build takes it, by its full path")
    parser.add_argument("--frames", default="0:300", help="START:STOP")
    parser.add_argument("--pairs", type=int, default=3)
    options = parser.parse_args()
    built = f"{options.frames}:3"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        old_tree = folder / "commit"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(old_tree), options.commit], check=True)
        try:
            sides = Side("commit", old_tree, folder / "old"), Side("this", ROOT, folder / "new")
        finally:
            subprocess.run([*git, "remove", "--force", str(old_tree)], check=True)
        if options.kind == "build":
            rounds = [[timed_build(side, options.source, built) for side in sides] for _ in range(options.pairs)]
        else:
            measure = pipeline if options.kind == "pipeline" else flight
            bundles = [untuned(side, options.source, built) for side in sides]
            rounds = [
                [
                    measure(side, bundle, options.source, options.frames, seed)
                    for side, bundle in zip(sides, bundles, strict=True)
                ]
                for seed in range(options.pairs)
            ]
    print(json.dumps({"commit": options.commit, "kind": options.kind, "figures": summary(rounds)}, indent=2))


if __name__ == "__main__":
    main()
