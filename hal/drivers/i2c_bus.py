"""Registers of one chip on an I²C bus, read and written with a limited number of retries.

Errors name chip, address and bus.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Final, Protocol, TypeVar

from hal.errors import DriverMissing, HalError
from hal.interfaces import Clock

TRIES: Final = 3
RETRY_AFTER_S: Final = 0.002

ABSENT: Final = frozenset({errno.EREMOTEIO, errno.ENODEV, errno.ENXIO})
"""Error numbers for an address that no chip acknowledges."""

Result = TypeVar("Result")


class SmBus(Protocol):
    """The part of the `SMBus` interface of smbus2 that is used."""

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int) -> list[int]:
        """Read registers from `register` on."""
        ...

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int]) -> None:
        """Write registers from `register` on."""
        ...

    def close(self) -> None:
        """Release the bus."""
        ...


OpenBus = Callable[[int], SmBus]


def open_smbus(bus: int) -> SmBus:
    """Return the I²C bus of that number, through smbus2.

    Raises
    ------
    DriverMissing
        smbus2 is not installed.
    OSError
        The bus does not exist, or may not be opened.
    """
    require_package("smbus2", "pip install 'retrograph[device]'")
    from smbus2 import SMBus

    opened: SmBus = SMBus(bus)
    return opened


class I2cChip:
    """A chip at an address; every failure is reported in one sentence that names it.

    Parameters
    ----------
    open_bus : opens a bus by its number, at the first transfer
    what : the chip's part in the instrument, such as "light driver PCA9955B"
    failure : error class for its failures
    """

    def __init__(
        self, open_bus: OpenBus, bus: int, address: int, what: str, failure: type[HalError], clock: Clock
    ) -> None:
        self._open_bus = open_bus
        self._number = bus
        self._address = address
        self._what = what
        self._failure = failure
        self._clock = clock
        self._bus: SmBus | None = None

    @property
    def place(self) -> str:
        """Part, address and bus, such as "light driver PCA9955B at 0x15 on bus 1"."""
        return f"{self._what} at 0x{self._address:02x} on bus {self._number}"

    def read(self, register: int, count: int, subject: str = "") -> bytes:
        """Read `count` registers from `register` on; `subject` names the data in an error."""
        return bytes(self._try(lambda bus: bus.read_i2c_block_data(self._address, register, count), subject))

    def write(self, register: int, values: Sequence[int], subject: str = "") -> None:
        """Write registers from `register` on; `subject` names the data in an error."""
        self._try(lambda bus: bus.write_i2c_block_data(self._address, register, list(values)), subject)

    def close(self) -> None:
        """Release the bus; the next transfer opens it again."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _try(self, talk: Callable[[SmBus], Result], subject: str) -> Result:
        tries_left = TRIES
        while True:
            try:
                return talk(self._opened())
            except OSError as error:
                tries_left -= 1
                if not tries_left:
                    self.close()
                    raise self._failure(self._sentence(error, subject)) from error
            self._clock.sleep(RETRY_AFTER_S)

    def _opened(self) -> SmBus:
        if self._bus is None:
            self._bus = self._open_bus(self._number)
        return self._bus

    def _sentence(self, error: OSError, subject: str) -> str:
        """Return what failed, where, and what to check."""
        about = f" ({subject})" if subject else ""
        where = f"0x{self._address:02x} on bus {self._number}"
        if self._bus_failed_to_open(error):
            return (
                f"I2C bus {self._number} of the {self._what} cannot be opened ({error.strerror}): "
                "switch I2C on in config.txt (dtparam=i2c_arm=on) and add the user to the group i2c"
            )
        if error.errno in ABSENT:
            return (
                f"no chip answers at {where}: the {self._what}{about} does not answer; "
                f"check {_pins(self._number)}, its supply and its address pins"
            )
        if error.errno == errno.ETIMEDOUT:
            return (
                f"bus {self._number} is stuck: the {self._what} at {where}{about} timed out; "
                f"check {_pins(self._number)} for a short or a missing pull-up, then switch the supply off and on"
            )
        return (
            f"the {self._what} at {where}{about} failed ({error.strerror or error}) {TRIES} times in a row: "
            f"check {_pins(self._number)} and its supply"
        )

    def _bus_failed_to_open(self, error: OSError) -> bool:
        return error.errno in {errno.ENOENT, errno.EACCES, errno.EPERM}


def _pins(bus: int) -> str:
    """Return pins of the bus on the 40-pin header."""
    return "SDA/SCL on pins 3 and 5" if bus == 1 else f"SDA/SCL of bus {bus}"


# Packages that only a real board has: checked before a driver imports them.


def require_package(package: str, install: str) -> None:
    """Raise an error that says how to install a package (`install`) if it is missing.

    Raises
    ------
    DriverMissing
        The package is not installed.
    """
    if find_spec(package) is None:
        raise DriverMissing(f"the package {package} is not installed: {install}")
