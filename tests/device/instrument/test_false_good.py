"""No press under a light off by more than 2 % or on dust is good, healthy ones are: random presses, whole instrument.

`pytest -s -m slow tests/device/instrument/test_false_good.py` prints the counts of every object; with
`RETROGRAPH_PRESSES=150` before it, the slow tests stop after their first 150 presses.
"""

import os
import sys
from collections import Counter
from dataclasses import replace

import pytest

from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene
from tests.apparatus.random_presses import Tally, judge_dusty_press, judge_press, random_presses

pytestmark = pytest.mark.slow

MAX_FALSE_ALARMS = 0.01
MANY_OFF, MANY_HEALTHY, MANY_DUSTY = (int(os.environ.get("RETROGRAPH_PRESSES") or count) for count in (1000, 400, 110))


def judged(
    count: int, seed: int, bench: SimulatedScene, hardware: Hardware, store: BundleStore, healthy: bool
) -> Tally:
    tally = Tally()
    with Instrument(hardware, store) as instrument:
        for number, press in enumerate(random_presses(count, seed, hardware.lights.names, healthy=healthy), start=1):
            tally.add(press, judge_press(instrument, bench, press))
            if number % 50 == 0:
                sys.stdout.write(f"{number} of {count} presses, {len(tally.wrong)} wrong\n")
                sys.stdout.flush()
    sys.stdout.write(f"{tally}\n")
    return tally


@pytest.mark.parametrize(("count", "seed"), [(13, 1), (MANY_OFF, 2)])
def test_no_press_with_a_light_off_by_more_than_two_percent_is_good(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, count: int, seed: int
) -> None:
    assert judged(count, seed, bench, hardware, calibrated, healthy=False).wrong == []


@pytest.mark.parametrize(("count", "seed"), [(22, 5), (MANY_DUSTY, 6)])
def test_no_press_on_dust_that_fell_a_second_before_or_with_the_object_is_good(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, count: int, seed: int
) -> None:
    said: Counter[bool] = Counter()
    with Instrument(hardware, calibrated) as instrument:
        for number, press in enumerate(random_presses(count, seed, hardware.lights.names, healthy=False)):
            unlit = replace(press, levels={})
            verdict = judge_dusty_press(instrument, bench, unlit, number, under_object=number % 2 == 1)
            assert verdict.level != "good", (press.name, number, verdict)
            said["of the skin is scratched or dirty" in verdict.reason] += 1
    sys.stdout.write(f"{count} dusty presses, 0 good, {said[True]} with dust as the reason\n")
    assert said[True] >= 0.7 * count


@pytest.mark.parametrize(("count", "seed"), [(9, 3), (MANY_HEALTHY, 4)])
def test_healthy_presses_of_every_object_are_good(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore, count: int, seed: int
) -> None:
    tally = judged(count, seed, bench, hardware, calibrated, healthy=True)
    for name, presses in tally.presses.items():
        assert presses - tally.good[name] <= MAX_FALSE_ALARMS * presses, "\n".join(tally.wrong)
