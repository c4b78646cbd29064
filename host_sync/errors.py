"""One root error for the workstation; each leaf is also the built-in error that it resembles.

A message is one sentence that names the file or part and says what to do.
"""


class HostError(Exception):
    """Root of every error that the workstation raises for bad input or a state it refuses."""


class FrameSetError(HostError, ValueError):
    """A frame set or one of its images cannot be used. Mend the file and the key that the message names."""


class SequenceError(HostError, ValueError):
    """A sequence of frames cannot be used, or none of its frames can. Mend or name what the message says."""


class SourceError(HostError, OSError):
    """A device, card or folder cannot be read or holds no bundles. Connect it, or name the right one."""


class LibraryError(HostError, OSError):
    """The library cannot be read or written: full, read-only, missing or busy. Mend that, then repeat."""


class BusyBundle(LibraryError):
    """A bundle is coming from another source at this moment. Repeat when that is done."""


class NoSuchBundle(HostError, LookupError):
    """No bundle of the library, or more than one, answers to a name. Give more of its id."""


class MissingCalibration(HostError, LookupError):
    """A scan names no calibration, or one that the library does not hold. Pull it from the device."""


class MissingResult(HostError, LookupError):
    """A scan of the library has no results yet. Reconstruct it."""


class ResultError(HostError, OSError):
    """Results cannot be written where they belong: full, read-only or in the way. Free it or choose another place."""


class IntegrationError(HostError, ValueError):
    """Slopes cannot be integrated: shapes differ, or values are not numbers. Mask what is invalid first."""


class NoSource(HostError, LookupError):
    """What was named is neither a folder with scans nor a paired device. Name another, or pair it."""


class SourceLost(SourceError):
    """The connection, or the card, went away in the middle. What came is kept: repeat the command to go on."""


class SourceRefused(SourceError):
    """A device shows another key than it was paired with, or does not accept ours. Read why, then pair it again."""


class PairingError(HostError, ValueError):
    """Pairing failed: a wrong code, or something else answered. Open the device's window again and repeat."""


class ExportError(HostError, OSError):
    """An export cannot be written. Free the place or choose another."""


class FilterError(HostError, ValueError):
    """A filter cannot be what was asked: its nesting index is no length, or two leave nothing. Give other indices."""


class MeasurementError(HostError, ValueError):
    """A result or a recipe cannot be measured as asked. Mend the file, key or place that the message names."""


class RenderError(HostError, ValueError):
    """A picture cannot be made as it was asked for. Give another size, light, viewpoint or kind of file."""


class ViewError(HostError, LookupError):
    """What was to be looked at is not there, or cannot be shown. Name a library, a result or another scan."""
