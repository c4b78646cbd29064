"""Run the long tests of what changed: those tiers of `tiers.toml` whose paths a change touches.

usage: python -m tests.tiers [BASE]    BASE: the commit before the change; by default where the branch left origin/main,
                                       on the main branch the commit before; when there is no git, every tier starts
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUDGET_MIN = 45.0
"""The limit of a whole run of CI is 90 minutes."""


@dataclass(frozen=True)
class Tier:
    """Long tests, what they prove, and the files and folders whose change starts them."""

    name: str
    proves: str
    paths: tuple[str, ...]
    tests: tuple[str, ...]
    minutes: float
    ci: bool = True

    def covers(self, changed: str) -> bool:
        return any(changed == path or changed.startswith(f"{path}/") for path in (*self.paths, *self.tests))


def load_tiers() -> list[Tier]:
    """Read the tiers in the order of the file."""
    tables = tomllib.loads((ROOT / "tests" / "tiers.toml").read_text(encoding="utf-8"))
    return [
        Tier(name, **(table | {"paths": tuple(table["paths"]), "tests": tuple(table["tests"])}))
        for name, table in tables.items()
    ]


def started_tiers(tiers: Iterable[Tier], changed: Iterable[str] | None) -> list[Tier]:
    """Return the tiers that a change of these files starts; every tier of CI when the change is unknown."""
    if changed is None:
        return [tier for tier in tiers if tier.ci]
    files = list(changed)
    return [tier for tier in tiers if tier.ci and any(tier.covers(file) for file in files)]


def within_budget(tiers: Iterable[Tier], budget_min: float) -> tuple[list[Tier], list[Tier]]:
    """Divide the tiers into those that fit into the budget, in their order, and the others."""
    fitting: list[Tier] = []
    others: list[Tier] = []
    for tier in tiers:
        fits = sum(one.minutes for one in fitting) + tier.minutes <= budget_min
        (fitting if fits else others).append(tier)
    return fitting, others


def changed_files(base: str | None) -> list[str] | None:
    """Return the files that differ from the base, uncommitted ones too; None where git knows no base."""
    base = base or _default_base()
    names = _git("diff", "--name-only", base) if base else None
    return None if names is None else names.splitlines()


def main() -> int:
    """Run the tiers; returns pytest's exit code."""
    changed = changed_files(sys.argv[1] if len(sys.argv) > 1 else None)
    fitting, others = within_budget(started_tiers(load_tiers(), changed), BUDGET_MIN)
    _say("unknown change" if changed is None else f"{len(changed)} changed files")
    for tier in fitting:
        _say(f"long tests of {tier.name}: {tier.proves}")
    for tier in others:
        _say(f"NOT RUN, as {BUDGET_MIN:g} minutes are full: {tier.name}; make test-all runs it")
    if not fitting:
        return 0
    tests = [test for tier in fitting for test in tier.tests]
    options = ["-n", "2", "--dist", "loadfile", "--durations=25", "-m", "slow and not board and not system"]
    return subprocess.run([sys.executable, "-m", "pytest", *options, *tests], cwd=ROOT, check=False).returncode


def _default_base() -> str | None:
    head = _git("rev-parse", "HEAD")
    left = _git("merge-base", "HEAD", "origin/main")
    return left if left and left != head else _git("rev-parse", "HEAD~1")


def _say(words: str) -> None:
    sys.stdout.write(f"{words}\n")
    sys.stdout.flush()


def _git(*arguments: str) -> str | None:
    try:
        run = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return None
    return run.stdout.strip() if run.returncode == 0 else None


if __name__ == "__main__":
    sys.exit(main())
