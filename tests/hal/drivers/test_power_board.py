from pathlib import Path

import pytest
from emulated_board import GAUGE_AT, emulated_hardware
from fake_i2c import FakeI2cBus

from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.drivers.board_hardware import Machine, board_hardware
from hal.drivers.power_board import BoardPower, read_throttled_file, run_vcgencmd, throttle_reading
from hal.errors import PowerError
from hal.interfaces import PowerReading
from hal.simulator.bench import SimulatedScene


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0\n", PowerReading(False, False, False)),
        ("50005\n", PowerReading(under_voltage=True, was_under_voltage=True, throttled=True)),
        ("throttled=0x50000\n", PowerReading(under_voltage=False, was_under_voltage=True, throttled=False)),
    ],
)
def test_throttle_bits(text: str, expected: PowerReading) -> None:
    assert throttle_reading(text) == expected


def test_bits_that_are_no_number_are_refused() -> None:
    with pytest.raises(PowerError, match="not a number"):
        throttle_reading("VCHI initialization failed")


def test_a_kernel_without_the_file_and_a_missing_tool_are_named(tmp_path: Path) -> None:
    with pytest.raises(PowerError, match=r"run a Raspberry Pi kernel, or set power\.throttled"):
        read_throttled_file(tmp_path / "get_throttled")
    with pytest.raises(PowerError, match=r"no-such-tool failed .*power\.throttled to sysfs"):
        run_vcgencmd("no-such-tool")


def test_the_firmware_tool_is_run(tmp_path: Path) -> None:
    tool = tmp_path / "vcgencmd"
    tool.write_text('#!/bin/sh\n[ "$1" = get_throttled ] && echo throttled=0x50005\n')
    tool.chmod(0o755)
    assert throttle_reading(run_vcgencmd(str(tool))).under_voltage


def test_a_battery_plays_its_discharge(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    seen = []
    for percent in (101.5, 80.0, 40.0, 3.0):
        emulated.gauge.set_cell(3300.0 + 9.0 * percent, percent)
        with emulated.hardware.power as power:
            seen.append(power.read())
    assert [reading.battery_share for reading in seen] == pytest.approx([1.0, 0.8, 0.4, 0.03])
    assert [reading.battery_mv for reading in seen] == pytest.approx([4213.5, 4020.0, 3660.0, 3327.0], abs=0.1)


def test_a_gauge_that_is_another_chip_or_none_is_named(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    emulated.gauge.registers[0x08:0x0A] = [0xFF, 0xFF]
    emulated.firmware.throttled = "50005"
    (reported,) = emulated.hardware.power.read().complaints
    assert "version 0xffff, not a MAX17048: check power.fuel_gauge" in reported
    emulated.wire.faults.unplugged.add(GAUGE_AT)
    reading = emulated.hardware.power.read()
    assert "no chip answers at 0x36 on bus 1" in reading.complaints[0]
    assert (reading.under_voltage, reading.was_under_voltage, reading.battery_share) == (True, True, None)


@pytest.mark.parametrize("board", ["pi4-imx477", "pi4-imx477-binned", "pi5-imx296", "zero2w-imx708"])
def test_a_shipped_board_asks_for_no_gauge_that_its_bill_does_not_list(board: str) -> None:
    """Or its self-test would fail, and with it every update."""
    clock = VirtualClock()
    wire = FakeI2cBus({}, clock)
    machine = Machine(open_bus=wire.open, throttled_file=lambda: "0", vcgencmd=lambda: "throttled=0x0\n")
    reading = board_hardware(load_board_profile(board), clock, machine).power.read()
    assert (reading.complaints, reading.under_voltage, reading.battery_share) == ((), False, None)
    assert wire.opened == 0


def test_a_silent_firmware_does_not_hide_the_battery(bench: SimulatedScene) -> None:
    emulated = emulated_hardware(bench, "PCA9955B")
    emulated.firmware.throttled = "VCHI initialization failed"
    reading = emulated.hardware.power.read()
    assert (reading.under_voltage, reading.battery_share) == (None, 0.5)
    assert "not a number" in reading.complaints[0]


def test_troubles_of_an_earlier_reading_are_kept_and_figures_are_the_later_ones() -> None:
    sagged = PowerReading(under_voltage=True, was_under_voltage=None, battery_share=0.9, complaints=("a",))
    later = PowerReading(under_voltage=False, throttled=False, battery_share=0.8, complaints=("b", "a"))
    assert later.with_earlier(sagged) == PowerReading(True, None, False, None, 0.8, ("a", "b"))


def test_a_board_without_any_of_it_measures_nothing() -> None:
    assert BoardPower(None, None).read() == PowerReading()
