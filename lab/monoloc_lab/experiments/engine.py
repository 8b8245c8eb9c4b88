"""Does tasks, each once, each as soon as what it needs is done, over cores or over a cluster.

A result is a folder that is put into its place whole, so a run that was cut off goes on where it was. It is named by
all that it depends on, so it is used again only where it would come out the same.
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
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monoloc.errors import MissingExtraError, MonolocError, SettingError
from monoloc.progress import Progress
from monoloc_lab.experiments.task import RESULT, TASK, Result, Results, Task, read_result
from monoloc_lab.experiments.work import KINDS, Work

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_NO_PLACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_ANSWER_S = 10.0  # for a scheduler to answer


class TaskError(MonolocError):
    """A task that its input made impossible: the message names it."""


@dataclass(frozen=True)
class _Failure:
    """Why a task was not done, in words that can cross between processes."""

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
    """Do tasks and all that they need, unless their results are there.

    A task that fails stops only what needs it; it is raised when all else is done.

    Args:
        out: results lie under ``results``; on a cluster, every machine must see it under this name.
        workers: processes of this machine, one thread each; not used with a scheduler.
        scheduler: address of a Dask scheduler whose workers do the work, as ``tcp://host:8786``.
        kinds: what does each kind of task.

    Returns:
        Results of the tasks and of what they need.

    Raises:
        TaskError: a task failed by its input; the first such is named.
        RuntimeError: a task failed by a fault of ours.
        SettingError: another run is at work in ``out``, or the scheduler cannot be used.
        MissingExtraError: joblib, or Dask, is not installed.
    """
    ordered = in_order(tasks)
    with _alone(out):
        results = {task: result for task in ordered if (result := read_result(out, task)) is not None}
        waiting = [task for task in ordered if task not in results]
        with progress.task("tasks", len(ordered)) as show:
            if results:
                show(len(results), f"{len(results)} done before")
            if waiting:
                with _cluster(scheduler) if scheduler else _cores(min(workers, len(waiting))) as executor:
                    failures = _spread(waiting, results, out, executor, kinds, show)
                if failures:
                    raise _worst(failures)
    return results


def in_order(tasks: Sequence[Task]) -> list[Task]:
    """Tasks and all that they need, each once, none before what it needs."""
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
    """A task as a person would call it, with its key."""
    settings = task.settings
    parts = [settings.get("network"), settings.get("size"), settings.get("map")]
    needed = next((need for need in task.needs if need.kind == "bundle"), None)
    adapt = (settings if needed is None else needed.settings).get("config", {}).get("adapt")
    if needed is not None:
        parts.append(needed.settings["network"])
    if adapt is not None:
        parts.append(f"tune {adapt['tune']}{' + map' if adapt['map_transform'] else ''}")
    for role in ("build", "walk"):
        if role in settings:
            parts.append(f"{role} {settings[role]['name']} {settings[role]['frames']}")
    if (light := settings.get("walk", {}).get("light")) is not None:
        parts.append(light)
    if "seed" in settings:
        parts.append(f"seed {settings['seed']}")
    words = ", ".join(str(part) for part in parts if part is not None)
    return f"{task.kind} of {words} ({task.key})" if words else f"{task.kind} ({task.key})"


def do_task(task: Task, out: Path, kinds: Mapping[str, Work] = KINDS) -> _Failure | None:
    """Do one task whose needs are done, and put its result into its place; on one thread."""
    results = out / "results"
    _on_one_thread()
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{task.key}.", dir=results))
    except OSError as error:
        return _not_written(results, error)
    try:
        started, started_cpu = time.perf_counter(), time.process_time()
        needs = [_there(out, need) for need in task.needs]
        figures = kinds[task.kind](task.settings, needs, folder)
        done: dict[str, Any] = {
            "kind": task.kind,
            "settings": task.settings,
            "needs": [need.key for need in task.needs],
        }
        done |= {"seconds": time.perf_counter() - started, "processor_seconds": time.process_time() - started_cpu}
        _write_json(folder / TASK, done)
        _write_json(folder / RESULT, figures)
        folder.chmod(0o755)
        place = results / task.key
        if place.exists():  # what a reader could not make sense of
            shutil.rmtree(place)
        folder.replace(place)
    except MonolocError as error:
        return _Failure(str(error), is_input=True)
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _NO_PLACE:
            return _not_written(results, error)
        return _Failure(traceback.format_exc(), is_input=False)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return None


def _not_written(results: Path, error: OSError) -> _Failure:
    fix = "make room for it, or name a folder you can write to"
    return _Failure(f"{results}: cannot be written to ({error.strerror}); {fix}", is_input=True)


def _there(out: Path, task: Task) -> Result:
    result = read_result(out, task)
    if result is None:
        raise SettingError("--out", f"{out} has no result {task.key} on this worker", "name a folder that all share")
    return result


def _spread(
    waiting: list[Task],
    results: dict[Task, Result],
    out: Path,
    executor: Executor,
    kinds: Mapping[str, Work],
    show: Any,
) -> dict[Task, _Failure]:
    """Hand every task out once its needs are done; fills ``results`` and returns what failed."""
    failures: dict[Task, _Failure] = {}
    at_work: dict[Future[_Failure | None], Task] = {}
    while waiting or at_work:
        for task in [task for task in waiting if all(need in results for need in task.needs)]:
            waiting.remove(task)
            at_work[executor.submit(do_task, task, out, kinds)] = task
        if not at_work:
            break  # what is left needs what failed
        for future in wait(at_work, return_when=FIRST_COMPLETED).done:
            task = at_work.pop(future)
            failure = future.result()
            result = read_result(out, task)
            if failure is None and result is None:
                failure = _Failure(f"{out} is not the folder that the workers see; name one that all share", True)
            if failure is not None:
                failures[task] = failure
            elif result is not None:
                results[task] = result
            show(len(results), f"{'failed: ' if failure else ''}{describe_task(task)}")
    return failures


def _worst(failures: Mapping[Task, _Failure]) -> Exception:
    """A fault of ours, if there is one, else the first that is the input's."""
    task, failure = next(((t, f) for t, f in failures.items() if not f.is_input), next(iter(failures.items())))
    others = "" if len(failures) == 1 else f" (and {len(failures) - 1} more)"
    message = f"{describe_task(task)} failed{others}: {failure.message}"
    return TaskError(message) if failure.is_input else RuntimeError(message)


