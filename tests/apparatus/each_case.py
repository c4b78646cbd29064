"""One test for a check with many cases: it names every case that fails."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import update_wrapper
from typing import Any

import pytest


def each_case(
    cases: Sequence[Any], *faults: type[Exception], name: Callable[[Any], str] = str
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a test of a check whose first argument is a case and whose others are fixtures.

    faults : exceptions by which the check finds a fault, with AssertionError
    """

    def as_test(check: Callable[..., None]) -> Callable[..., None]:
        def test(**fixtures: Any) -> None:
            found = []
            for case in cases:
                try:
                    check(case, **fixtures)
                except (AssertionError, *faults) as fault:
                    found.append(f"{name(case)}: {fault}")
            if found or not cases:
                pytest.fail("\n".join([f"{len(found)} of {len(cases)}", *found]), pytrace=False)

        signature = inspect.signature(check)
        update_wrapper(test, check)
        test.__signature__ = signature.replace(parameters=list(signature.parameters.values())[1:])  # type: ignore[attr-defined]
        return test

    return as_test
