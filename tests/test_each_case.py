"""A check of many cases fails with every fault, and takes its fixtures."""

from pathlib import Path

import pytest
from each_case import each_case


def even(number: int, tmp_path: Path) -> None:
    assert tmp_path.is_dir()
    if number == 0:
        raise LookupError("none")
    assert number % 2 == 0


test_all_are_even = each_case([2, 4])(even)


def test_every_fault_is_named(tmp_path: Path) -> None:
    with pytest.raises(pytest.fail.Exception, match=r"(?s)^3 of 4\n1: .*\n0: none\n3: "):
        each_case([1, 2, 0, 3], LookupError)(even)(tmp_path=tmp_path)  # type: ignore[call-arg]


def test_no_case_at_all_is_a_fault(tmp_path: Path) -> None:
    with pytest.raises(pytest.fail.Exception, match="0 of 0"):
        each_case([])(even)(tmp_path=tmp_path)  # type: ignore[call-arg]
