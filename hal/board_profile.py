"""The board profile: facts about one kind of instrument, read from TOML and checked once."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from hal.board_complaints import explain, not_finite
from hal.board_parts import (
    ButtonFacts,
    Channel,
    EvenSize,
    IndicatorFacts,
    LibcameraFacts,
    LightDriverFacts,
    NotNegative,
    Positive,
    PowerFacts,
    Table,
)
from hal.errors import BoardProfileError
from hal.frame import BayerOrder, CameraSettings

ASPECT_TOLERANCE: Final = 0.02
"""An aiming view of other proportions than the sensor's is cropped by libcamera."""

LIVE_AIMING_US: Final = 80_000.0
"""Frames at least this often make ten aiming views a second with some of the time to spare."""

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Exposure = Annotated[float, msgspec.Meta(gt=0, le=1e7)]
Row3 = tuple[float, float, float]


class SensorFacts(Table, frozen=True):
    """The sensor and its scale: counts in dn, charge in electrons, pitch at the skin in µm.

    exposure_step_us : exposures come in whole steps of this, µs: the time of a line, or of two
    """

    model: str
    columns: EvenSize
    rows: EvenSize
    bayer_order: BayerOrder
    black_level_dn: NotNegative
    white_level_dn: Positive
    pixel_pitch_um: Positive
    full_well_e: Positive
    read_noise_e: NotNegative
    exposure_step_us: Positive = 10.0


class CameraFacts(Table, frozen=True):
    """Exposure (µs) and analogue gain that this board scans with."""

    exposure_us: Exposure
    analogue_gain: Annotated[float, msgspec.Meta(ge=1, le=64)]

    @property
    def settings(self) -> CameraSettings:
        """The same as the request that a camera takes."""
        return CameraSettings(self.exposure_us, self.analogue_gain)


class LightFacts(Table, frozen=True):
    """One light: its place in the skin's frame (mm) and the current (mA) that this board scans with.

    channels : of the light driver, one an LED; each carries that current
    """

    name: str
    colour: Literal["R", "G", "B"]
    position_mm: Row3
    current_ma: Positive
    channels: tuple[Channel, ...] = ()


class GelFacts(Table, frozen=True):
    """The gel: identity and thickness of its slab (mm)."""

    id: str
    slab_thickness_mm: Positive


class TwinFacts(Table, frozen=True):
    """What only the twin needs to know about the world that it simulates.

    crosstalk[c][l] : share of light l that colour filter c passes
    yield_e_per_ma_ms : electrons per mA and ms of a pixel whose skin faces a light 25 mm away
    camera_distance_mm : from the resting skin to the entrance pupil
    distortion : relative radial shift at the corner of the field, positive for barrel
    """

    skin: Literal["diffuse", "flake", "sharp-flake"] = "diffuse"
    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    crosstalk: tuple[Row3, Row3, Row3] = ((1.0, 0.10, 0.02), (0.08, 1.0, 0.12), (0.02, 0.15, 1.0))
    yield_e_per_ma_ms: Positive = 500.0
    camera_distance_mm: Positive = 160.0
    light_radius_mm: Positive = 1.0
    vignetting: Share = 0.15
    distortion: Annotated[float, msgspec.Meta(ge=-0.2, le=0.2)] = 0.0
    point_spread_px: NotNegative = 0.5
    frame_period_us: Positive = 16_667.0
    control_delay_frames: Annotated[int, msgspec.Meta(ge=0)] = 3


class BoardProfile(Table, frozen=True):
    """One board: everything that is a fact about hardware and nothing that is a choice of the user.

    driver : "picamera2" for a real board, "twin" for a simulated one, "twin-camera" for this machine's bus and lines
        under the twin's camera
    """

    schema: Literal["retrograph.board/1"]
    name: str
    driver: Literal["twin", "twin-camera", "picamera2"]
    sensor: SensorFacts
    camera: CameraFacts
    lights: tuple[LightFacts, LightFacts, LightFacts]
    gel: GelFacts
    twin: TwinFacts | None = None
    libcamera: LibcameraFacts | None = None
    light_driver: LightDriverFacts | None = None
    button: ButtonFacts | None = None
    indicator: IndicatorFacts | None = None
    power: PowerFacts | None = None

    @property
    def currents_ma(self) -> dict[str, float]:
        """Current (mA) of each light by name, as `Lights.switch_on` takes them."""
        return {light.name: light.current_ma for light in self.lights}

    @property
    def capabilities(self) -> frozenset[str]:
        """What this board can do beyond scanning: "indicator", "under-voltage", "battery", "focus", "light-current",
        and "live-aiming", ten views a second with time to spare."""
        has = {
            "indicator": self.indicator is not None,
            "under-voltage": self.power is not None,
            "battery": self.power is not None and self.power.fuel_gauge is not None,
            "focus": self.libcamera is not None and self.libcamera.lens_position is not None,
            "live-aiming": self.libcamera is not None and self.libcamera.frame_period_us <= LIVE_AIMING_US,
            "light-current": self.light_driver is not None and self.light_driver.chip == "PCA9955B",
        }
        return frozenset(name for name, there in has.items() if there)


