"""One root error for the instrument; each leaf is also the built-in error that it resembles.

A message is one sentence that names the file or part and says what to do.
"""


class DeviceError(Exception):
    """Root of every error that the instrument raises for bad input or a state it refuses."""


class RecordError(DeviceError, ValueError):
    """A bundle or record is damaged, of an unknown version, or incomplete. Fetch it again or name another."""


class FrameError(DeviceError, ValueError):
    """A frame cannot be used: truncated, black, saturated, or of the wrong size. Take or name another."""


class CalibrationMismatch(DeviceError, ValueError):
    """A frame and a calibration do not belong together. Calibrate with this instrument, gel and lights."""


class CalibrationError(DeviceError, ValueError):
    """Calibration frames do not carry a calibration, such as no ball found. Press again as the message says."""


class NoCalibration(DeviceError, LookupError):
    """No calibration is active on this device. Run `retroscan calibrate` first."""


class FrameNotProven(DeviceError, TimeoutError):
    """No frame's metadata showed the exposure, gain and time that were asked. Press again; check the camera."""


class StoreError(DeviceError, OSError):
    """The store cannot be read or written: full, read-only or missing. Free or mount it."""


class PairingRefused(DeviceError, PermissionError):
    """No workstation was paired: none came in time, or the code was wrong. Open the window again."""


class TerminalMissing(DeviceError, OSError):
    """The screens were asked for where no terminal is. Run them in one, or scan without a screen."""


class InstrumentBusy(DeviceError, BlockingIOError):
    """Another program has camera and lights. End it, or wait until it has ended."""
