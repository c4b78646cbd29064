"""Gage R&R against the worked example of the field's manual, and intervals that hold known variances."""

import numpy as np
import pytest

from host_sync.errors import MeasurementError
from host_sync.gage import study

# Ten parts, three operators, three repeats: the example that the AIAG's manual (MSA, 4th edition) works through.
EXAMPLE = """
 0.29 -0.56 1.34 0.47 -0.80  0.02 0.59 -0.31 2.26 -1.36
 0.41 -0.68 1.17 0.50 -0.92 -0.11 0.75 -0.20 1.99 -1.25
 0.64 -0.58 1.27 0.64 -0.84 -0.21 0.66 -0.17 2.01 -1.31
 0.08 -0.47 1.19 0.01 -0.56 -0.20 0.47 -0.63 1.80 -1.68
 0.25 -1.22 0.94 1.03 -1.20  0.22 0.55  0.08 2.12 -1.62
 0.07 -0.68 1.34 0.20 -1.28  0.06 0.83 -0.34 2.19 -1.50
 0.04 -1.38 0.88 0.14 -1.46 -0.29 0.02 -0.46 1.77 -1.49
-0.11 -1.13 1.09 0.20 -1.07 -0.67 0.01 -0.56 1.45 -1.77
-0.15 -0.96 0.67 0.11 -1.45 -0.49 0.21 -0.49 1.87 -2.16
"""


def labels(count: int) -> list[str]:
    return [str(number) for number in range(count)]


def test_the_worked_example() -> None:
    values = np.array(EXAMPLE.split(), float).reshape(3, 3, 10).transpose(2, 0, 1)
    found = study(values, labels(10), list("ABC"), tolerance=4.0)
    assert found.anova.pooled
    assert found.anova.interaction_p == pytest.approx(0.974, abs=1e-3)
    assert found.anova.sums == pytest.approx({"parts": 88.3619, "operators": 3.1673, "repeats": 3.1179}, abs=1e-4)
    assert found.repeatability.value == pytest.approx(0.199933, abs=1e-5)
    assert found.reproducibility.value == pytest.approx(0.226838, abs=1e-5)
    assert found.gage.value == pytest.approx(0.302373, abs=1e-5)
    assert found.part_to_part.value == pytest.approx(1.042327, abs=1e-5)
    assert found.percent_gage.value == pytest.approx(27.86, abs=0.01)
    assert found.ndc.value == 4.0
    assert found.percent_tolerance is not None
    assert found.percent_tolerance.value == pytest.approx(100.0 * 6.0 * 0.302373 / 4.0, abs=0.01)


def crossed(seed: int, sigma: tuple[float, float, float, float], sizes: tuple[int, int, int]) -> np.ndarray:
    random = np.random.default_rng(seed)
    p, o, _ = sizes
    part, operator, interaction, repeat = sigma
    return (
        part * random.standard_normal((p, 1, 1))
        + operator * random.standard_normal((1, o, 1))
        + interaction * random.standard_normal((p, o, 1))
        + repeat * random.standard_normal(sizes)
    )


def test_an_interaction_that_is_there_is_kept() -> None:
    found = study(crossed(1, (3.0, 0.5, 2.0, 0.3), (12, 4, 4)), labels(12), labels(4))
    assert not found.anova.pooled
    assert found.repeatability.value == pytest.approx(0.3, rel=0.15)
    assert found.reproducibility.value == pytest.approx(np.hypot(0.5, 2.0), rel=0.4)


def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    sigma = (2.0, 0.8, 0.0, 0.4)
    truth = {"repeatability": 0.4, "gage": np.hypot(0.8, 0.4), "part_to_part": 2.0}
    held = dict.fromkeys(truth, 0)
    for seed in range(60):
        found = study(crossed(seed, sigma, (8, 4, 2)), labels(8), labels(4))
        for name, value in truth.items():
            figure = getattr(found, name)
            held[name] += figure.low <= value <= figure.high
    assert min(held.values()) >= 50  # of 60 at 95 %: 57 on average


def test_one_operator_has_no_reproducibility() -> None:
    found = study(crossed(3, (2.0, 0.0, 0.0, 0.4), (10, 1, 3)), labels(10), ["A"])
    assert found.reproducibility.value == 0.0
    assert found.gage.value == found.repeatability.value


@pytest.mark.parametrize(("values", "match"), [(np.zeros((3, 2, 1)), "two repeats"), (np.ones((3, 2, 2)), "copies")])
def test_what_is_no_study_is_refused(values: np.ndarray, match: str) -> None:
    with pytest.raises(MeasurementError, match=match):
        study(values, labels(values.shape[0]), labels(values.shape[1]))
