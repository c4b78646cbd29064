"""One root error for the instrument; each leaf is also the built-in error it resembles.

A message is one sentence that names the file or part and says what to do.
"""


class DeviceError(Exception):
    """Root of the errors that the instrument raises for bad input or a refused state."""


class RecordError(DeviceError, ValueError):
    """A bundle or record is damaged, of an unknown version, or incomplete. Fetch it again, or name another."""


class FrameError(DeviceError, ValueError):
    """A frame cannot be used: truncated, black, saturated, or of the wrong size. Take another, or name another file."""


class CalibrationMismatch(DeviceError, ValueError):
    """A frame and a calibration do not belong together. Calibrate with this instrument, gel and lights."""


class CalibrationError(DeviceError, ValueError):
    """Calibration frames are not sufficient, for example no ball was found. Press again as the message says."""


class NoCalibration(DeviceError, LookupError):
    """No calibration is active on this device. Run `retroscan calibrate` first."""


class CaptureModeRefused(DeviceError, ValueError):
    """This hardware cannot take presses in the wanted mode. Choose another."""


class FrameNotConfirmed(DeviceError, TimeoutError):
    """No frame's metadata matched the requested exposure, gain and time. Press again; check the camera."""


class StoreError(DeviceError, OSError):
    """The store cannot be read or written: full, read-only or missing. Free or mount it."""


class OutputError(DeviceError, OSError):
    """A result cannot be written: the place is full, read-only or taken. Free it or choose another."""


class PairingRefused(DeviceError, PermissionError):
    """No workstation was paired: none connected in time, or the code was wrong. Open the window again."""


class MachineError(DeviceError, OSError):
    """A setting of this machine (clock, network, brightness) cannot be read or changed. Do as the message says."""


class TerminalMissing(DeviceError, OSError):
    """The screens were started without a terminal. Run them in one, or scan without a screen."""


class InstrumentBusy(DeviceError, BlockingIOError):
    """Another program uses camera and lights. End it, or wait until it ends."""
