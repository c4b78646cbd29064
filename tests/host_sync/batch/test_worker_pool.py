"""Processes that die: nothing is lost, nothing comes twice, and what kills every process is given up."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from mortal_work import Environment, Squares

from host_sync.batch.worker_pool import ATTEMPTS, ONE_THREAD, Lost, outcomes_of


def begun(folder: Path) -> Counter[int]:
    return Counter(int(line) for line in (folder / "begun").read_text().split())


@pytest.mark.parametrize("workers", [1, 2])
def test_the_task_of_a_killed_process_is_done_by_another(tmp_path: Path, workers: int) -> None:
    found = list(outcomes_of(range(6), Squares(tmp_path, deadly=(0, 4)), workers))
    assert sorted(found) == [(number, number * number) for number in range(6)]
    assert begun(tmp_path) == {0: 2, 1: 1, 2: 1, 3: 1, 4: 2, 5: 1}


def test_a_task_that_kills_every_process_is_given_up_and_the_rest_is_done(tmp_path: Path) -> None:
    found = dict(outcomes_of(range(4), Squares(tmp_path, fatal=(1,)), 2))
    lost = found.pop(1)
    assert isinstance(lost, Lost)
    assert lost.exit_code == -9
    assert "ended 3 times (signal 9)" in lost.reason
    assert found == {0: 0, 2: 4, 3: 9}
    assert begun(tmp_path)[1] == ATTEMPTS


def test_tasks_are_asked_for_when_a_process_is_free(tmp_path: Path) -> None:
    asked: list[int] = []

    def tasks() -> Iterator[int]:
        for number in range(5):
            asked.append(number)
            yield number

    for done, _ in enumerate(outcomes_of(tasks(), Squares(tmp_path), 2)):
        assert len(asked) <= done + 2


def test_the_first_task_is_done_before_another_begins_where_that_is_asked_for(tmp_path: Path) -> None:
    outcomes = outcomes_of(range(3), Squares(tmp_path), 2, first_alone=True)
    assert next(outcomes) == (0, 0)
    assert begun(tmp_path) == {0: 1}
    assert sorted(outcomes) == [(1, 1), (2, 4)]


def test_every_process_computes_with_one_thread_and_the_caller_as_before() -> None:
    before = dict(os.environ)
    assert dict(outcomes_of(ONE_THREAD, Environment(), 1)) == ONE_THREAD
    assert dict(os.environ) == before
