"""Choice of the camera on USB that is the sensor: found once by a part of its name, and from then on by all of it."""

from __future__ import annotations

from hal.drivers.v4l2_stack import VideoDevice, VideoInfo, VideoStack
from hal.errors import CameraError


class ChosenCamera:
    """One camera of a machine, the same one after it was unplugged and plugged in again.

    Parameters
    ----------
    stack : the machine's cameras, or emulated ones
    card : part of the name or serial number of exactly one of them
    """

    def __init__(self, stack: VideoStack, card: str) -> None:
        self._stack = stack
        self._card = card
        self._name: str | None = None

    @property
    def name(self) -> str:
        """Full name with the serial number; before it is first found, the part of it in the profile."""
        return self._name or self._card

    def open(self) -> VideoDevice:
        """Find and open it, under whatever device file it has now.

        Raises
        ------
        CameraError
            It is absent, or more than one has its name.
        OSError
            The kernel refuses it.
        """
        found = self._find()
        self._name = found.name
        return self._stack.open(found.path)

    def _find(self) -> VideoInfo:
        present = self._stack.cameras()
        known = self._name
        found = [info for info in present if (info.name == known if known else self._card in info.name)]
        if len(found) == 1:
            return found[0]
        names = ", ".join(f"{info.name} ({info.path})" for info in present) or "none"
        problem = "is not there" if not found else "is ambiguous"
        raise CameraError(
            f"camera {self.name} {problem}: cameras are {names}; plug it in, check that the user is in the group "
            "video, and uvc.card in the board profile"
        )
