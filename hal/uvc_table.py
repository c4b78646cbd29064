"""The table of a board profile that describes a sensor on USB."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from hal.profile_values import EvenSize, Positive, Table

UvcProperty = Literal["exposure", "gain", "white balance", "focus"]


class UvcConfig(Table, frozen=True):
    """A camera on USB that hands out finished 8-bit pictures, and its lights.

    card : part of the name or USB serial number of exactly one camera, such as "GelSight Mini"
    columns, rows : size of its pictures
    left, top : where in them the frame of `sensor.columns` by `sensor.rows` pixels begins
    frame_period_us : of its pictures
    encoding : how pixel values encode light
    fixed : properties without a control because they never change, as the maker says; all others must have one
    gain_units : the gain control's value at gain 1
    white_balance_k : colour temperature to lock, if the camera has a control for it
    focus_units : focus to lock, if the camera has a control for it
    controls : further controls by name, and the value that each must keep
    settle_frames : new exposure and gain show in this many frames at the latest
    lights : always on, or by the zoom control as a DIGIT's are (4 bits a light)
    """

    card: Annotated[str, msgspec.Meta(min_length=3)]
    columns: EvenSize
    rows: EvenSize
    frame_period_us: Positive
    pixel_format: Literal["MJPG", "YUYV", "RGB3"] = "MJPG"
    encoding: Literal["srgb", "linear"] = "srgb"
    left: Annotated[int, msgspec.Meta(ge=0)] = 0
    top: Annotated[int, msgspec.Meta(ge=0)] = 0
    fixed: tuple[UvcProperty, ...] = ()
    gain_units: Positive | None = None
    white_balance_k: Annotated[int, msgspec.Meta(ge=1000, le=20_000)] | None = None
    focus_units: Annotated[int, msgspec.Meta(ge=0)] | None = None
    controls: dict[str, int] = msgspec.field(default_factory=dict)
    settle_frames: Annotated[int, msgspec.Meta(ge=1, le=12)] = 4
    lights: Literal["always on", "zoom control"] = "always on"
