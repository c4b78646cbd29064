"""Root error of the workstation; each leaf is also the built-in error that it resembles.

A message is one sentence that names the file or part and says what to do.
"""


class HostError(Exception):
    """Root of every error that the workstation raises for bad input or an unusable state."""


class ArgumentError(HostError, TypeError):
    """An argument of a Python program has the wrong type. Give what the message names."""


class FrameSetError(HostError, ValueError):
    """A frame set or one of its images cannot be used. Correct the file and key that the message names."""


class CalibrationFileError(HostError, ValueError):
    """A calibration file is missing, damaged, or of another version. Calibrate again, or name another."""


class SequenceError(HostError, ValueError):
    """A sequence cannot be used, or no frame of it could be reconstructed. Correct what the message names."""


class SourceError(HostError, OSError):
    """A device, card or folder cannot be read or holds no bundles. Connect it, or name the right one."""


class LibraryError(HostError, OSError):
    """The library cannot be read or written: full, read-only, missing or busy. Correct that, then repeat."""


class BusyBundle(LibraryError):
    """Another command is fetching this bundle. Repeat when it has finished."""


class NoSuchBundle(HostError, LookupError):
    """No bundle of the library, or more than one, matches a name. Give more of its id."""


class MissingCalibration(HostError, LookupError):
    """A scan names no calibration, or one that the library does not hold. Pull it from the device."""


class MissingResult(HostError, LookupError):
    """A scan of the library has no results yet. Reconstruct it."""


class ResultError(HostError, OSError):
    """Results cannot be written: the place is full, read-only or occupied. Free it or choose another."""


class UnreadableResult(HostError, ValueError):
    """A file of a result or quick look is missing, damaged or too large. Reconstruct the scan, or pull it again."""


class ClusterError(HostError, RuntimeError):
    """A cluster cannot be used: not installed, not reached, or unlike this computer. Correct what the message names."""


class IntegrationError(HostError, ValueError):
    """Slopes cannot be integrated: shapes differ, or values are not finite. Mask invalid values first."""


class NoSource(HostError, LookupError):
    """The name is neither a folder with scans nor a paired device. Name another, or pair it."""


class SourceLost(SourceError):
    """The connection or the card was lost during a transfer. What arrived is kept: repeat the command to continue."""


class SourceRefused(SourceError):
    """A device shows another key than at pairing, or rejects ours. Read why, then pair it again."""


class PairingError(HostError, ValueError):
    """Pairing failed: a wrong code, or another machine answered. Open the device's window again and repeat."""


class ExportError(HostError, OSError):
    """An export cannot be written. Free space or choose another place."""


class FilterError(HostError, ValueError):
    """Filter settings are invalid: a nesting index is not positive, or two indices leave no band. Change them."""


class MeasurementError(HostError, ValueError):
    """A result or recipe cannot be measured. Correct the file, key or place that the message names."""


class RenderError(HostError, ValueError):
    """A picture cannot be drawn as requested. Choose another size, light, viewpoint or format."""


class Indescribable(HostError, ValueError):
    """A surface cannot be compared by likeness: no skin contact, or too little is valid. Choose another press."""


class MosaicError(HostError, ValueError):
    """Presses cannot be stitched: too few, of different pixel pitches, or none overlap. Choose other scans."""


class ViewError(HostError, LookupError):
    """The item to view does not exist or cannot be shown. Name a library, a result or another scan."""


class RegistrationRefused(ViewError):
    """No registration of two scans can be trusted. Give the shift by hand, or choose other scans.

    down_px, right_px, turn_rad : the best displacement found, px of the first scan
    """

    def __init__(self, message: str, down_px: float, right_px: float, turn_rad: float) -> None:
        super().__init__(message)
        self.down_px, self.right_px, self.turn_rad = down_px, right_px, turn_rad
