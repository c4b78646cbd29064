"""One root error for the hardware layer; each leaf is also the built-in error that it resembles.

A message is one sentence: what failed, where, and what to check.
"""


class HalError(Exception):
    """Root of every error that the hardware layer raises."""


class BoardProfileError(HalError, ValueError):
    """A board profile is missing or wrong. Mend the file and the key that the message names."""


class CameraError(HalError, OSError):
    """The camera is absent, stalled, or granted something other than what was asked. Check its cable and mode."""


class FrameTimeout(CameraError, TimeoutError):
    """No frame came in time. Check the camera cable; press again when it answers."""


class LightError(HalError, OSError):
    """A light driver did not answer or reports a fault. Check the address, the wiring and the supply."""


class ButtonError(HalError, OSError):
    """The button's line cannot be read. Check the line name in the board profile."""


class IndicatorError(HalError, OSError):
    """The status LED or buzzer cannot be driven. Check its line or channel in the board profile."""


class PowerError(HalError, OSError):
    """Supply or battery cannot be read. Check the gauge's address, or take it out of the board profile."""


class DriverMissing(HalError, ImportError):
    """A library that this board's drivers need is not installed. Install what the message names."""


class OperatorError(HalError, ValueError):
    """The operator was asked for something that cannot be done, such as an unknown surface on the twin."""
