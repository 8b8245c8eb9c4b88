"""Time of the whole step, frame by frame, in a separate process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from monoloc.errors import MonolocError

# Set before the child imports NumPy: every library on one thread.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class PipelineFigures:
    """JSON keys of ``monoloc bench pipeline``.

    Attributes:
        step_ms_median, step_ms_p95: processor time of one frame, without reading its file.
        stage_ms: mean of each stage; their sum is the mean of a step.
        peak_memory_mb: of the whole process.
    """

    step_ms_median: float
    step_ms_p95: float
    stage_ms: dict[str, float]
    peak_memory_mb: float


def bench_pipeline(bundle: Path, source: str, frames: str, seed: int) -> PipelineFigures:
    """Localise a recording in a new process, on one thread, and time it.

    Raises:
        MonolocError: the process refuses its input.
    """
    command = [sys.executable, "-m", "monoloc_lab.bench.steps", str(bundle), source, frames, str(seed)]
    # In a session of its own, Ctrl-C does not reach it, of which it would print a traceback; run() ends it.
    done = subprocess.run(
        command, env=os.environ | _ONE_THREAD, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    if done.returncode == 2:
        raise MonolocError(done.stdout.strip())
    done.check_returncode()
    return PipelineFigures(**json.loads(done.stdout))
