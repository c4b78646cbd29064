"""No test is run by nobody: every slow one is in a tier, and a change starts the tiers that cover it."""

from __future__ import annotations

import re

import pytest

from tests.tiers import BUDGET_MIN, ROOT, Tier, changed_files, load_tiers, run_tiers, started_tiers

ONE = Tier("one", "", ("device/io",), ("tests/test_one.py",), 10.0)
TWO = Tier("two", "", ("host_sync",), ("tests/test_two.py",), 40.0)
RELEASE = Tier("release", "", (), ("tests/test_three.py",), 1.0, ci=False)


def test_every_slow_test_is_in_a_tier() -> None:
    slow = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "tests").rglob("test_*.py")
        if re.search(r"\bmark\.slow\b", path.read_text(encoding="utf-8")) and path.name != "test_tiers.py"
    }
    assert slow == {test for tier in load_tiers() for test in tier.tests}


def test_every_path_that_starts_a_tier_exists() -> None:
    missing = [path for tier in load_tiers() for path in tier.paths if not (ROOT / path).exists()]
    assert missing == []


def test_every_tier_of_ci_has_a_path_and_fits_into_the_budget() -> None:
    tiers = [tier for tier in load_tiers() if tier.ci]
    assert [tier.name for tier in tiers if not tier.paths or tier.minutes > BUDGET_MIN] == []


def test_a_change_starts_the_tiers_that_cover_it() -> None:
    tiers = [ONE, TWO, RELEASE]
    assert started_tiers(tiers, ["device/io/atomic.py"]) == [ONE]
    assert started_tiers(tiers, ["device/io_elsewhere.py", "README.md", "tests/test_three.py"]) == []
    assert started_tiers(tiers, ["tests/test_two.py", "device/io"]) == [ONE, TWO]


@pytest.mark.parametrize(("took_min", "left_out"), [(10.0, []), (5.1, []), (10.1, [TWO])])
def test_a_tier_runs_when_it_fits_into_what_is_left(took_min: float, left_out: list[Tier]) -> None:
    now_min = [100.0]
    ran = []

    def run(tier: Tier) -> bool:
        ran.append(tier)
        now_min[0] += took_min
        return tier is not ONE

    assert run_tiers([ONE, TWO], 50.0, run, lambda: now_min[0]) == ([ONE], left_out)
    assert [*ran, *left_out] == [ONE, TWO]


def test_a_base_that_git_does_not_know_is_an_unknown_change() -> None:
    assert changed_files("no-such-commit") is None
