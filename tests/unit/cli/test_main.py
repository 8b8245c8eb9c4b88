"""The launcher: exit codes, signals, and streams that cannot print everything."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from cli_helpers import listing, python, run_as_command
from monoloc.cli import app
from monoloc.cli.main import invoke

INTERRUPTED = (130, "monoloc: interrupted; nothing half-written is left\n")


def test_interrupted_write_leaves_no_partial_file(tmp_path: Path) -> None:
    """A file is written next to its place first."""
    code = (
        "import os, signal, pathlib, numpy as np\n"
        "from monoloc.io.tum_trajectory import write_tum\n"
        "write = pathlib.Path.write_bytes\n"
        "def stopped(path, content):\n"
        "    write(path, content[:10])\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "pathlib.Path.write_bytes = stopped\n" + run_as_command("write_tum('trajectory.txt', [0.0], np.eye(4)[None])")
    )
    before = listing(tmp_path)
    result = python(code, here=tmp_path)
    assert (result.returncode, result.stderr) == INTERRUPTED
    assert listing(tmp_path) == before


def test_ctrl_c_ends_the_command_during_imports(tmp_path: Path) -> None:
    """Also where a library turns it into an error of its own, as ONNX Runtime does."""
    code = (
        "import os, signal, sys\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'onnxruntime':\n"
        "            try:\n"
        "                os.kill(os.getpid(), signal.SIGINT)\n"
        "            except KeyboardInterrupt as error:\n"
        "                raise ImportError('initialization failed') from error\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from monoloc.cli.main import run; run()"
    )
    result = python(code, here=tmp_path)
    assert (result.returncode, result.stderr) == INTERRUPTED


def test_ignored_hang_up_remains_ignored_and_ascii_terminals_get_a_substitute(tmp_path: Path) -> None:
    """As under nohup, and for the degree sign of tables."""
    code = (
        "import io, signal, sys\n"
        "sys.stdout = io.TextIOWrapper(sys.stdout.buffer, encoding='ascii')\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        + run_as_command("print('2\\u00b0', signal.getsignal(signal.SIGHUP) is signal.SIG_IGN) or 0")
    )
    result = python(code, here=tmp_path)
    assert (result.returncode, result.stdout) == (0, "2? True\n"), result.stderr


@pytest.mark.slow
def test_commands_sum_on_one_thread_whatever_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another number of threads gives other poses."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    code = (
        "import sys\n"
        "from monoloc.cli import main\n"
        "sys.argv[1:] = ['--version']\n"
        "try:\n"
        "    main.run()\n"
        "except SystemExit:\n"
        "    from threadpoolctl import threadpool_info\n"
        "    print({pool['num_threads'] for pool in threadpool_info() if pool['internal_api'] == 'openblas'})\n"
    )
    result = python(code)
    assert result.stdout.splitlines()[-1] == "{1}", result.stderr


def test_file_without_permission_is_named(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def closed(_: list[str]) -> int:
        raise PermissionError(errno.EACCES, "Permission denied", "room.monoloc")

    monkeypatch.setattr(app, "carry_out", closed)
    assert invoke([]) == 2
    assert capfd.readouterr().err.startswith("monoloc: room.monoloc: Permission denied; check that ")


def test_internal_error_is_not_reported_as_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends with a traceback, for which Python gives exit code 1."""

    def fail(_: list[str]) -> int:
        raise RuntimeError("an internal error")

    monkeypatch.setattr(app, "carry_out", fail)
    with pytest.raises(RuntimeError, match="an internal error"):
        invoke([])
