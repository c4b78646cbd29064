"""Run the long tests of what changed: those tiers of `tiers.toml` whose paths a change touches.

usage: python -m tests.tiers [BASE]    BASE: the commit before the change; by default where the branch left origin/main,
                                       on the main branch the commit before; where git knows neither, no tier starts
"""

from __future__ import annotations

import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable
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


def started_tiers(tiers: Iterable[Tier], changed: Iterable[str]) -> list[Tier]:
    """Return the tiers that a change of these files starts."""
    files = list(changed)
    return [tier for tier in tiers if tier.ci and any(tier.covers(file) for file in files)]


def run_tiers(
    tiers: Iterable[Tier], budget_min: float, run: Callable[[Tier], bool], now_min: Callable[[], float]
) -> tuple[list[Tier], list[Tier]]:
    """Run the tiers that fit into the budget, in their order; return those that failed and those that did not run."""
    began_min = now_min()
    failed: list[Tier] = []
    left_out: list[Tier] = []
    for tier in tiers:
        if now_min() - began_min + tier.minutes > budget_min:
            left_out.append(tier)
        elif not run(tier):
            failed.append(tier)
    return failed, left_out


def changed_files(base: str | None) -> list[str] | None:
    """Return the files that differ from the base, uncommitted ones too; None where git knows no base."""
    base = base or _default_base()
    names = _git("diff", "--name-only", base) if base else None
    return None if names is None else names.splitlines()


def main() -> int:
    """Run the tiers; returns 1 when one failed."""
    base = sys.argv[1] if len(sys.argv) > 1 else None
    changed = changed_files(base)
    if changed is None:
        _say(
            f"NO LONG TEST RUN: git does not know the commit before the change ({base or 'a shallow clone?'}): "
            "make test-changed BASE=COMMIT runs the long tests of a change, make test-all every test"
        )
        return 1 if base else 0
    started = started_tiers(load_tiers(), changed)
    _say(f"{len(changed)} changed files start the long tests of {', '.join(one.name for one in started) or 'nothing'}")
    failed, left_out = run_tiers(started, BUDGET_MIN, _passes, lambda: time.monotonic() / 60.0)
    for tier in left_out:
        _say(f"NOT RUN, as {BUDGET_MIN:g} minutes are full: {tier.name}; make test-all runs it")
    for tier in failed:
        _say(f"FAILED: {tier.name}")
    return 1 if failed else 0


def _passes(tier: Tier) -> bool:
    _say(f"long tests of {tier.name}: {tier.proves}")
    options = ["-n", "2", "--dist", "loadfile", "--durations=25", "-m", "slow and not board and not system"]
    return (
        subprocess.run([sys.executable, "-m", "pytest", *options, *tier.tests], cwd=ROOT, check=False).returncode == 0
    )


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
