"""Runs the drivers on the real smbus2; each argument is a step and prints one line of JSON."""

import json
import sys

from hal.clock import SystemClock
from hal.drivers.i2c_bus import I2cChip, open_smbus
from hal.drivers.lights_pca9955b import Pca9955b
from hal.drivers.lights_tlc59116 import Tlc59116
from hal.drivers.power_board import Max17048
from hal.errors import HalError, LightError, PowerError

clock = SystemClock()
at = {"PCA9955B": 0x15, "TLC59116": 0x60}
kind = sys.argv[1]
chip = I2cChip(open_smbus, 1, at[kind], f"light driver {kind}", LightError, clock)
leds = (Pca9955b if kind == "PCA9955B" else Tlc59116)(chip, 1000.0)
gauge = Max17048(I2cChip(open_smbus, 1, 0x36, "fuel gauge MAX17048", PowerError, clock))
steps = {
    "start": leds.start,
    "dark": leds.off,
    "flags": leds.flags,
    "gauge": gauge.read,
    "drive": lambda: leds.drive({0: 4.95, 3: 2.25, 9: 9.0}),
}
for step in sys.argv[2:]:
    try:
        reported = {"result": steps[step]()}
    except HalError as error:
        reported = {"complaint": str(error)}
    sys.stdout.write(json.dumps(reported) + "\n")
