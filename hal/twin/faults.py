"""What can be made to go wrong on the twin."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class Faults:
    """Switches of the simulated world; every one may be thrown at any time.

    camera_missing : the camera does not answer when it is opened or read
    camera_stalled : the camera delivers no more frames
    controls_ignored : exposure and gain that are asked for never arrive
    lights_silent : the light driver does not acknowledge
    lights_broken : the driver answers, but no light comes
    open_lights : lights whose LED is not connected: the driver says "open", and no light comes
    dimmed : share of its light that an ageing light still gives, by name
    button_unreadable : the button's line cannot be read
    under_voltage : the supply is too low
    """

    camera_missing: bool = False
    camera_stalled: bool = False
    controls_ignored: bool = False
    lights_silent: bool = False
    lights_broken: bool = False
    open_lights: set[str] = field(default_factory=set)
    dimmed: dict[str, float] = field(default_factory=dict)
    button_unreadable: bool = False
    under_voltage: bool = False
