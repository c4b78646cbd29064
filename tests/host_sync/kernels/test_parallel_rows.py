"""Bands of rows: every row once, in any thread, and no error lost in another thread."""

from __future__ import annotations

from collections import Counter
from threading import Event, get_ident

import numba
import pytest

from host_sync.kernels import parallel_rows as row_bands
from host_sync.kernels.parallel_rows import BackgroundCall, parallel_rows

PATIENCE_S = 20.0


@pytest.fixture
def three_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulates a machine with three cores, on which no field is small."""
    monkeypatch.setattr(row_bands, "get_num_threads", lambda: 3)
    monkeypatch.setattr(row_bands, "SMALL_PX", 1)


@pytest.mark.usefixtures("three_threads")
@pytest.mark.parametrize("rows", [1, 2, 7, 36, 101])
def test_every_row_is_worked_on_once_and_bands_begin_at_even_rows(rows: int) -> None:
    seen: Counter[int] = Counter()
    begun: list[int] = []

    def kernel(name: str, first: int, last: int) -> None:
        assert name == "field"
        begun.append(first)
        seen.update(range(first, last))

    parallel_rows(kernel, (rows, 10), "field")
    assert seen == Counter(range(rows))
    assert all(first % 2 == 0 for first in begun)


@pytest.mark.usefixtures("three_threads")
def test_another_thread_works_too_and_its_error_is_the_callers() -> None:
    helped = Event()
    caller = get_ident()

    def kernel(first: int, last: int) -> None:
        if get_ident() == caller:
            assert helped.wait(PATIENCE_S)
        else:
            helped.set()
            raise ValueError("in a helper")

    with pytest.raises(ValueError, match="in a helper"):
        parallel_rows(kernel, (60, 10))


def test_a_call_beside_is_made_once_by_a_helper_on_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_bands, "get_num_threads", lambda: 3)
    begun = Event()
    seen: list[tuple[int, int, bool]] = []

    def work(number: int) -> int:
        seen.append((get_ident(), numba.get_num_threads(), begun.wait(PATIENCE_S)))
        return number + 1

    beside = BackgroundCall(work, 1)
    beside.start()
    begun.set()
    assert [beside.result(), beside.result()] == [2, 2]
    ((thread, threads, went_on),) = seen
    assert thread != get_ident()
    assert threads == 1
    assert went_on


def test_a_caller_of_one_thread_makes_the_call_itself_and_an_error_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_bands, "get_num_threads", lambda: 1)
    assert BackgroundCall(lambda _: get_ident(), None).result() == get_ident()
    monkeypatch.setattr(row_bands, "get_num_threads", lambda: 3)
    with pytest.raises(ZeroDivisionError):
        BackgroundCall(lambda number: 1 // number, 0).result()


def test_a_small_field_stays_with_its_caller() -> None:
    threads = []
    parallel_rows(lambda *band: threads.append((get_ident(), band)), (30, 40))
    assert threads == [(get_ident(), (0, 30))]
