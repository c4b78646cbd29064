"""Stages that run beside each other give what they give one after another, and refuse the same frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from threading import get_ident
from typing import Any

import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, press_px

from device.balls.sphere import Ball
from device.errors import CalibrationMismatch
from device.imaging.flat_field import LinearFrame
from host_sync.calibration.calibrate import Calibration
from host_sync.kernels import parallel_rows as row_bands
from host_sync.reconstruction import heights, reading_uncertainty, slope_reading
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from tests.apparatus.light_ring import lit_by_ring

THREADS = (1, 2)
STRANGE_COLUMNS = 150
"""Of the field, two fifths: a quarter may be strange."""


@pytest.fixture
def set_threads(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Simulates a machine with so many cores, on which no field is small."""
    monkeypatch.setattr(row_bands, "SMALL_PX", 1)
    return lambda count: monkeypatch.setattr(row_bands, "get_num_threads", lambda: count)


def ball() -> LinearFrame:
    return lit_by_ring(press_px(Ball(170.0, 120.0, 28.0, RADIUS_PX), 15.0), 3, 501)


def with_strange_colours() -> LinearFrame:
    """Untouched skin, and beside it light such as no ball showed."""
    frame, rng = lit_by_ring(np.zeros(SHAPE), 3, 501), np.random.default_rng(5)
    rgb = frame.rgb.copy()
    rgb[:, :STRANGE_COLUMNS] *= rng.uniform(0.0, 2.0, (SHAPE[0], STRANGE_COLUMNS, 3)).astype(np.float32)
    return LinearFrame(rgb, frame.clipped)


def assert_same(found: Any, expected: Any) -> None:
    """The same bits in every array of a record, and the same values beside them."""
    for field in fields(expected):
        own, other = (getattr(one, field.name) for one in (found, expected))
        if isinstance(other, np.ndarray):
            np.testing.assert_array_equal(own, other, err_msg=field.name)
        elif hasattr(other, "__dataclass_fields__"):
            assert_same(own, other)
        else:
            assert own == other, field.name


def by_threads(set_threads: Callable[[int], None], work: Callable[[], Reconstruction]) -> list[Reconstruction]:
    """What work gives on each count of threads."""
    found = []
    for count in THREADS:
        set_threads(count)
        found.append(work())
    return found


@pytest.mark.parametrize("detail", ["shrunk", "raw"])
def test_one_and_two_threads_give_the_same_result(
    ring_calibration: Calibration, set_threads: Callable[[int], None], detail: Any
) -> None:
    found = by_threads(set_threads, lambda: reconstruct(ball(), ring_calibration, "ball", detail=detail))
    assert_same(*found)
    assert float(found[0].height.z_um.max()) > 100.0
    assert np.isfinite(found[0].samples_um).all()


def test_the_light_model_corrects_both_kinds_of_detail_alike(ring_calibration: Calibration) -> None:
    light = ring_calibration.light
    model = replace(
        light.model, sources=light.model.sources * [1.0, 1.0, 0.8, 1.0, 1.0], residual=1.1 * light.model.residual
    )
    other = replace(ring_calibration, light=replace(light, model=model))
    details: tuple[Any, ...] = ("shrunk", "raw")
    shrunk, raw = (
        np.stack([one.gradients.p - plain.gradients.p, one.gradients.q - plain.gradients.q])
        for plain, one in (
            [reconstruct(ball(), calibration, "ball", detail=detail) for calibration in (ring_calibration, other)]
            for detail in details
        )
    )
    assert np.abs(shrunk).max() > 0.002
    np.testing.assert_allclose(raw, shrunk, atol=1e-5)


@pytest.mark.parametrize(
    ("module", "name"),
    [(reading_uncertainty, "height_draws"), (slope_reading, "check_frame"), (slope_reading, "out_of_domain_blocks")],
)
def test_the_second_thread_does_what_needs_no_heights(
    ring_calibration: Calibration,
    set_threads: Callable[[int], None],
    monkeypatch: pytest.MonkeyPatch,
    module: Any,
    name: str,
) -> None:
    workers: list[int] = []
    work = getattr(module, name)

    def noted(*arguments: Any) -> Any:
        workers.append(get_ident())
        return work(*arguments)

    monkeypatch.setattr(module, name, noted)
    for count in THREADS:
        set_threads(count)
        reconstruct(ball(), ring_calibration, "ball")
    alone, beside = workers
    assert alone == get_ident() != beside


def test_strange_colours_are_refused_in_the_same_words_by_one_and_two_threads(
    ring_calibration: Calibration, set_threads: Callable[[int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heights, "integrate", lambda *_: pytest.fail("its slopes were integrated"))
    words: list[str] = []
    for count in THREADS:
        set_threads(count)
        with pytest.raises(CalibrationMismatch) as raised:
            reconstruct(with_strange_colours(), ring_calibration, "strange")
        words.append(str(raised.value))
    assert words[0] == words[1]
    assert words[0].startswith("strange was not made as its calibration was: ")
    assert "of its colours are unlike those of the balls (at most 25%)" in words[0]


def test_force_keeps_the_warnings_on_one_and_two_threads(
    ring_calibration: Calibration, set_threads: Callable[[int], None]
) -> None:
    frame = with_strange_colours()
    found = by_threads(set_threads, lambda: reconstruct(frame, ring_calibration, "strange", force=True))
    assert_same(*found)
    assert "of its colours are unlike those of the balls" in found[0].warnings[0]
    assert found[0].extrapolated[:, :STRANGE_COLUMNS].mean() > 0.25
    assert found[0].extrapolated[:, STRANGE_COLUMNS + 20 :].mean() < 0.01
