"""The engine of ``monoloc reproduce``: every task once, when it can be, under a name that says all it depends on."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from monoloc.errors import DataError, SettingError
from monoloc.progress import NoProgress
from monoloc_lab.experiments.engine import TaskError, carry_out, check_scheduler, describe_task, do_task, in_order
from monoloc_lab.experiments.task import RESULT, TASK, Result, Task, read_result

Settings = dict[str, Any]
_WAIT_S = 20.0


def add(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """The sum of a number and of what is needed; leaves a file of its own in ``log`` whenever it is done."""
    log = Path(settings["log"])
    (log / f"{settings['number']}-{len(list(log.iterdir()))}").touch()
    (folder / "beside.txt").write_text("written")
    return {"sum": settings["number"] + sum(need.figures["sum"] for need in needs), "process": os.getpid()}


def meet(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """Done only once the other of two is at work too."""
    place = Path(settings["log"])
    (place / settings["name"]).touch()
    until = time.monotonic() + _WAIT_S
    while not (place / settings["other"]).exists():
        if time.monotonic() > until:
            raise TimeoutError("the other never came")
        time.sleep(0.01)
    return {"process": os.getpid()}


def linger(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """Never done."""
    (folder / "half").touch()
    (Path(settings["log"]) / "lingering").touch()
    time.sleep(600.0)
    return {}


def nap(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    (Path(settings["log"]) / settings["name"]).touch()
    time.sleep(1.0)
    return {}


def refuse(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    raise DataError("kitchen", "has no depth", "give another")


def stumble(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    raise ZeroDivisionError("a fault")


def fill(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """As on a full disk."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def threads(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    import cv2
    import torch

    return {"cv2": cv2.getNumThreads(), "torch": torch.get_num_threads(), "omp": os.environ["OMP_NUM_THREADS"]}


KINDS = {
    "add": add,
    "meet": meet,
    "linger": linger,
    "nap": nap,
    "refuse": refuse,
    "stumble": stumble,
    "fill": fill,
    "threads": threads,
}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    (tmp_path / "log").mkdir()
    return tmp_path / "log"


def number(log: Path, value: int, *needs: Task) -> Task:
    return Task.of("add", {"number": value, "log": str(log)}, needs)


def do(tasks: Sequence[Task], out: Path, workers: int = 1, scheduler: str | None = None) -> dict[Task, Result]:
    return dict(carry_out(tasks, out, NoProgress(), workers, scheduler, KINDS))


def done(log: Path) -> list[int]:
    return sorted(int(file.name.split("-")[0]) for file in log.iterdir())


# --- Names ---


def test_a_task_s_key_is_of_kind_settings_and_needs() -> None:
    needed = Task.of("bundle", {"seed": 0})
    tasks = [
        Task.of("run", {"seed": 0, "light": None}, [needed]),
        Task.of("depth", {"seed": 0, "light": None}, [needed]),
        Task.of("run", {"seed": 1, "light": None}, [needed]),
        Task.of("run", {"seed": 0, "light": "L3"}, [needed]),
        Task.of("run", {"seed": 0, "light": None}),
        Task.of("run", {"seed": 0, "light": None}, [Task.of("bundle", {"seed": 1})]),
    ]
    assert len({task.key for task in tasks}) == len(tasks)
    assert Task.of("run", {"light": None, "seed": 0}, [Task.of("bundle", {"seed": 0})]).key == tasks[0].key


def test_order_puts_needs_first_and_each_once(log: Path) -> None:
    base = number(log, 1)
    middle = [number(log, 2, base), number(log, 3, base)]
    top = number(log, 4, *middle)
    assert in_order([top, base]) == [base, *middle, top]


# --- Doing ---


def test_results_reach_what_needs_them(tmp_path: Path, log: Path) -> None:
    base = number(log, 1)
    top = number(log, 100, number(log, 10, base), base)
    results = do([top], tmp_path, workers=2)
    assert results[top].figures["sum"] == 112
    assert results[base].folder == tmp_path / "results" / base.key
    assert (results[base].folder / "beside.txt").read_text() == "written"
    described = json.loads((results[top].folder / "task.json").read_text())
    assert described["settings"]["number"] == 100 and described["needs"] == [need.key for need in top.needs]
    assert described["seconds"] == results[top].seconds > 0.0
    assert results[top].figures["process"] != os.getpid()


def test_what_is_done_is_not_done_again_unless_its_settings_change(tmp_path: Path, log: Path) -> None:
    base, other = number(log, 1), number(log, 2)
    do([number(log, 3, base), other], tmp_path)
    assert done(log) == [1, 2, 3]
    do([number(log, 3, base), other], tmp_path)
    assert done(log) == [1, 2, 3]
    # What needs the changed one is done again too; the other is not.
    changed = number(log, 5)
    results = do([number(log, 3, changed), other], tmp_path)
    assert done(log) == [1, 2, 3, 3, 5]
    assert results[number(log, 3, changed)].figures["sum"] == 8


