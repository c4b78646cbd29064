"""What can be made to go wrong on the twin."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Faults:
    """Switches of the simulated world; every one may be thrown at any time.

    camera_missing : the camera does not answer when it is opened or read
    camera_stalled : the camera delivers no more frames
    controls_ignored : exposure and gain that are asked for never arrive
    lights_silent : the light driver does not acknowledge
    lights_broken : the driver answers, but no light comes
    button_unreadable : the button's line cannot be read
    """

    camera_missing: bool = False
    camera_stalled: bool = False
    controls_ignored: bool = False
    lights_silent: bool = False
    lights_broken: bool = False
    button_unreadable: bool = False
