"""Runs the drivers on the real smbus2; each argument is a step and prints a line of JSON."""

import json
import sys

from hal.clock import SystemClock
from hal.errors import HalError, LightError, PowerError
from hal.i2c_bus import I2cChip, open_smbus
from hal.lights_pca9955b import Pca9955b
from hal.lights_tlc59116 import Tlc59116
from hal.power_board import Max17048

clock = SystemClock()
at = {"PCA9955B": 0x15, "TLC59116": 0x60}
kind = sys.argv[1]
chip = I2cChip(open_smbus, 1, at[kind], f"light driver {kind}", LightError, clock)
leds = (Pca9955b if kind == "PCA9955B" else Tlc59116)(chip, 1000.0)
gauge = Max17048(I2cChip(open_smbus, 1, 0x36, "fuel gauge MAX17048", PowerError, clock))
steps = {
    "start": leds.start,
    "dark": leds.dark,
    "flags": leds.flags,
    "gauge": gauge.read,
    "drive": lambda: leds.drive({0: 4.95, 3: 2.25, 9: 9.0}),
}
for step in sys.argv[2:]:
    try:
        told = {"result": steps[step]()}
    except HalError as error:
        told = {"complaint": str(error)}
    sys.stdout.write(json.dumps(told) + "\n")