def profile_names() -> tuple[str, ...]:
    """Names of the profiles that come with the program, sorted."""
    return tuple(sorted(path.stem for path in _profile_folder().glob("*.toml")))


def load_board_profile(name_or_path: str | Path) -> BoardProfile:
    """The profile of that name among those that come with the program, or the one at that path (`….toml`).

    Raises
    ------
    BoardProfileError
        Unknown name, unreadable file, or a key that is missing, unknown or wrong.
    """
    path = _locate(name_or_path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BoardProfileError(f"{path}: cannot be read ({error.strerror}); name a profile or a .toml file") from error
    try:
        profile = msgspec.toml.decode(data, type=BoardProfile)
    except msgspec.ValidationError as error:
        raise BoardProfileError(f"{path}: {explain(str(error), BoardProfile, msgspec.toml.decode(data))}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BoardProfileError(f"{path}: is not TOML: {error}") from error
    _check(profile, path)
    return profile


def _profile_folder() -> Path:
    """Folder of the shipped profiles: inside an installed wheel, else beside the package in a checkout."""
    package = Path(str(resources.files("hal")))
    shipped = package / "board"
    return shipped if shipped.is_dir() else package.parent / "board"


def _locate(name_or_path: str | Path) -> Path:
    if isinstance(name_or_path, Path) or name_or_path.endswith(".toml") or "/" in name_or_path:
        return Path(name_or_path)
    if name_or_path not in profile_names():
        known = ", ".join(profile_names())
        raise BoardProfileError(f"there is no board profile {name_or_path!r}: name one of {known}, or a .toml file")
    return _profile_folder() / f"{name_or_path}.toml"


def _check(profile: BoardProfile, path: Path) -> None:
    """Refuse what each key allows alone but the keys together do not."""
    for complaint in _complaints(profile):
        raise BoardProfileError(f"{path}: {complaint}")


def _complaints(profile: BoardProfile) -> Iterator[str]:
    for key in not_finite(profile):
        yield f"{key}: is not finite; accepted: a finite number"
    colours = "".join(light.colour for light in profile.lights)
    if colours != "RGB":
        yield f"lights: colours are {', '.join(colours)}; accepted is the order R, G, B"
    if len(profile.currents_ma) != len(profile.lights):
        yield "lights: two of them have the same name; give each its own"
    for light in profile.lights:
        if light.position_mm[2] <= 0.0:
            yield f"lights: position_mm of {light.name} is not above the skin; accepted is z > 0"
    if profile.sensor.white_level_dn <= profile.sensor.black_level_dn:
        yield "sensor.white_level_dn: accepted is more than black_level_dn"
    if profile.driver != "picamera2" and profile.twin is None:
        yield f"twin: the driver {profile.driver!r} needs a [twin] table; an empty one is accepted"
    if profile.driver != "twin":
        yield from _complaints_of_wiring(profile)


def _complaints_of_wiring(profile: BoardProfile) -> Iterator[str]:
    """What a real board's profile lacks or contradicts."""
    for name in ("libcamera", "light_driver", "button"):
        if getattr(profile, name) is None and (name, profile.driver) != ("libcamera", "twin-camera"):
            yield f"{name}: the driver {profile.driver!r} needs a [{name}] table"
    for light in profile.lights:
        if not light.channels:
            yield f"lights: {light.name} has no channels; accepted: channels of the light driver, such as [0, 1]"
    used = [channel for light in profile.lights for channel in light.channels]
    indicator = profile.indicator
    if indicator and (indicator.line is None) == (indicator.channel is None):
        yield "indicator: accepted: exactly one of line (a GPIO line) and channel (of the light driver)"
    if indicator and indicator.channel is not None:
        used.append(indicator.channel)
    if len(set(used)) != len(used):
        twice = sorted({channel for channel in used if used.count(channel) > 1})
        yield f"lights: channel {', '.join(map(str, twice))} is named twice; accepted: each channel once"
    if indicator and profile.button and indicator.line == profile.button.line:
        yield f"indicator.line: {indicator.line} is the button's line; accepted: another line"
    camera = profile.libcamera
    if camera and profile.sensor.white_level_dn >= 2**camera.raw_bits:
        yield f"sensor.white_level_dn: accepted is less than 2^raw_bits, {2**camera.raw_bits}"
    if camera and profile.camera.exposure_us > camera.frame_period_us:
        yield "camera.exposure_us: accepted is at most libcamera.frame_period_us"
    if camera:
        rows = camera.aiming_columns * profile.sensor.rows / profile.sensor.columns
        if abs(camera.aiming_rows - rows) > ASPECT_TOLERANCE * rows:
            yield (
                f"libcamera.aiming_rows: {camera.aiming_rows} would show a part of the field only; accepted is about "
                f"{2 * round(rows / 2)}, as the sensor's proportions have it"
            )
