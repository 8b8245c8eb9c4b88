"""Work of a second thread."""

from __future__ import annotations

import threading
from functools import partial

import pytest

from monoloc.second_thread import SecondThread


@pytest.mark.parametrize("exists", [False, True])
def test_work_is_done_once_and_in_order_by_the_thread_that_should(exists: bool) -> None:
    second, done = SecondThread(exists), []

    def work(name: str) -> str:
        done.append((name, threading.get_ident()))
        return name

    first, later, never = (second.begin(partial(work, name)) for name in ("first", "later", "never"))
    unneeded = second.begin(partial(work, "unneeded"), is_needed=False)
    assert (first(), later(), first()) == ("first", "later", "first")
    second.begin(lambda: None)()  # all that was begun is done
    names, threads = zip(*done, strict=True)
    assert names == (("first", "later", "never") if exists else ("first", "later"))
    assert len(set(threads)) == 1 and (threads[0] == threading.get_ident()) is not exists
    assert unneeded() == "unneeded" and done[-1] == ("unneeded", threading.get_ident())
    assert never() == "never"


def test_a_forked_process_has_a_thread_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of the process before stays behind, and work for it would never be done."""
    second = SecondThread(True)
    before = second.begin(threading.get_ident)()
    monkeypatch.setattr("monoloc.second_thread.os.getpid", lambda: -1)
    after = second.begin(threading.get_ident)()
    assert after not in (before, threading.get_ident()) and second.begin(threading.get_ident)() == after


@pytest.mark.parametrize("exists", [False, True])
def test_error_is_raised_where_the_result_is_asked_for(exists: bool) -> None:
    result = SecondThread(exists).begin(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        result()
