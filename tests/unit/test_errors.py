"""Errors of input come back from other processes as they were."""

from __future__ import annotations

import importlib
import inspect
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from monoloc.bundle import read_bundle
from monoloc.errors import BundleError, MonolocError

# Every module that defines one.
for module in ("cli.app", "cli.streams"):
    importlib.import_module(f"monoloc.{module}")
for module in ("baselines.posenet_training", "experiments.engine"):
    importlib.import_module(f"monoloc_lab.{module}")


def kinds(base: type[MonolocError] = MonolocError) -> Iterator[type[MonolocError]]:
    yield base
    for kind in base.__subclasses__():
        yield from kinds(kind)


@pytest.mark.parametrize("kind", list(kinds()), ids=lambda kind: kind.__name__)
def test_error_of_another_process_is_the_same(kind: type[MonolocError]) -> None:
    taken = inspect.signature(kind.__init__).parameters.values()
    required = [each.name for each in taken if each.kind is each.POSITIONAL_OR_KEYWORD and each.default is each.empty]
    error = kind(*(required[1:] or ["the message"]))
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        again = pickle.loads(pickle.dumps(error, protocol))
        assert type(again) is kind and str(again) == str(error) and vars(again) == vars(error)


def test_all_kinds_are_tested() -> None:
    names = {kind.__name__ for kind in kinds()}
    assert {"DataError", "SettingError", "BundleError", "MissingExtraError", "ReaderGoneError", "TaskError"} <= names


def test_pool_says_what_failed(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        failed = pool.submit(read_bundle, tmp_path)
        with pytest.raises(BundleError, match="is not a bundle") as raised:
            failed.result(timeout=60)
    assert raised.value.path == tmp_path
