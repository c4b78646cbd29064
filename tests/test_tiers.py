"""No test is run by nobody: every slow one is in a tier, and a change starts the tiers that cover it."""

from __future__ import annotations

import re

from tests.tiers import BUDGET_MIN, ROOT, Tier, changed_files, load_tiers, started_tiers, within_budget

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
    assert started_tiers(tiers, None) == [ONE, TWO]


def test_tiers_beyond_the_budget_are_named() -> None:
    assert within_budget([ONE, TWO], 50.0) == ([ONE, TWO], [])
    assert within_budget([ONE, TWO], 45.0) == ([ONE], [TWO])


def test_a_base_that_git_does_not_know_is_an_unknown_change() -> None:
    assert changed_files("no-such-commit") is None
