"""Root error of the hardware layer; each leaf is also the built-in error that it resembles.

A message is one sentence: what failed, where, and what to check.
"""


class HalError(Exception):
    """Root of every error that the hardware layer raises."""


class BoardProfileError(HalError, ValueError):
    """A board profile is missing or wrong. Correct the file and key that the message names."""


class CameraError(HalError, OSError):
    """The camera is absent or stalled, or granted other settings than requested. Check its cable and mode."""


class CameraStuck(CameraError):
    """A camera that was closed is still held by this process, which must end before the camera can be opened again."""


class FrameTimeout(CameraError, TimeoutError):
    """No frame arrived in time. Check the camera cable; press again when it answers."""


class LightError(HalError, OSError):
    """A light driver did not answer or reports a fault. Check the address, the wiring and the supply."""


class ButtonError(HalError, OSError):
    """The button's line cannot be read. Check the line name in the board profile."""


class IndicatorError(HalError, OSError):
    """The status LED or buzzer cannot be driven. Check its line or channel in the board profile."""


class PowerError(HalError, OSError):
    """Supply or battery cannot be read. Check the gauge's address, or remove it from the board profile."""


class DriverMissing(HalError, ImportError):
    """A package that this board's drivers need is not installed. Install what the message names."""


class OperatorError(HalError, ValueError):
    """A request to the operator cannot be carried out, such as an unknown specimen on the twin."""
