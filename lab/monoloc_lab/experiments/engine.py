"""Executes tasks on the cores of this machine or on a cluster, each once and as soon as its needs are done.

A result is a folder that is renamed into place when it is complete, so an interrupted run continues where it was. Its
name is a hash of all that it depends on, so it is reused only where it would be the same.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monoloc.errors import MissingExtraError, MonolocError, SettingError
from monoloc.progress import Progress, Step
from monoloc_lab.experiments.provenance import source_commit
from monoloc_lab.experiments.task import RESULT, TASK, Result, Results, Task, read_result
from monoloc_lab.experiments.work import KINDS, Work
from monoloc_lab.experiments.workload import tasks_to_do, time_to_do

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_NOT_WRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_ANSWER_S = 10.0  # time that a scheduler has to answer


class TaskError(MonolocError):
    """A task failed because of its input; the message names it."""


@dataclass(frozen=True)
class _Failure:
    """Why a task failed, in a form that can be passed between processes."""

    message: str
    is_input: bool


def carry_out(
    tasks: Sequence[Task],
    out: Path,
    progress: Progress,
    workers: int,
    scheduler: str | None = None,
    kinds: Mapping[str, Work] = KINDS,
) -> Results:
    """Execute tasks and all that they need, unless their results exist.

    A task that fails stops only the tasks that need it. The failure is raised after all other tasks are done.

    Args:
        out: results are in ``results`` below it; on a cluster, every machine must see it under this name.
        workers: number of processes on this machine, one thread each; not used with a scheduler.
        scheduler: address of a Dask scheduler whose workers execute the tasks, as ``tcp://host:8786``.
        kinds: the work of each kind of task.

    Returns:
        Results of the tasks and of all that they need.

    Raises:
        TaskError: a task failed because of its input; the first one is named. Or a worker process was killed.
        RuntimeError: a task failed because of an internal fault.
        SettingError: another run uses ``out``, or the scheduler cannot be used.
        MissingExtraError: joblib or Dask is not installed.
    """
    ordered = in_order(tasks)
    with _locked(out):
        results = {task: result for task in ordered if (result := read_result(out, task)) is not None}
        waiting = [task for task in ordered if task not in results]
        # Those that were done before are not counted: with them, a continued run would seem to be faster than it is.
        before = f" ({len(results)} more were done before)" if results else ""
        with progress.task(f"tasks{before}", len(waiting), alike=False) as show:
            if waiting:
                show(0, tasks_to_do(waiting, results))
                with _cluster(scheduler) if scheduler else _cores(min(workers, len(waiting)), out) as executor:
                    at_once = None if scheduler else workers
                    failures = _execute(waiting, results, out, executor, at_once, kinds, show)
                if failures:
                    raise _exception_of(failures)
    return results


def in_order(tasks: Sequence[Task]) -> list[Task]:
    """Tasks and all that they need, each once and after its needs."""
    ordered: dict[Task, None] = {}

    def add(task: Task) -> None:
        if task not in ordered:
            for needed in task.needs:
                add(needed)
            ordered[task] = None

    for task in tasks:
        add(task)
    return list(ordered)


def describe_task(task: Task) -> str:
    """A readable description of a task, with its key."""
    settings = task.settings
    parts = [settings.get("network"), settings.get("size"), settings.get("map")]
    needed = next((need for need in task.needs if need.kind == "bundle"), None)
    adapt = (settings if needed is None else needed.settings).get("config", {}).get("adapt")
    if needed is not None:
        parts.append(needed.settings["network"])
    if adapt is not None:
        parts.append(f"tune {adapt['tune']}{' + map' if adapt['map_transform'] else ''}")
    for role in ("build", "evaluation"):
        if role in settings:
            parts.append(f"{role} {settings[role]['name']} {settings[role]['frames']}")
    if (light := settings.get("evaluation", {}).get("light")) is not None:
        parts.append(light)
    if "seed" in settings:
        parts.append(f"seed {settings['seed']}")
    listed = ", ".join(str(part) for part in parts if part is not None)
    return f"{task.kind} of {listed} ({task.key})" if listed else f"{task.kind} ({task.key})"


def do_task(task: Task, out: Path, kinds: Mapping[str, Work] = KINDS) -> _Failure | None:
    """Execute one task whose needs are done, on one thread, and put its result into place."""
    results = out / "results"
    _on_one_thread()
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{task.key}.", dir=results))
    except OSError as error:
        return _write_failure(results, error)
    try:
        started, started_cpu = time.perf_counter(), time.process_time()
        needs = [_existing(out, need) for need in task.needs]
        figures = kinds[task.kind](task.settings, needs, folder)
        done: dict[str, Any] = {
            "kind": task.kind,
            "settings": task.settings,
            "needs": [need.key for need in task.needs],
            "commit": source_commit(),
        }
        done |= {"seconds": time.perf_counter() - started, "processor_seconds": time.process_time() - started_cpu}
        _write_json(folder / TASK, done)
        _write_json(folder / RESULT, figures)
        folder.chmod(0o755)
        place = results / task.key
        if place.exists():  # an unreadable result
            shutil.rmtree(place)
        folder.replace(place)
    except MonolocError as error:
        return _Failure(str(error), is_input=True)
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _NOT_WRITABLE:
            return _write_failure(results, error)
        return _Failure(traceback.format_exc(), is_input=False)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return None


def _write_failure(results: Path, error: OSError) -> _Failure:
    fix = "make room for it, or name a folder you can write to"
    return _Failure(f"{results}: cannot be written to ({error.strerror}); {fix}", is_input=True)


def _existing(out: Path, task: Task) -> Result:
    result = read_result(out, task)
    if result is None:
        raise SettingError("--out", f"{out} has no result {task.key} on this worker", "name a folder that all share")
    return result


def _execute(
    waiting: list[Task],
    results: dict[Task, Result],
    out: Path,
    executor: Executor,
    at_once: int | None,
    kinds: Mapping[str, Work],
    show: Step,
) -> dict[Task, _Failure]:
    """Execute every task once its needs are done; fills ``results`` and returns the failures.

    Args:
        waiting: in an order in which a task comes soon after its needs. The first that can start does, so that a run
            that is stopped leaves few bundles that were not flown.
        at_once: number of tasks that are submitted at a time, and begin then; None for a cluster, which queues them.
    """
    failures: dict[Task, _Failure] = {}
    before = len(results)
    running: dict[Future[_Failure | None], Task] = {}
    while waiting or running:
        ready = [task for task in waiting if all(need in results for need in task.needs)]
        for task in ready if at_once is None else ready[: at_once - len(running)]:
            waiting.remove(task)
            if at_once is not None:
                show(len(results) - before, f"begins {describe_task(task)}")
            running[executor.submit(do_task, task, out, kinds)] = task
        if not running:
            break  # the remaining tasks need failed ones
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            task = running.pop(future)
            failure = _outcome_of(future)
            result = read_result(out, task)
            if failure is None and result is None:
                failure = _Failure(f"{out} is not the folder that the workers see; name one that all share", True)
            if failure is not None:
                failures[task] = failure
            elif result is not None:
                results[task] = result
            show(len(results) - before, _ended(task, result, [*waiting, *running.values()], results))
    return failures


def _outcome_of(future: Future[_Failure | None]) -> _Failure | None:
    """The failure of a task, or None.

    Raises:
        TaskError: a worker process was killed; all tasks that ran then end so.
    """
    try:
        return future.result()
    except BrokenExecutor as error:
        if signal.SIGKILL.name not in str(error):  # but, as of a segmentation fault, an internal fault
            raise
        fix = "give fewer --workers, or free memory; the same command continues, and done tasks are kept"
        raise TaskError(f"--workers: one was killed, as a system does whose memory is full; {fix}") from error


def _ended(task: Task, result: Result | None, left: Sequence[Task], results: Results) -> str:
    """That a task ended or, without a result, failed, and what is left."""
    if result is None:
        return f"failed: {describe_task(task)}"
    left_s = time_to_do(left, results)
    return f"took {result.seconds:.0f} s: {describe_task(task)}{'; ' if left_s else ''}{left_s}"


def _exception_of(failures: Mapping[Task, _Failure]) -> Exception:
    """The first internal fault, or else the first failure because of input."""
    task, failure = next(((t, f) for t, f in failures.items() if not f.is_input), next(iter(failures.items())))
    others = "" if len(failures) == 1 else f" (and {len(failures) - 1} more)"
    message = f"{describe_task(task)} failed{others}: {failure.message}"
    return TaskError(message) if failure.is_input else RuntimeError(message)


@contextmanager
def _cores(workers: int, out: Path) -> Iterator[Executor]:
    """Processes on this machine; they are terminated at once, and leave nothing, if the block ends with an error."""
    try:
        from joblib.externals.loky import ProcessPoolExecutor
    except ImportError as error:
        raise MissingExtraError("spreading work over cores", "report") from error
    # loky replaces a process that holds much memory after a task; that is intended.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
    executor = ProcessPoolExecutor(workers, initializer=_ignore_interrupt, env=_ONE_THREAD)
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=True, kill_workers=True)
        _remove_incomplete(out)
        raise
    executor.shutdown(wait=True)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask scheduler; tasks that have not started are cancelled when the block ends."""
    try:
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
    except ImportError as error:
        raise MissingExtraError("spreading work over a cluster", "cluster", "monoloc-lab") from error
    try:
        # Checked first: a client that fails because of its address closes itself when it is collected, which can
        # delay the start of the next one.
        get_address_host_port(address)
        connect: Any = Client  # untyped
        client = connect(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        fix = "start one with: dask scheduler, and give its address"
        raise SettingError("--dask", f"no scheduler answers at {address}", fix) from error
    with client:
        workers = client.scheduler_info(n_workers=-1)["workers"]
        if not workers:
            raise SettingError(
                "--dask", f"{address} has no workers", f"start some: dask worker {address} --nthreads 1"
            )
        if any(worker["nthreads"] > 1 for worker in workers.values()):
            # Seeds and the number of threads are global in a process.
            problem = f"{address} has workers that do several tasks in one process"
            raise SettingError("--dask", problem, "start them with: --nworkers N --nthreads 1")
        yield client.get_executor()


def check_scheduler(address: str) -> None:
    """Refuse a scheduler that does not answer or has no suitable workers, before any work is done.

    Raises:
        SettingError, MissingExtraError: as :func:`carry_out`.
    """
    with _cluster(address):
        pass


def _ignore_interrupt() -> None:
    # Ctrl-C reaches all processes of a terminal; the parent ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _on_one_thread() -> None:
    """One thread per task, so that tasks do not compete for cores and repeat to the last bit."""
    import cv2

    cv2.setNumThreads(1)
    os.environ.update(_ONE_THREAD)  # for libraries that are not loaded yet
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    """Lock ``out/results``, and remove the incomplete results of an interrupted run."""
    import fcntl

    results = out / "results"
    results.mkdir(parents=True, exist_ok=True)
    with (results / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise SettingError("--out", f"another run is at work in {out}", "wait for it, or name another") from error
        _remove_incomplete(out)
        yield


def _remove_incomplete(out: Path) -> None:
    """Remove the folders of tasks that did not end, which no process writes to any more."""
    for left in (out / "results").glob(".*.*"):
        shutil.rmtree(left, ignore_errors=True)


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
