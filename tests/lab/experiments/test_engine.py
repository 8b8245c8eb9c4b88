"""The engine: every task once, after its needs; failures, interruption, worker processes and clusters."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import cv2
import pytest

from engine_kinds import KINDS, WAIT_S, number, pair
from monoloc.errors import SettingError
from monoloc.progress import NoProgress
from monoloc_lab.experiments import engine
from monoloc_lab.experiments.engine import TaskError, carry_out, check_scheduler, describe_task, do_task, in_order
from monoloc_lab.experiments.task import RESULT, TASK, Result, Task, read_result
from repository import on_one_thread

SUPPORT = Path(__file__).parents[2] / "support"


class InThisProcess(Executor):
    """Executes at once: starting a worker process takes seconds."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*arguments, **named))
        return future


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    @contextmanager
    def executor(workers: int, out: Path) -> Iterator[Executor]:
        yield InThisProcess()

    monkeypatch.setattr(engine, "_cores", executor)
    for name in engine._ONE_THREAD:
        monkeypatch.setenv(name, "1")
    before = cv2.getNumThreads()
    with on_one_thread():
        yield
    cv2.setNumThreads(before)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    (tmp_path / "log").mkdir()
    return tmp_path / "log"


def do(tasks: Sequence[Task], out: Path, workers: int = 1, scheduler: str | None = None) -> dict[Task, Result]:
    return dict(carry_out(tasks, out, NoProgress(), workers, scheduler, KINDS))


def executed(log: Path) -> list[int]:
    return sorted(int(file.name.split("-")[0]) for file in log.iterdir())


