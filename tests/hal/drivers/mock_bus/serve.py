"""Serves a fake `/dev/i2c-1` with chip models on it, through umockdev; run by the system's Python.

Prints the folder of the test bed, then answers each line of commands on standard input with a line of JSON: the current
through each LED of the light driver, in mA.
"""

import errno
import json
import struct
import sys

import gi

gi.require_version("UMockdev", "1.0")
from gauge_model import Max17048Model  # noqa: E402
from gi.repository import GLib, UMockdev  # noqa: E402

from hal.simulator.led_chips import Pca9955bModel, Tlc59116Model  # noqa: E402

I2C_SLAVE, I2C_FUNCS, I2C_SMBUS = 0x0703, 0x0705, 0x0720
BLOCK_DATA, READ = 8, 1
SMBUS_FUNCTIONS = 0x0EFF0001
DEVICE = "P: /devices/i2c-1\nN: i2c-1\nE: DEVNAME=/dev/i2c-1\nE: SUBSYSTEM=i2c-dev\nA: dev=89:1\n"


class Bus:
    """One bus, its chips and its faults."""

    def __init__(self) -> None:
        self.leds = {0x15: Pca9955bModel(), 0x60: Tlc59116Model()}
        self.chips = {**self.leds, 0x36: Max17048Model()}
        self.address = 0
        self.refused: list[int] = []

    def handle(self, _base: object, client: object) -> bool:
        request, arg = client.get_request(), client.get_arg()
        if request == I2C_SLAVE:
            (self.address,) = struct.unpack("L", bytes(arg.retrieve()))
            client.complete(0, 0)
        elif request == I2C_FUNCS:
            arg.resolve(0, 8).update(0, struct.pack("L", SMBUS_FUNCTIONS))
            client.complete(0, 0)
        elif request == I2C_SMBUS:
            client.complete(*self.transfer(arg))
        else:
            client.complete(-1, errno.ENOTTY)
        return True

    def transfer(self, arg: object) -> tuple[int, int]:
        if self.refused:
            return -1, self.refused.pop(0)
        if self.address not in self.chips:
            return -1, errno.EREMOTEIO
        header = bytes(arg.resolve(0, 16).retrieve())
        read, register, size = header[0], header[1], struct.unpack("I", header[4:8])[0]
        if size != BLOCK_DATA:
            return -1, errno.EOPNOTSUPP
        union = arg.resolve(0, 16).resolve(8, 34)
        block = bytes(union.retrieve())
        count = block[0]
        chip = self.chips[self.address]
        if read == READ:
            union.update(0, bytes([count, *chip.read(register, count)]))
        else:
            chip.write(register, block[1 : 1 + count])
        return 0, 0

    def command(self, words: list[str]) -> None:
        match words:
            case ["refuse", number, count]:
                self.refused = [int(number)] * int(count)
            case ["unplug", address]:
                self.chips.pop(int(address))
            case ["open", address, channel]:
                self.leds[int(address)].open_channels.add(int(channel))
            case ["short", address, channel]:
                self.leds[int(address)].shorted_channels.add(int(channel))


def main() -> None:
    bed, bus, loop = UMockdev.Testbed.new(), Bus(), GLib.MainLoop()
    bed.add_from_string(DEVICE)
    handler = UMockdev.IoctlBase()
    handler.connect("handle-ioctl", bus.handle)
    bed.attach_ioctl("/dev/i2c-1", handler)

    def obey(_source: int, _condition: object) -> bool:
        line = sys.stdin.readline()
        if not line:
            loop.quit()
            return False
        bus.command(line.split())
        sys.stdout.write(json.dumps({str(at): chip.currents_ma() for at, chip in bus.leds.items()}) + "\n")
        sys.stdout.flush()
        return True

    GLib.io_add_watch(0, GLib.IO_IN | GLib.IO_HUP, obey)
    sys.stdout.write(bed.get_root_dir() + "\n")
    sys.stdout.flush()
    loop.run()


main()
