"""The machine that the program runs on."""

from __future__ import annotations

from device.machine.backlight import SysfsBacklight
from device.machine.clock import TimedateClock
from device.machine.interfaces import Machine
from device.machine.wifi import NetworkManagerWifi


def real_machine() -> Machine:
    """Clock, panel and Wi-Fi of this machine; nothing is asked before its first use."""
    return Machine(TimedateClock(), SysfsBacklight(), NetworkManagerWifi())
