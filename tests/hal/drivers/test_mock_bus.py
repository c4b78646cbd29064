"""The light drivers and the gauge on the real smbus2 and a `/dev/i2c-1` made by umockdev."""

import errno
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from limits import running

HERE = Path(__file__).parent / "mock_bus"
ROOT = Path(__file__).parents[3]
APPARATUS_PATH = f"{ROOT}{os.pathsep}{ROOT / 'tests/apparatus'}"
PRELOAD = "libumockdev-preload.so.0"
SYSTEM_PYTHON = "/usr/bin/python3"
WANTED = "import gi; gi.require_version('UMockdev', '1.0')"


def can_serve() -> bool:
    try:
        asked = subprocess.run([SYSTEM_PYTHON, "-c", WANTED], capture_output=True, check=False)
    except OSError:
        return False
    return asked.returncode == 0


pytestmark = pytest.mark.skipif(
    not can_serve(), reason="no fake /dev/i2c-1 without umockdev: make test-deps installs it on Debian"
)


class MockBus:
    def __init__(self, server: "subprocess.Popen[str]") -> None:
        assert server.stdin
        assert server.stdout
        self._to, self._from = server.stdin, server.stdout
        self.root = self._from.readline().strip()

    def order(self, command: str = "look") -> dict[str, list[float]]:
        """Execute a command; returns the currents through the LEDs by the driver's address, mA."""
        self._to.write(command + "\n")
        self._to.flush()
        return dict(json.loads(self._from.readline()))

    def talk(self, *arguments: str) -> list[dict[str, Any]]:
        environment = {**os.environ, "UMOCKDEV_DIR": self.root, "LD_PRELOAD": PRELOAD, "PYTHONPATH": APPARATUS_PATH}
        ran = subprocess.run(
            [sys.executable, HERE / "talk.py", *arguments],
            env=environment,
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, ran.stderr
        return [json.loads(line) for line in ran.stdout.splitlines()]


@pytest.fixture
def bus() -> Iterator[MockBus]:
    with running(
        ["umockdev-wrapper", SYSTEM_PYTHON, HERE / "serve.py"],
        env={**os.environ, "PYTHONPATH": APPARATUS_PATH, "PYTHONDONTWRITEBYTECODE": "1"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:
        yield MockBus(server)
        assert server.stdin
        server.stdin.close()


@pytest.mark.parametrize(("chip", "address"), [("PCA9955B", 0x15), ("TLC59116", 0x60)])
def test_currents_flow_as_asked_and_end(bus: MockBus, chip: str, address: int) -> None:
    assert bus.talk(chip, "start", "drive", "flags") == [{"result": None}, {"result": None}, {"result": {}}]
    currents = bus.order()[str(address)]
    asked = {0: 4.95, 3: 2.25, 9: 9.0}
    assert currents == pytest.approx([asked.get(n, 0.0) for n in range(16)], abs=0.06)
    bus.talk(chip, "dark")
    assert not any(bus.order()[str(address)])


def test_a_few_refused_transfers_are_tried_again_and_more_are_named(bus: MockBus) -> None:
    bus.order(f"refuse {errno.EREMOTEIO} 2")
    assert bus.talk("PCA9955B", "start") == [{"result": None}]
    bus.order(f"refuse {errno.EIO} 9")
    (reported,) = bus.talk("PCA9955B", "dark")
    assert "light driver PCA9955B at 0x15 on bus 1" in reported["complaint"]
    assert "3 times in a row" in reported["complaint"]


def test_an_absent_chip_and_a_stuck_bus_say_what_to_check(bus: MockBus) -> None:
    bus.order("unplug 96")
    (absent,) = bus.talk("TLC59116", "start")
    assert "no chip answers at 0x60 on bus 1" in absent["complaint"]
    assert "check SDA/SCL on pins 3 and 5" in absent["complaint"]
    bus.order(f"refuse {errno.ETIMEDOUT} 3")
    (stuck,) = bus.talk("PCA9955B", "dark")
    assert "bus 1 is stuck" in stuck["complaint"]


def test_open_and_shorted_leds_are_flagged_while_driven(bus: MockBus) -> None:
    bus.order("open 21 3")
    bus.order("short 21 9")
    reported = bus.talk("PCA9955B", "start", "flags", "drive", "flags")
    assert reported[1] == {"result": {}}
    assert reported[3] == {"result": {"3": "open", "9": "short"}}


def test_open_leds_of_the_tlc59116_are_flagged_and_it_drives_on_as_before(bus: MockBus) -> None:
    bus.order("open 96 3")
    reported = bus.talk("TLC59116", "start", "flags", "drive", "flags")
    assert reported[1] == {"result": {}}
    assert reported[3] == {"result": {"3": "open"}}
    assert bus.order()["96"][0] == pytest.approx(4.95, abs=0.06)


def test_the_gauge_is_read_high_byte_first(bus: MockBus) -> None:
    (reported,) = bus.talk("PCA9955B", "gauge")
    assert reported["result"] == pytest.approx([3700.0, 0.5], abs=0.1)