def test_result_that_cannot_be_read_is_made_again(tmp_path: Path, log: Path) -> None:
    task = number(log, 1)
    do([task], tmp_path)
    for times, (name, torn) in enumerate(((RESULT, b'{"sum": '), (RESULT, b'{"sum\xc3'), (TASK, b"")), start=1):
        (tmp_path / "results" / task.key / name).write_bytes(torn)
        assert read_result(tmp_path, task) is None
        assert do([task], tmp_path)[task].figures["sum"] == 1
        assert done(log) == [1] * (1 + times)


def test_two_workers_work_at_the_same_time(tmp_path: Path, log: Path) -> None:
    pair = _pair(log)
    results = do(pair, tmp_path, workers=2)
    assert len({results[task].figures["process"] for task in pair}) == 2


def test_each_task_has_one_thread(tmp_path: Path) -> None:
    task = Task.of("threads", {})
    assert do([task], tmp_path)[task].figures == {"cv2": 1, "torch": 1, "omp": "1"}


def test_progress_counts_what_was_done_before(tmp_path: Path, log: Path) -> None:
    class Told(NoProgress):
        def __init__(self) -> None:
            self.lines: list[tuple[int, str]] = []

        def task(self, name: str, total: int | None) -> Any:
            from contextlib import nullcontext

            self.total = total
            return nullcontext(lambda done, remark="": self.lines.append((done, remark)))

    do([number(log, 1)], tmp_path)
    told = Told()
    carry_out([number(log, 1), number(log, 2)], tmp_path, told, 1, None, KINDS)
    assert told.total == 2
    assert told.lines[0] == (1, "1 done before") and told.lines[1][0] == 2 and "add-" in told.lines[1][1]


# --- Failing ---


def test_failing_task_names_itself_and_stops_only_what_needs_it(tmp_path: Path, log: Path) -> None:
    failing = Task.of("refuse", {"seed": 7})
    independent = number(log, 2, number(log, 1))
    with pytest.raises(TaskError, match=rf"refuse of seed 7 \({failing.key}\) failed: kitchen: has no depth"):
        do([failing, number(log, 9, failing), independent], tmp_path)
    assert done(log) == [1, 2]
    assert read_result(tmp_path, failing) is None
    assert not [left for left in (tmp_path / "results").iterdir() if left.name.startswith(f".{failing.key}")]


def test_fault_of_ours_comes_with_its_traceback_and_before_bad_input(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"stumble.* failed \(and 1 more\): (.|\n)*ZeroDivisionError: a fault"):
        do([Task.of("refuse", {}), Task.of("stumble", {})], tmp_path)


def test_folder_that_takes_no_result_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = do_task(Task.of("add", {}), tmp_path / "gone", KINDS)
    (tmp_path / "results").mkdir()
    full = do_task(Task.of("fill", {}), tmp_path, KINDS)
    for failure, folder, why in ((gone, tmp_path / "gone", "No such file"), (full, tmp_path, "No space left")):
        assert failure is not None and failure.is_input
        assert failure.message.startswith(f"{folder / 'results'}: cannot be written to ({why}")
        assert failure.message.endswith("; make room for it, or name a folder you can write to")
    assert list((tmp_path / "results").iterdir()) == []


def test_a_description_says_what_a_person_would(log: Path) -> None:
    config = {"adapt": {"tune": "all", "map_transform": True}}
    build = {"name": "kitchen", "frames": "0:300:3"}
    bundle = Task.of("bundle", {"network": "full-0.35", "config": config, "build": build, "seed": 0})
    assert describe_task(bundle) == (
        f"bundle of full-0.35, tune all + map, build kitchen 0:300:3, seed 0 ({bundle.key})"
    )
    walk = {"name": "kitchen", "frames": "300:400", "light": "L3"}
    run = Task.of("run", {"walk": walk, "seed": 4}, [bundle])
    assert describe_task(run) == (f"run of full-0.35, tune all + map, walk kitchen 300:400, L3, seed 4 ({run.key})")


# --- Cut off ---

