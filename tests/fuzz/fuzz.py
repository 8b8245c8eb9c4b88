"""Damages files of every kind, guided by what the readers do with them, and prints what came of it.

    python tests/fuzz/fuzz.py [--runs N] [--keep] [KIND]...

Each kind (``TARGETS`` of ``hostile_files.py``) has a process of its own, in which Atheris (libFuzzer) changes the
file and keeps what reaches new code. A reader must return finite numbers or raise a MonolocError of one line, in ten
seconds and 2 GB. What does neither is written to ``build/fuzz`` and shown. ``--keep`` adds a few files of each kind
to ``corpus``, which the tests read, and from which the next search begins.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent / "support"))
OUT = ROOT / "build" / "fuzz"
SECONDS, MEGABYTES = 60, 2048  # of one file; on a busy machine, a tenth of it is its own
KEPT, MOST_BYTES = 4, 2048  # files of a kind, and size of each
CORPUS = HERE / "corpus"


def folder_of(kind: str) -> Path:
    return CORPUS / kind.replace(" ", "-")


# --- In the process of one kind ---


def search(kind: str, work: Path, runs: int) -> None:
    """Change one kind of file so many times; ``work/counts.json`` says what came of it so far."""
    import atheris

    with atheris.instrument_imports(include=["monoloc"], enable_loader_override=False):
        from hostile_files import NUMBERS, PIECES, TARGETS, check_finite
        from monoloc.errors import MonolocError
    warnings.simplefilter("ignore")  # of NumPy, about numbers that are then refused
    target = TARGETS[kind]
    path = work / "in" / target.file
    (work / "in").mkdir()
    target.make(path)
    target.read(path)
    seeds = work / "seeds"
    seeds.mkdir()
    (seeds / "whole").write_bytes(path.read_bytes())
    counts = {"tried": 0, "read": 0, "refused": 0, "longest_s": 0.0, "found": []}
    places: set[str] = set()
    log = os.open(work / "counts.json", os.O_WRONLY | os.O_CREAT)

    def one(data: bytes) -> None:
        path.write_bytes(data)
        began = time.process_time()
        try:
            check_finite(target.read(path))
            outcome = "read"
        except MonolocError as error:
            outcome = "refused"
            if "\n" in str(error):
                note(data, "an error of several lines", str(error))
        except Exception as error:
            outcome = "found"
            frame = traceback.extract_tb(error.__traceback__)[-1]
            ours = [each for each in traceback.extract_tb(error.__traceback__) if "monoloc" in each.filename]
            where = ours[-1] if ours else frame
            note(data, f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}", str(error))
        counts["tried"] += 1
        if outcome != "found":
            counts[outcome] += 1
        counts["longest_s"] = max(counts["longest_s"], time.process_time() - began)
        content = json.dumps(counts).encode()
        os.ftruncate(log, len(content))
        os.pwrite(log, content, 0)

    def note(data: bytes, what: str, text: str) -> None:
        if what in places:
            return
        places.add(what)
        name = f"{kind.replace(' ', '-')}-{len(places)}"
        (OUT / name).write_bytes(data)
        counts["found"].append({"what": what, "text": text[:200], "file": name})

    words = [each for each in (*NUMBERS, *PIECES) if 0 < len(each) <= 64]
    dictionary = "".join('"' + "".join(f"\\x{byte:02x}" for byte in word) + '"\n' for word in words)
    (work / "words").write_text(dictionary)
    (work / "new").mkdir()
    known = [str(folder_of(kind))] if folder_of(kind).is_dir() else []
    options = [f"-runs={runs}", "-seed=1", f"-timeout={SECONDS}", f"-rss_limit_mb={MEGABYTES}", "-len_control=0"]
    options += [f"-dict={work / 'words'}", f"-artifact_prefix={OUT}/{kind.replace(' ', '-')}-", "-verbosity=0"]
    options += [f"-max_len={max(1024, 2 * len(path.read_bytes()))}"]
    atheris.Setup([sys.argv[0], *options, str(work / "new"), str(seeds), *known], one)
    atheris.Fuzz()


# --- In the process of all ---


def run(kind: str, runs: int, keeps: bool) -> dict[str, object]:
    """Search one kind in a process of its own; returns its counts."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        command = [sys.executable, __file__, "--in", str(work), "--runs", str(runs), kind]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        counts = work / "counts.json"
        result = json.loads(counts.read_text()) if counts.exists() else {"tried": 0, "found": []}
        if done.returncode != 0 or not result["tried"]:
            reason = [line for line in done.stderr.splitlines() if "ERROR" in line or "Error" in line][-1:]
            what = reason[0] if reason else f"it ended with {done.returncode}"
            result["found"].append({"what": what, "text": "", "file": "(in build/fuzz)"})
        if keeps and (work / "new").is_dir():
            keep(kind, work / "new")
    return result


def keep(kind: str, new: Path) -> None:
    """Add the smallest files that reached new code to the corpus."""
    files = sorted(new.iterdir(), key=lambda file: (file.stat().st_size, file.name))
    small = [file for file in files if file.stat().st_size <= MOST_BYTES]
    folder_of(kind).mkdir(parents=True, exist_ok=True)
    for file in small[:: max(1, len(small) // KEPT)][:KEPT]:
        shutil.copy(file, folder_of(kind) / file.name[:12])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    parser.add_argument("--runs", type=int, default=5000, help="changed files of each kind")
    parser.add_argument("--keep", action="store_true", help="add a few files to the corpus")
    parser.add_argument("--in", dest="work", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    if given.work is not None:
        search(given.kinds[0], given.work, given.runs)
        return 0
    from hostile_files import TARGETS

    total, found = 0, 0
    print("| kind | tried | read | refused | longest | found |\n|---|---|---|---|---|---|", flush=True)
    for kind in given.kinds or TARGETS:
        result = run(kind, given.runs, given.keep)
        total, found = total + result["tried"], found + len(result["found"])
        what = "; ".join(f"{each['what']}: {each['text']} [{each['file']}]" for each in result["found"]) or "nothing"
        row = [kind, *(str(result.get(name, 0)) for name in ("tried", "read", "refused"))]
        print(f"| {' | '.join(row)} | {result.get('longest_s', 0.0):.2f} s | {what} |", flush=True)
    print(f"| {len(given.kinds or TARGETS)} kinds | {total} | | | | {found} |")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
