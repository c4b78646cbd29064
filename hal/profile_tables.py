"""Tables and values that board profiles are made of: optics, and a sensor on USB."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

ASPECT_TOLERANCE: Final = 0.02
"""Relative tolerance of the aspect ratio; libcamera crops an aiming view that differs more from the sensor."""

LIVE_AIMING_US: Final = 80_000.0
"""Maximum frame period for ten aiming views per second with time to spare."""

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Channel = Annotated[int, msgspec.Meta(ge=0, le=15)]
BusNumber = Annotated[int, msgspec.Meta(ge=0, le=99)]
BusAddress = Annotated[int, msgspec.Meta(ge=0x08, le=0x77)]
LineOffset = Annotated[int, msgspec.Meta(ge=0, le=255)]
EvenSize = Annotated[int, msgspec.Meta(ge=16, multiple_of=2)]
Fraction = Annotated[float, msgspec.Meta(ge=0, le=1)]
Exposure = Annotated[float, msgspec.Meta(gt=0, le=1e7)]
Gain = Annotated[float, msgspec.Meta(ge=1, le=64)]
Triple = tuple[float, float, float]


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the profile; unknown keys are refused."""


GEL_INDEX: Final = 1.41
"""Refractive index of silicone; acrylic's is 1.49."""


class LensConfig(Table, frozen=True):
    """The lens, and what its blur follows from.

    focal_mm : focal length
    f_number : as engraved, for far objects
    pixel_um : side of a pixel on the sensor; of a binned one, of all that it sums
    focus_mm : height of the plane in focus above the untouched skin
    """

    focal_mm: Positive
    f_number: Annotated[float, msgspec.Meta(ge=0.7, le=64)]
    pixel_um: Positive
    focus_mm: Annotated[float, msgspec.Meta(ge=-20, le=20)] = 0.0

    def pupil_height_mm(self, pitch_um: float) -> float:
        """Return the height of the entrance pupil over the untouched skin, as rays inside the gel see it.

        The block's flat face bends the rays, so that the pupil seems farther by the refractive index.

        pitch_um : distance of neighbouring pixels on the skin
        """
        return GEL_INDEX * self.focal_mm * (1.0 + pitch_um / self.pixel_um)


class BeamConfig(Table, frozen=True):
    """The beam of every light: its LEDs and what stands before them.

    led_angle_deg : between the directions of half brightness of an LED
    led_offsets_mm : of each LED from the light's position, level and square to its axis
    facet : whether the light enters a clear block through a facet square to its axis; otherwise the LEDs stand free
    behind_mm : from the facet back to the LEDs' fronts
    bore_mm : diameter of the opening before an LED
    aim_past_mm : how far beyond the skin's centre the LEDs aim, along the skin
    """

    led_angle_deg: Annotated[float, msgspec.Meta(ge=5, le=150)]
    led_offsets_mm: tuple[float, ...] = (0.0,)
    facet: bool = True
    behind_mm: NotNegative = 0.0
    bore_mm: Positive = 5.0
    aim_past_mm: NotNegative = 0.0


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


# Places and names of the shipped board profiles; nothing is read, so that help can list them at once.


def profile_names() -> tuple[str, ...]:
    """Return names of the profiles shipped with the program, sorted."""
    return tuple(sorted(path.stem for path in profile_folder().glob("*.toml")))


def profile_folder() -> Path:
    """Return the folder of the shipped profiles: inside an installed wheel, else beside the package in a checkout."""
    package = Path(str(resources.files("hal")))
    shipped = package / "board"
    return shipped if shipped.is_dir() else package.parent / "board"
