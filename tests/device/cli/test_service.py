"""The battery guard: single bad readings are ignored, an empty battery powers off, a board needs a gauge."""

from dataclasses import replace
from pathlib import Path
from typing import Self

import pytest

import device.cli.service
from device.cli.main import main
from device.cli.service import EVERY_S, LOW_IN_A_ROW, is_low, wait_until_low
from device.store.store import BundleStore
from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.errors import PowerError
from hal.factory import open_hardware
from hal.interfaces import PowerReading


class Discharge:
    """A supply that plays readings, then stays at the last; None is a gauge that does not answer."""

    def __init__(self, *shares: float | None) -> None:
        self._shares = list(shares)

    def read(self) -> PowerReading:
        share = self._shares.pop(0) if len(self._shares) > 1 else self._shares[0]
        if share is None:
            raise PowerError("no chip answers at 0x36 on bus 1")
        return PowerReading(battery_share=share, battery_mv=3000.0 + 1000.0 * share)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None


def test_it_waits_for_an_empty_battery() -> None:
    clock = VirtualClock()
    reading = wait_until_low(Discharge(*[share / 100 for share in range(100, -1, -1)]), clock, pytest.fail)
    assert reading.battery_share is not None
    assert reading.battery_share < 0.35
    assert clock.monotonic_ns() > 60 * EVERY_S * 1e9


def test_a_single_low_reading_ends_nothing() -> None:
    clock = VirtualClock()
    wait_until_low(Discharge(0.5, 0.02, 0.5, 0.02, 0.02, 0.5, 0.02), clock, pytest.fail)
    assert clock.monotonic_ns() == (5 + LOW_IN_A_ROW) * round(EVERY_S * 1e9)


def test_a_failed_reading_is_printed_and_skipped() -> None:
    printed: list[object] = []
    clock = VirtualClock()
    wait_until_low(Discharge(0.02, None, 0.02, None, 0.02), clock, printed.append)
    assert len(printed) == 2
    assert clock.monotonic_ns() == 4 * round(EVERY_S * 1e9)


@pytest.mark.parametrize(
    ("reading", "low"),
    [
        (PowerReading(), False),
        (PowerReading(under_voltage=True), False),
        (PowerReading(battery_share=0.05), True),
        (PowerReading(battery_share=0.06, battery_mv=3800.0), False),
        (PowerReading(battery_share=0.5, battery_mv=3250.0), True),
    ],
)
def test_low_battery_readings(reading: PowerReading, low: bool) -> None:
    assert is_low(reading) is low


@pytest.fixture
def gauged(tmp_path: Path) -> Path:
    """A board's profile with a fuel gauge."""
    profile = tmp_path / "gauged.toml"
    known = (Path(__file__).parents[3] / "board" / "pi5-imx296.toml").read_text(encoding="utf-8")
    profile.write_text(f'{known}\n[power.fuel_gauge]\nchip = "MAX17048"\nbus = 1\n', encoding="utf-8")
    return profile


def test_a_board_without_a_gauge_has_nothing_to_guard(capsys: pytest.CaptureFixture[str], gauged: Path) -> None:
    for board in ("pi4-imx477", "pi5-imx296", "zero2w-imx708"):
        assert main(["--board", board, "guard-battery", "--check"]) == 2
        assert "has no battery gauge" in capsys.readouterr().err
    assert main(["--board", str(gauged), "guard-battery", "--check"]) == 0


def test_an_empty_battery_powers_the_device_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, gauged: Path
) -> None:
    emptied = replace(open_hardware(load_board_profile(gauged)), power=Discharge(0.03))
    monkeypatch.setattr(device.cli.service, "open_hardware", lambda *_: emptied)
    monkeypatch.setattr(device.cli.service, "SystemClock", VirtualClock)
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    assert main(["--board", str(gauged), "guard-battery"]) == 0
    assert "nearly empty (charge 3%): powering off" in capsys.readouterr().out
    assert (tmp_path / "poweroff").exists()
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    assert main(["--board", str(gauged), "guard-battery"]) == 3
    assert "no service can power this device off" in capsys.readouterr().err


def test_identity_is_created_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        assert main(["--board", "twin", "--store", str(tmp_path / "store"), "identity"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == second == BundleStore(tmp_path / "store", VirtualClock()).device_id
