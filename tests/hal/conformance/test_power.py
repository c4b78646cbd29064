"""Promises of `hal.interfaces.Power`, for every driver."""

from hal.hardware import Hardware


def test_a_good_supply_reads_good_and_what_is_not_there_reads_none(driver: Hardware) -> None:
    with driver:
        reading = driver.power.read()
    assert reading.under_voltage is False
    assert reading.throttled is False
    assert (reading.battery_mv is None) == (reading.battery_share is None)
    if "battery" not in driver.profile.capabilities:
        assert reading.battery_share is None
    if reading.battery_share is not None:
        assert 0.0 <= reading.battery_share <= 1.0
