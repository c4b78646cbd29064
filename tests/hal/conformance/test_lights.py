"""Promises of `hal.interfaces.Lights`, for every driver, observed by the camera."""

import numpy as np
import pytest

from hal.errors import LightError
from hal.hardware import Hardware


def brightness(driver: Hardware) -> float:
    driver.clock.sleep(0.2)
    frame = driver.camera.next_frame(2.0)
    return float(np.median(frame.mosaic) - frame.black_level_dn)


def test_three_lights_are_named(driver: Hardware) -> None:
    assert len(set(driver.lights.names)) == 3
    assert driver.lights.names == tuple(driver.profile.currents_ma)


def test_lights_shine_when_on_and_not_when_dark(driver: Hardware) -> None:
    with driver:
        assert abs(brightness(driver)) < 5.0
        driver.lights.switch_on(driver.profile.currents_ma)
        assert brightness(driver) > 100.0
        driver.lights.off()
        assert abs(brightness(driver)) < 5.0


def test_a_light_that_is_not_named_goes_dark(driver: Hardware) -> None:
    with driver:
        driver.lights.switch_on(driver.profile.currents_ma)
        driver.lights.switch_on({})
        assert abs(brightness(driver)) < 5.0


def test_leaving_makes_it_dark(driver: Hardware) -> None:
    with driver.camera:
        with driver.lights as lights:
            lights.switch_on(driver.profile.currents_ma)
        assert abs(brightness(driver)) < 5.0


def test_unknown_light_and_impossible_current_change_nothing(driver: Hardware) -> None:
    with driver:
        for wrong in ({"ultraviolet": 1.0}, {driver.lights.names[0]: 1e6}, {driver.lights.names[0]: -1.0}):
            with pytest.raises(LightError):
                driver.lights.switch_on(wrong)
        assert abs(brightness(driver)) < 5.0


def test_healthy_lights_report_no_faults(driver: Hardware) -> None:
    with driver:
        assert driver.lights.faults() == ()


def test_looking_for_faults_of_lights_that_shine_finds_none_and_leaves_them_as_they_were(driver: Hardware) -> None:
    with driver:
        driver.lights.switch_on(driver.profile.currents_ma)
        before = brightness(driver)
        assert driver.lights.faults() == ()
        assert abs(brightness(driver) - before) < 0.01 * before


def test_what_is_granted_is_near_what_is_asked_and_within_reach(driver: Hardware) -> None:
    lights = driver.lights
    granted = lights.granted_ma(driver.profile.currents_ma)
    assert tuple(granted) == lights.names
    for name, asked_ma in driver.profile.currents_ma.items():
        assert abs(granted[name] - asked_ma) <= 0.02 * lights.max_ma
        assert 0.0 < granted[name] <= lights.max_ma
    assert lights.granted_ma(granted) == granted
    with pytest.raises(LightError):
        lights.granted_ma({lights.names[0]: 1.01 * lights.max_ma})


def test_light_follows_current(driver: Hardware) -> None:
    name = driver.lights.names[1]
    with driver:
        levels = []
        for current_ma in (2.0, 4.0, 8.0):
            granted = driver.lights.granted_ma({name: current_ma})
            driver.lights.switch_on(granted)
            levels.append(brightness(driver) / granted[name])
    assert np.ptp(levels) < 0.05 * levels[0]
