"""Lamps that change between the presses of a calibration: told by the skin beside each ball, and taken out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from host_sync.calibration import press_drift
from host_sync.calibration.balls import UsedPress
from host_sync.calibration.press_drift import fit_without_drift, without_drift
from tests.apparatus.drifting_lamps import DRIFT, MAP, frame

BEGUN = SimpleNamespace(fit=SimpleNamespace(map=MAP))
SHARES = (-1.0, 0.5, 0.0, 1.5, 0.8)


@pytest.fixture
def one_map(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(press_drift, "fit_to", lambda *_: BEGUN)


def presses_of(*drifts: np.ndarray, clipped: int = -1) -> list[UsedPress]:
    return [
        UsedPress(str(number), frame(drift, number + 1, clipped=number == clipped), (), ())
        for number, drift in enumerate(drifts)
    ]


@pytest.mark.usefixtures("one_map")
def test_the_drift_of_each_press_is_told_and_taken_out() -> None:
    presses = presses_of(*(share * DRIFT for share in SHARES))
    _, drifts = fit_without_drift(presses, BEGUN, None)
    assert drifts is not None
    np.testing.assert_allclose(drifts, np.outer(SHARES, DRIFT), atol=8e-4)
    steady = presses_of(*(np.zeros(3) for _ in SHARES))
    for press, wanted in zip(without_drift(presses, drifts), steady, strict=True):
        np.testing.assert_allclose(press.intensity.values / wanted.intensity.values, 1.0, atol=1e-3)


@pytest.mark.usefixtures("one_map")
def test_a_press_whose_skin_seems_to_slope_drifts_as_most_of_its_field() -> None:
    presses = presses_of(*(share * DRIFT for share in SHARES), clipped=3)
    _, drifts = fit_without_drift(presses, BEGUN, None)
    assert drifts is not None
    np.testing.assert_allclose(drifts[3], SHARES[3] * DRIFT, atol=2e-3)


@pytest.mark.usefixtures("one_map")
def test_steady_presses_broken_lamps_and_few_presses_are_left_as_they_are() -> None:
    steady = presses_of(*(np.zeros(3) for _ in SHARES))
    broken = presses_of(*(np.array([-0.3, 0.0, 0.0]) for _ in SHARES))
    few = presses_of(DRIFT, -DRIFT, 2.0 * DRIFT)
    for presses in (steady, broken, few):
        assert fit_without_drift(presses, BEGUN, None) == (BEGUN, None)
    assert without_drift(steady, np.zeros((len(steady), 3)))[0] is steady[0]