def wait_until(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def test_order_puts_needs_first_and_each_task_once(log: Path) -> None:
    base = number(log, 1)
    middle = [number(log, 2, base), number(log, 3, base)]
    top = number(log, 4, *middle)
    assert in_order([top, base]) == [base, *middle, top]


def test_description_names_kind_network_recordings_and_seed() -> None:
    config = {"adapt": {"tune": "all", "map_transform": True}}
    build = {"name": "kitchen", "frames": "0:300:3"}
    bundle = Task.of("bundle", {"network": "full-0.35", "config": config, "build": build, "seed": 0})
    assert describe_task(bundle) == (
        f"bundle of full-0.35, tune all + map, build kitchen 0:300:3, seed 0 ({bundle.key})"
    )
    evaluation = {"name": "kitchen", "frames": "300:400", "light": "L3"}
    run = Task.of("run", {"evaluation": evaluation, "seed": 4}, [bundle])
    assert describe_task(run) == (
        f"run of full-0.35, tune all + map, evaluation kitchen 300:400, L3, seed 4 ({run.key})"
    )


# --- Execution ---


@pytest.mark.usefixtures("in_this_process")
def test_results_reach_the_tasks_that_need_them(tmp_path: Path, log: Path) -> None:
    base = number(log, 1)
    top = number(log, 100, number(log, 10, base), base)
    results = do([top], tmp_path)
    assert results[top].figures["sum"] == 112
    assert results[base].folder == tmp_path / "results" / base.key
    assert (results[base].folder / "beside.txt").read_text() == "written"
    described = json.loads((results[top].folder / "task.json").read_text())
    assert described["settings"]["number"] == 100 and described["needs"] == [need.key for need in top.needs]
    assert described["seconds"] == results[top].seconds > 0.0


@pytest.mark.usefixtures("in_this_process")
def test_result_is_reused_unless_settings_change(tmp_path: Path, log: Path) -> None:
    base, other = number(log, 1), number(log, 2)
    for _ in range(2):
        do([number(log, 3, base), other], tmp_path)
        assert executed(log) == [1, 2, 3]
    # A task that needs a changed one is executed again; others are not.
    changed = number(log, 5)
    results = do([number(log, 3, changed), other], tmp_path)
    assert executed(log) == [1, 2, 3, 3, 5]
    assert results[number(log, 3, changed)].figures["sum"] == 8


@pytest.mark.usefixtures("in_this_process")
def test_unreadable_result_is_computed_again(tmp_path: Path, log: Path) -> None:
    task = number(log, 1)
    do([task], tmp_path)
    for times, (name, torn) in enumerate(((RESULT, b'{"sum": '), (RESULT, b'{"sum\xc3'), (TASK, b"")), start=1):
        (tmp_path / "results" / task.key / name).write_bytes(torn)
        assert read_result(tmp_path, task) is None
        assert do([task], tmp_path)[task].figures["sum"] == 1
        assert executed(log) == [1] * (1 + times)


@pytest.mark.usefixtures("in_this_process")
def test_progress_counts_what_is_left_to_do(tmp_path: Path, log: Path) -> None:
    class Recorded(NoProgress):
        def __init__(self) -> None:
            self.lines: list[tuple[int, str]] = []

        def task(self, name: str, total: int | None, alike: bool = True) -> Any:
            self.name, self.total, self.alike = name, total, alike
            return nullcontext(lambda done, remark="": self.lines.append((done, remark)))

    do([number(log, 1)], tmp_path)
    progress = Recorded()
    carry_out([number(log, 1), number(log, 2)], tmp_path, progress, 1, None, KINDS)
    assert progress.name == "tasks (1 more were done before)" and progress.total == 1 and not progress.alike
    begun, begins, ended = progress.lines
    assert begun == (0, "to do: add 1; about 0 s of one core left")
    assert begins == (0, f"begins {describe_task(number(log, 2))}")
    assert ended == (1, f"took 0 s: {describe_task(number(log, 2))}")


@pytest.mark.slow
def test_two_worker_processes_of_one_thread_run_at_the_same_time(tmp_path: Path, log: Path) -> None:
    tasks, threads = pair(log), Task.of("threads", {})
    results = do([*tasks, threads], tmp_path, workers=2)
    assert len({results[task].figures["process"] for task in tasks} | {os.getpid()}) == 3
    assert results[threads].figures == {"cv2": 1, "torch": 1, "omp": "1"}


# --- Failure ---


@pytest.mark.usefixtures("in_this_process")
def test_failed_task_is_named_and_stops_only_what_needs_it(tmp_path: Path, log: Path) -> None:
    failing = Task.of("refuse", {"seed": 7})
    independent = number(log, 2, number(log, 1))
    with pytest.raises(TaskError, match=rf"refuse of seed 7 \({failing.key}\) failed: kitchen: has no depth"):
        do([failing, number(log, 9, failing), independent], tmp_path)
    assert executed(log) == [1, 2]
    assert read_result(tmp_path, failing) is None
    assert not list((tmp_path / "results").glob(f".{failing.key}*"))


@pytest.mark.usefixtures("in_this_process")
def test_internal_fault_has_its_traceback_and_precedes_bad_input(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"crash.* failed \(and 1 more\): (.|\n)*ZeroDivisionError: a fault"):
        do([Task.of("refuse", {}), Task.of("crash", {})], tmp_path)


@pytest.mark.usefixtures("in_this_process")
def test_unwritable_folder_is_named(tmp_path: Path) -> None:
    absent = do_task(Task.of("add", {}), tmp_path / "absent", KINDS)
    (tmp_path / "results").mkdir()
    full = do_task(Task.of("fill", {}), tmp_path, KINDS)
    for failure, folder, why in ((absent, tmp_path / "absent", "No such file"), (full, tmp_path, "No space left")):
        assert failure is not None and failure.is_input
        assert failure.message.startswith(f"{folder / 'results'}: cannot be written to ({why}")
        assert failure.message.endswith("; make room for it, or name a folder you can write to")
    assert list((tmp_path / "results").iterdir()) == []


# --- Interruption ---

_RUN = """
import sys
from pathlib import Path
from monoloc_lab.experiments.engine import carry_out
from monoloc_lab.experiments.task import Task
from monoloc.progress import NoProgress
from engine_kinds import KINDS, number
out, log = map(Path, sys.argv[1:])
first = number(log, 1)
carry_out([Task.of("linger", {"log": str(log)}, [first])], out, NoProgress(), 1, None, KINDS)
"""


def start_run(out: Path, log: Path) -> subprocess.Popen[bytes]:
    """A process that executes a task that does not end."""
    return subprocess.Popen(
        [sys.executable, "-c", _RUN, str(out), str(log)],
        env={**os.environ, "PYTHONPATH": str(SUPPORT)},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        # Background jobs of a shell ignore it, and tests may run in one.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT])
def test_interrupted_run_continues(tmp_path: Path, log: Path, sent: signal.Signals) -> None:
    with start_run(tmp_path, log) as process:
        wait_until(lambda: (log / "lingering").exists())
        with pytest.raises(SettingError, match=r"--out: another run is at work in .*; wait for it, or name another"):
            do([number(log, 5)], tmp_path)
        process.send_signal(sent)
        process.wait(WAIT_S)
        if sent == signal.SIGKILL:  # the workers remain
            os.killpg(process.pid, signal.SIGKILL)
        else:
            wait_until(lambda: not is_alive(process.pid))
    (log / "lingering").unlink()
    first = number(log, 1)
    assert read_result(tmp_path, first) is not None
    incomplete = list((tmp_path / "results").glob(".linger-*"))
    assert len(incomplete) == (sent == signal.SIGKILL) and not list((tmp_path / "results").glob("linger-*"))
    assert do([number(log, 2, first)], tmp_path)[number(log, 2, first)].figures["sum"] == 3
    assert executed(log) == [1, 2]
    assert not any(folder.exists() for folder in incomplete)


@pytest.mark.slow
def test_killed_worker_is_said_in_a_line_and_the_run_continues(tmp_path: Path, log: Path) -> None:
    first, second = number(log, 1), Task.of("killed", {})
    with pytest.raises(TaskError, match=r"^--workers: one was killed, .* memory is full; give fewer --workers, or"):
        do([first, second], tmp_path)
    assert read_result(tmp_path, first) is not None
    assert not list((tmp_path / "results").glob(".killed-*"))


def is_alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_second_run_in_a_folder_is_refused(tmp_path: Path, log: Path) -> None:
    with (
        engine._locked(tmp_path),
        pytest.raises(SettingError, match=r"--out: another run is at work in .*; wait for it, or name another"),
    ):
        do([number(log, 5)], tmp_path)


# --- Clusters ---


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler with two workers of one thread."""
    distributed = pytest.importorskip("distributed")
    at = tmp_path_factory.mktemp("cluster") / "scheduler.json"
    with _dask("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(at)):
        wait_until(at.exists)
        address = json.loads(at.read_text())["address"]
        with _dask("worker", address, "--nworkers", "2", "--nthreads", "1", "--no-dashboard"):
            with distributed.Client(address, set_as_default=False) as client:
                client.wait_for_workers(2, timeout=WAIT_S)
            yield address


@contextmanager
def _dask(*arguments: str) -> Iterator[None]:
    environment = {**os.environ, "PYTHONPATH": str(SUPPORT)}
    command = [sys.executable, "-m", "dask", *arguments]
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True) as process:
        try:
            yield
        finally:
            os.killpg(process.pid, signal.SIGTERM)


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
def test_workers_of_a_cluster_share_the_tasks(tmp_path: Path, log: Path, cluster: str) -> None:
    for name in ("ones", "sums"):
        (tmp_path / name).mkdir()
    tasks = pair(log)
    chain = number(tmp_path / "sums", 3, number(tmp_path / "ones", 1))
    results = do([*tasks, chain], tmp_path, scheduler=cluster)
    assert len({results[task].figures["process"] for task in tasks} | {os.getpid()}) == 3
    assert results[chain].figures["sum"] == 4
    assert do([chain], tmp_path)[chain].figures == results[chain].figures  # reused without the cluster
    with pytest.raises(TaskError, match=r"refuse of seed 7 .* failed: kitchen: has no depth; give another"):
        do([Task.of("refuse", {"seed": 7})], tmp_path, scheduler=cluster)


@pytest.mark.slow
def test_interruption_cancels_tasks_of_a_cluster(
    tmp_path: Path, log: Path, cluster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both workers are busy for a second; a third task must not start."""

    def interrupt(*_: Any, **__: Any) -> Any:
        wait_until(lambda: len(list(log.iterdir())) == 2)
        raise KeyboardInterrupt

    monkeypatch.setattr(engine, "wait", interrupt)
    with pytest.raises(KeyboardInterrupt):
        do([Task.of("nap", {"log": str(log), "name": name}) for name in ("a", "b", "c")], tmp_path, 1, cluster)
    time.sleep(1.5)
    assert len(list(log.iterdir())) == 2


@pytest.mark.parametrize(
    ("workers", "message"),
    [
        ({}, "has no workers; start some: dask worker tcp://host:1 --nthreads 1"),
        ({"a": {"nthreads": 2}}, "several tasks in one process; start them with: --nworkers N --nthreads 1"),
    ],
)
def test_cluster_without_suitable_workers_is_refused(
    workers: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")

    class Client:
        def __init__(self, address: str, **settings: Any) -> None: ...

        def __enter__(self) -> Client:
            return self

        def __exit__(self, *error: object) -> None: ...

        def scheduler_info(self, n_workers: int) -> dict[str, Any]:
            return {"workers": workers}

    monkeypatch.setattr(distributed, "Client", Client)
    with pytest.raises(SettingError, match=message):
        check_scheduler("tcp://host:1")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense:/", "127.0.0.1"])
def test_absent_scheduler_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_ANSWER_S", 0.3)
    with pytest.raises(SettingError, match=f"--dask: no scheduler answers at {address}; start one with"):
        check_scheduler(address)
