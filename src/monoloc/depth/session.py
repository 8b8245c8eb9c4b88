"""onnxruntime's sessions of networks that may come from anywhere: checked, and bounded in memory and time."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import onnxruntime

from monoloc.depth.network_check import check_network
from monoloc.errors import DataError

_TICK_S = 0.5
_MOST_BYTES = 2 << 30  # weights and intermediate results of all networks of this process


def load_session(content: bytes, label: str | Path, threads: int = 1) -> onnxruntime.InferenceSession:
    """Load an ONNX network for the CPU.

    Args:
        content: the ONNX file.
        label: name of the network in error messages.
        threads: threads for one operator.

    Raises:
        DataError: the network cannot be loaded, or is refused by :func:`monoloc.depth.network_check.check_network`.
    """
    check_network(content, label)
    _bound_memory()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4  # errors are raised and reported in one line
    options.add_session_config_entry("session.load_model_format", "ONNX")  # the only one that was checked
    options.add_session_config_entry("session.use_env_allocators", "1")
    # Without it, sums of 8-bit products overflow on x86 processors that lack VNNI.
    options.add_session_config_entry("session.x64quantprecision", "1")
    # What loading computes is not bounded, what a run computes is; no shipped network is slower for it.
    options.add_session_config_entry("optimization.disable_specified_optimizers", "ConstantFolding")
    providers = ["CPUExecutionProvider"]
    try:
        # A fallback prints what went wrong on stdout, and tries the same again.
        session = onnxruntime.InferenceSession(content, options, providers=providers, enable_fallback=0)
        session.get_modelmeta().custom_metadata_map  # noqa: B018 - raises, as what follows, where it is no text
        for entry in (*session.get_inputs(), *session.get_outputs()):
            entry.name, entry.shape  # noqa: B018
        return session
    except Exception as error:  # onnxruntime's exceptions derive directly from Exception
        fix = "give one self-contained ONNX file, such as monoloc depth export writes"
        raise DataError(label, f"cannot be loaded ({first_line(error)})", fix) from error


@contextmanager
def run_within(seconds: float) -> Iterator[onnxruntime.RunOptions]:
    """Options of a run that ends half a second after a time at most, but only between two operators."""
    options, ends_s = onnxruntime.RunOptions(), _watched_runs()
    ends_s[options] = time.monotonic() + seconds
    try:
        yield options
    finally:
        del ends_s[options]


def first_line(error: Exception) -> str:
    """First line of onnxruntime's error message."""
    return (str(error).splitlines() or ["no reason given"])[0]


@cache
def _watched_runs() -> dict[onnxruntime.RunOptions, float]:
    """Runs and when they must end. One thread watches all: a thread of its own takes a run a tenth longer."""
    ends_s: dict[onnxruntime.RunOptions, float] = {}

    def watch() -> None:
        while True:
            time.sleep(_TICK_S)
            for options, end_s in list(ends_s.items()):
                if time.monotonic() > end_s:
                    options.terminate = True

    threading.Thread(target=watch, name="network watchdog", daemon=True).start()
    return ends_s


if hasattr(os, "register_at_fork"):  # the thread stays behind
    os.register_at_fork(after_in_child=_watched_runs.cache_clear)


@cache
def _bound_memory() -> None:
    """Give onnxruntime's environment, of which a process has one, a bounded allocator."""
    kind, purpose = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, onnxruntime.OrtMemType.DEFAULT
    onnxruntime.create_and_register_allocator(
        onnxruntime.OrtMemoryInfo("Cpu", kind, 0, purpose), onnxruntime.OrtArenaCfg({"max_mem": _MOST_BYTES})
    )