@contextmanager
def _cores(workers: int) -> Iterator[Executor]:
    """Processes of this machine; ended at once, whatever they do, when the block is left by an error."""
    try:
        from joblib.externals.loky import ProcessPoolExecutor
    except ImportError as error:
        raise MissingExtraError("spreading work over cores", "report") from error
    # A process that holds much memory when a task is done makes way for a new one, as it should.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
    executor = ProcessPoolExecutor(workers, initializer=_ignore_interrupt, env=_ONE_THREAD)
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=True, kill_workers=True)
        raise
    executor.shutdown(wait=True)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask scheduler; what they have not begun is called off when the block is left."""
    try:
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
    except ImportError as error:
        raise MissingExtraError("spreading work over a cluster", "cluster", "monoloc-lab") from error
    try:
        # Asked first: a client that fails for its address closes itself whenever it is collected, which can
        # hold up the next one's start.
        get_address_host_port(address)
        connect: Any = Client  # which is not typed
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
            # Seeds, and the number of threads, are a process's.
            problem = f"{address} has workers that do several tasks in one process"
            raise SettingError("--dask", problem, "start them with: --nworkers N --nthreads 1")
        yield client.get_executor()


def check_scheduler(address: str) -> None:
    """Refuse a scheduler that does not answer or has no fit workers, before the work is done.

    Raises:
        SettingError, MissingExtraError: as :func:`carry_out`.
    """
    with _cluster(address):
        pass


def _ignore_interrupt() -> None:
    # Ctrl-C goes to all processes of a terminal; the first of them ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _on_one_thread() -> None:
    """As many tasks as cores, each on one thread, so that they do not fight, and repeat to the last bit."""
    import cv2

    cv2.setNumThreads(1)
    os.environ.update(_ONE_THREAD)  # for what is not loaded yet
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Hold ``out/results``, and clear away what a run that was cut off has left half done."""
    import fcntl

    results = out / "results"
    results.mkdir(parents=True, exist_ok=True)
    with (results / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise SettingError("--out", f"another run is at work in {out}", "wait for it, or name another") from error
        for left in results.glob(".*.*"):
            shutil.rmtree(left, ignore_errors=True)
        yield


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