_RUN = """
import sys
from pathlib import Path
from monoloc_lab.experiments.engine import carry_out
from monoloc_lab.experiments.task import Task
from monoloc.progress import NoProgress
from test_experiments_engine import KINDS, number
out, log = map(Path, sys.argv[1:])
first = number(log, 1)
carry_out([Task.of("linger", {"log": str(log)}, [first])], out, NoProgress(), 1, None, KINDS)
"""


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_is_cut_off_goes_on_where_it_was(tmp_path: Path, log: Path, sent: signal.Signals) -> None:
    script = [sys.executable, "-c", _RUN, str(tmp_path), str(log)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    with subprocess.Popen(
        script,
        env=environment,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        # A shell's background jobs have it ignored, and tests may run in one.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        _until(lambda: (log / "lingering").exists())
        process.send_signal(sent)
        process.wait(_WAIT_S)
        # What SIGKILL leaves behind of the workers; after Ctrl-C there is nothing left to end.
        if sent == signal.SIGKILL:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            _until(lambda: not _alive(process.pid))
    (log / "lingering").unlink()
    first = number(log, 1)
    assert read_result(tmp_path, first) is not None
    half_done = list((tmp_path / "results").glob(".linger-*"))
    assert half_done and not list((tmp_path / "results").glob("linger-*"))
    assert do([number(log, 2, first)], tmp_path)[number(log, 2, first)].figures["sum"] == 3
    assert done(log) == [1, 2]
    assert not any(folder.exists() for folder in half_done)


def test_two_runs_do_not_share_a_folder(tmp_path: Path, log: Path) -> None:
    script = [sys.executable, "-c", _RUN, str(tmp_path), str(log)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    with subprocess.Popen(script, env=environment, stderr=subprocess.DEVNULL, start_new_session=True) as process:
        _until(lambda: (log / "lingering").exists())
        with pytest.raises(SettingError, match=r"--out: another run is at work in .*; wait for it, or name another"):
            do([number(log, 5)], tmp_path)
        os.killpg(process.pid, signal.SIGKILL)


# --- On a cluster ---


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[int], str]]:
    """The address of a scheduler of this machine, with two workers of so many threads each."""
    distributed = pytest.importorskip("distributed")
    started: dict[int, str] = {}
    with ExitStack() as stack:

        def address(threads: int) -> str:
            if threads not in started:
                at = tmp_path_factory.mktemp("cluster") / "scheduler.json"
                stack.enter_context(_dask("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(at)))
                _until(at.exists)
                started[threads] = json.loads(at.read_text())["address"]
                count = ("--nworkers", "2", "--nthreads", str(threads))
                stack.enter_context(_dask("worker", started[threads], *count, "--no-dashboard"))
                with distributed.Client(started[threads], set_as_default=False) as client:
                    client.wait_for_workers(2, timeout=_WAIT_S)
            return started[threads]

        yield address


@contextmanager
def _dask(*words: str) -> Iterator[None]:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    command = [sys.executable, "-m", "dask", *words]
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True) as process:
        try:
            yield
        finally:
            os.killpg(process.pid, signal.SIGTERM)


@pytest.mark.slow
def test_a_scheduler_s_two_workers_share_the_work(tmp_path: Path, log: Path, cluster: Callable[[int], str]) -> None:
    pair = _pair(log)
    chain = Task.of("add", {"number": 3, "log": str(_made(tmp_path / "sums"))}, [number(_made(tmp_path / "ones"), 1)])
    results = do([*pair, chain], tmp_path, scheduler=cluster(1))
    assert len({results[task].figures["process"] for task in pair} | {os.getpid()}) == 3
    assert results[chain].figures["sum"] == 4
    # What a cluster has done, cores need not do again.
    assert do([chain], tmp_path)[chain].figures == results[chain].figures


def test_a_task_that_fails_on_a_cluster_names_itself(tmp_path: Path, cluster: Callable[[int], str]) -> None:
    with pytest.raises(TaskError, match=r"refuse of seed 7 .* failed: kitchen: has no depth; give another"):
        do([Task.of("refuse", {"seed": 7})], tmp_path, scheduler=cluster(1))


def test_what_a_cluster_has_not_begun_is_called_off_with_the_run(
    tmp_path: Path, log: Path, cluster: Callable[[int], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both workers are busy for a second when the run is cut off; a third task must never be done."""

    def cut_off(*_: Any, **__: Any) -> Any:
        _until(lambda: len(list(log.iterdir())) == 2)
        raise KeyboardInterrupt

    monkeypatch.setattr("monoloc_lab.experiments.engine.wait", cut_off)
    with pytest.raises(KeyboardInterrupt):
        do([Task.of("nap", {"log": str(log), "name": name}) for name in ("a", "b", "c")], tmp_path, 1, cluster(1))
    time.sleep(1.5)
    assert len(list(log.iterdir())) == 2


def test_workers_of_several_threads_are_refused(cluster: Callable[[int], str]) -> None:
    with pytest.raises(
        SettingError, match="several tasks in one process; start them with: --nworkers N --nthreads 1"
    ):
        check_scheduler(cluster(2))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense:/", "127.0.0.1"])
def test_no_scheduler(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monoloc_lab.experiments.engine._ANSWER_S", 0.5)
    with pytest.raises(SettingError, match=f"--dask: no scheduler answers at {address}; start one with"):
        check_scheduler(address)


def _pair(log: Path) -> list[Task]:
    names = ("one", "two")
    return [
        Task.of("meet", {"log": str(log), "name": name, "other": other}) for name, other in (names, reversed(names))
    ]


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def _until(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + _WAIT_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)
