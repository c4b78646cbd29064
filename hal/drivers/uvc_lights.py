"""Lights of sensors on USB: always on, or set by the camera's zoom control, as a DIGIT's are.

Such a sensor's maker states no currents: a step of 1 stands for 1 mA in the profile and in records.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Self

from hal.board_profile import LightConfig
from hal.drivers.camera_uvc import ChosenCamera
from hal.drivers.v4l2_stack import CONTROLS
from hal.errors import CameraError, LightError
from hal.interfaces import LightFault

STEPS: Final = 15
BITS: Final = (8, 4, 0)
"""Where in the zoom control's value the 4 bits of the red, green and blue light are."""


class AlwaysOnLights:
    """See `hal.interfaces.Lights`: lights that shine whenever the sensor has power."""

    def __init__(self, lights: tuple[LightConfig, ...]) -> None:
        self._shining = {light.name: light.current_ma for light in lights}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        return tuple(self._shining)

    @property
    def max_ma(self) -> float:
        """The largest of the lights' currents, mA."""
        return max(self._shining.values())

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """Return the lights' own currents.

        Raises
        ------
        LightError
            Another light or current is asked for.
        """
        self._check(currents_ma)
        return dict(currents_ma)

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Accept that all lights shine; errors as for `granted_ma`, and when only some of them are named."""
        self._check(currents_ma)
        if set(currents_ma) != set(self._shining):
            raise LightError("the lights of this sensor are always on: none of them can shine alone")

    def off(self) -> None:
        """Leave the lights on."""

    def faults(self) -> tuple[LightFault, ...]:
        """Nothing: these lights report no faults."""
        return ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None

    def _check(self, currents_ma: Mapping[str, float]) -> None:
        for name, current_ma in currents_ma.items():
            if self._shining.get(name) != current_ma:
                raise LightError(f"light {name} cannot be set to {current_ma:g} mA: this sensor's lights are always on")


class ZoomControlLights:
    """See `hal.interfaces.Lights`: 4 bits a light in the camera's zoom control, proved by reading back."""

    def __init__(self, lights: tuple[LightConfig, ...], chosen: ChosenCamera) -> None:
        self._lights = lights
        self._chosen = chosen

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        return tuple(light.name for light in self._lights)

    @property
    def max_ma(self) -> float:
        """Highest step of a light."""
        return float(STEPS)

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """Return the nearest steps.

        Raises
        ------
        LightError
            An unknown name, or more than the highest step.
        """
        for name, current in currents_ma.items():
            if name not in self.names:
                raise LightError(f"there is no light {name!r}: lights are {', '.join(self.names)}")
            if not 0.0 <= current <= STEPS:
                raise LightError(f"light {name} cannot be set to {current:g}: accepted: 0 to {STEPS}")
        return {name: float(round(current)) for name, current in currents_ma.items()}

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Set each named light; all others are off. Errors as for `granted_ma`, or a sensor that does not answer."""
        steps = self.granted_ma(currents_ma)
        self._write(sum(int(steps.get(name, 0.0)) << bit for name, bit in zip(self.names, BITS, strict=True)))

    def off(self) -> None:
        """Switch every light off."""
        self._write(0)

    def faults(self) -> tuple[LightFault, ...]:
        """Nothing: these lights report no faults."""
        return ()

    def __enter__(self) -> Self:
        self.off()
        return self

    def __exit__(self, *exc: object) -> None:
        self.off()

    def _write(self, value: int) -> None:
        zoom = CONTROLS["zoom"]
        try:
            device = self._chosen.open()
            try:
                device.write_control(zoom, value)
                found = device.read_control(zoom)
            finally:
                device.close()
        except CameraError as error:
            raise LightError(str(error)) from error
        except OSError as error:
            raise LightError(
                f"the lights of {self._chosen.name} do not answer ({error.strerror or error}): plug the sensor in again"
            ) from error
        if found != value:
            raise LightError(
                f"the lights of {self._chosen.name} do not keep their steps: {value:#05x} was set and {found:#05x} is "
                "read"
            )
