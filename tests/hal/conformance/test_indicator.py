"""Promises of `hal.interfaces.Indicator`, for every driver."""

from typing import get_args

from hal.hardware import Hardware
from hal.interfaces import Cue


def test_every_cue_can_be_shown_in_a_second(driver: Hardware) -> None:
    with driver:
        for cue in get_args(Cue):
            began_ns = driver.clock.monotonic_ns()
            driver.indicator.show(cue)
            assert driver.clock.monotonic_ns() - began_ns <= 1_000_000_000


def test_the_cue_to_lift_takes_little_of_the_time_that_it_announces(driver: Hardware) -> None:
    with driver:
        began_ns = driver.clock.monotonic_ns()
        driver.indicator.show("may lift")
        assert driver.clock.monotonic_ns() - began_ns <= 150_000_000
