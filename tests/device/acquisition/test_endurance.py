"""Scripted presses with random faults on the real drivers: every good press published once, nothing leaks.

150 presses in the gate; 10,000 with `-m slow`.
"""

import resource
import shutil
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from emulated_board import GAUGE_AT, LIGHTS_AT, EmulatedBoard, emulated_hardware

from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations
from device.errors import DeviceError
from device.store.store import BundleStore
from hal.errors import HalError
from hal.interfaces import LiftOff
from hal.simulator.bench import SimulatedScene

FAULT_FRACTION = 0.05


def open_files() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize() / 2**20


def _set(thing: object, name: str, value: object, well: object) -> Callable[[], None]:
    setattr(thing, name, value)
    return lambda: setattr(thing, name, well)


def _lose_the_chip_while_lit(emulated: EmulatedBoard) -> Callable[[], None]:
    lights = emulated.hardware.lights
    switch_on = lights.switch_on

    def switch_on_and_lose_the_chip(currents_ma: Mapping[str, float]) -> None:
        switch_on(currents_ma)
        emulated.wire.faults.unplugged = {LIGHTS_AT}

    lights.switch_on = switch_on_and_lose_the_chip  # type: ignore[method-assign]

    def mend() -> None:
        lights.switch_on = switch_on  # type: ignore[method-assign]
        emulated.wire.faults.unplugged = set()
        lights.off()  # as `watch` does every second

    return mend


def break_something(emulated: EmulatedBoard, dice: np.random.Generator) -> tuple[bool, Callable[[], None]]:
    """Whether the press must fail, and how to mend it."""
    bus, cameras, world = emulated.wire.faults, emulated.cameras.faults, emulated.bench.faults
    faults: list[tuple[bool, Callable[[], Callable[[], None]]]] = [
        (False, lambda: _set(bus, "refused", 2, 0)),
        (False, lambda: _set(emulated.firmware, "throttled", "50005", "0")),
        (False, lambda: _set(bus, "unplugged", {GAUGE_AT}, set())),
        (False, lambda: _set(emulated.leds, "open_channels", {4}, set())),
        (False, lambda: _set(emulated.leds, "shorted_channels", {0, 1}, set())),
        (False, lambda: _set(cameras, "late_requests", 1, 0)),
        (False, lambda: _set(cameras, "stalled_openings", 1, 0)),
        (True, lambda: _lose_the_chip_while_lit(emulated)),
        (True, lambda: _set(cameras, "timed_out", "get_result", "")),
        (True, lambda: _set(bus, "unplugged", {LIGHTS_AT}, set())),
        (True, lambda: _set(bus, "stuck", True, False)),
        (True, lambda: _set(bus, "gone", True, False)),
        (True, lambda: _set(world, "camera_stalled", True, False)),
        (True, lambda: _set(world, "camera_missing", True, False)),
        (True, lambda: _set(cameras, "rows_lost", 2, 0)),
        (True, lambda: _set(cameras, "without", "SensorTimestamp", "")),
        (True, lambda: _set(cameras, "clock_offset_ns", 10**10, 0)),
    ]
    must_fail, throw = faults[int(dice.integers(len(faults)))]
    return must_fail, throw()


def press_for_a_while(emulated: EmulatedBoard, store: BundleStore, presses: int) -> tuple[int, int]:
    """How many presses were published and how many failed, each as it should."""
    dice = np.random.default_rng(5)
    published: set[str] = set()
    failed = 0
    with emulated.hardware as hardware:
        scanner = Scanner(hardware, store)
        for _ in range(presses):
            must_fail, mend = (
                break_something(emulated, dice) if dice.random() < FAULT_FRACTION else (False, lambda: None)
            )
            hardware.operator.ask(LiftOff())
            assert hardware.button.wait_for_push(10.0) is not None
            try:
                bundle = scanner.scan(Annotations()).bundle
            except (DeviceError, HalError):
                assert must_fail
                failed += 1
            else:
                assert not must_fail
                assert bundle.scan_id not in published
                assert [found.scan_id for found in store.scans().bundles] == [bundle.scan_id]
                published.add(bundle.scan_id)
                shutil.rmtree(bundle.directory)
            mend()
            assert store.scans().bundles == ()
            assert not any(emulated.leds.currents_ma())
        assert emulated.cameras.held_requests == 0
    assert emulated.cameras.opened == emulated.wire.opened == 0
    return len(published), failed


@pytest.mark.parametrize(
    ("presses", "most_growth_mb"), [(150, 20.0), pytest.param(10_000, 40.0, marks=pytest.mark.slow)]
)
def test_every_good_press_is_published_once_and_nothing_leaks(
    bench: SimulatedScene, calibrated: BundleStore, presses: int, most_growth_mb: float
) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    press_for_a_while(emulated, calibrated, 20)
    before = (open_files(), threading.active_count())
    before_mb = resident_mb()
    good, failed = press_for_a_while(emulated, calibrated, presses)
    grown_mb = resident_mb() - before_mb
    after = (open_files(), threading.active_count())
    figures = f"{good} published, {failed} failed; open files and threads {before} -> {after}; {grown_mb:+.1f} MB\n"
    sys.stdout.write(figures)  # shown with -rP
    assert good + failed == presses
    assert 0 < failed < 0.1 * presses
    assert after == before
    assert grown_mb < most_growth_mb
