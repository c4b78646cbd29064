"""The board profile: facts about one kind of instrument, read from TOML and checked once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from hal.errors import BoardProfileError
from hal.frame import AS_GRANTED, CameraSettings, StatedOrder
from hal.profile_tables import (
    ASPECT_TOLERANCE,
    LIVE_AIMING_US,
    BeamConfig,
    BusAddress,
    BusNumber,
    Channel,
    EvenSize,
    Exposure,
    Fraction,
    Gain,
    LensConfig,
    LineOffset,
    NotNegative,
    Positive,
    Table,
    Triple,
    UvcConfig,
    profile_folder,
    profile_names,
)
from hal.validation import decode_toml, explain_with_accepted, not_finite


class SensorConfig(Table, frozen=True):
    """The sensor and its scale: counts in dn, charge in electrons, pitch at the skin in µm.

    exposure_step_us : exposures are multiples of this, µs: the time of one line or of two
    bayer_order : of raw frames, or "as granted": the order in which libcamera hands them out, which kernels change
    min_exposure_us : shortest exposure, µs; one step when not stated
    min_gain, max_gain : limits of the analogue gain; libcamera clamps a request beyond them without an error
    """

    model: str
    columns: EvenSize
    rows: EvenSize
    bayer_order: StatedOrder
    black_level_dn: NotNegative
    white_level_dn: Positive
    pixel_pitch_um: Positive
    full_well_e: Positive
    read_noise_e: NotNegative
    exposure_step_us: Positive = 10.0
    min_exposure_us: Positive | None = None
    min_gain: Gain = 1.0
    max_gain: Gain = 16.0


class CameraConfig(Table, frozen=True):
    """Exposure (µs) and analogue gain of scans on this board, and where its camera stands.

    pupil_height_mm : height of the entrance pupil over the untouched skin, as rays inside the gel see it; follows from
        [lens] where there is one
    """

    exposure_us: Exposure
    analogue_gain: Gain
    pupil_height_mm: Positive | None = None

    @property
    def settings(self) -> CameraSettings:
        """Exposure and gain as a camera request."""
        return CameraSettings(self.exposure_us, self.analogue_gain)


class LightConfig(Table, frozen=True):
    """One light: its position in the skin frame (mm) and its current (mA) for scans on this board.

    channels : channels of the light driver, one per LED; each carries that current
    max_ma : largest continuous current of its LEDs, mA; no request may exceed it
    """

    name: str
    colour: Literal["R", "G", "B"]
    position_mm: Triple
    current_ma: Positive
    channels: tuple[Channel, ...] = ()
    max_ma: Positive | None = None


class GelConfig(Table, frozen=True):
    """The gel: identity and thickness of its slab (mm)."""

    id: str
    slab_thickness_mm: Positive


class LibcameraConfig(Table, frozen=True):
    """Request to libcamera for this sensor.

    camera_id : part of the name that libcamera gives to exactly one camera, such as "imx477@1a"
    raw_bits : bits of the unpacked raw format; a Pi 5 delivers 16, shifted up, whatever the sensor has
    sensor_bits : bits of the sensor's own mode
    frame_period_us : locked frame duration
    aiming_columns, aiming_rows : size of the small stream for aiming
    buffer_count : frames in flight; 1 drops every second frame, more need more of the kernel's contiguous memory
    lens_position : dioptres, for a module with a motorized lens
    """

    camera_id: Annotated[str, msgspec.Meta(min_length=3)]
    raw_bits: Literal[8, 10, 12, 14, 16]
    sensor_bits: Literal[8, 10, 12, 14, 16]
    frame_period_us: Positive
    aiming_columns: EvenSize = 320
    aiming_rows: EvenSize = 240
    buffer_count: Annotated[int, msgspec.Meta(ge=2, le=8)] = 2
    lens_position: NotNegative | None = None


class LightDriverConfig(Table, frozen=True):
    """The chip that drives the lights, its address, and the resistor (ohm) that sets its currents.

    enable_line : line of the button's chip at OE (PCA9955B) or RESET (TLC59116), where a pull keeps the lights dark
    """

    chip: Literal["PCA9955B", "TLC59116"]
    bus: BusNumber
    address: BusAddress
    reference_ohm: Positive
    enable_line: LineOffset | None = None


class ButtonConfig(Table, frozen=True):
    """The button's line: label of the GPIO chip (its number differs between kernels) and offset on it."""

    chip_label: str
    line: LineOffset
    active_low: bool = True


class IndicatorConfig(Table, frozen=True):
    """The status LED or buzzer: either a GPIO line of the button's chip, or a spare channel of the light driver."""

    line: LineOffset | None = None
    channel: Channel | None = None
    current_ma: Positive = 2.0


class FuelGaugeConfig(Table, frozen=True):
    """A battery gauge on the I²C bus."""

    chip: Literal["MAX17048"]
    bus: BusNumber
    address: BusAddress = 0x36


class PowerConfig(Table, frozen=True):
    """Source of under-voltage flags, and the fuel gauge if there is one."""

    throttled: Literal["sysfs", "vcgencmd"] = "sysfs"
    fuel_gauge: FuelGaugeConfig | None = None


class TwinConfig(Table, frozen=True):
    """Facts that only the twin needs about the world that it simulates.

    crosstalk[c][l] : fraction of light l that colour filter c passes
    yield_e_per_ma_ms : electrons per mA and ms in a pixel whose skin faces a light 25 mm away
    camera_distance_mm : from the untouched skin to the entrance pupil
    distortion : relative radial shift at the corner of the field, positive for barrel
    point_spread_px : standard deviation of a point's image, without a [lens]; with one, blur follows from it
    pigment_contrast : standard deviation of the coat's reflectance from pixel to pixel, a fraction; 0: an even coat
    """

    skin: Literal["diffuse", "flake", "sharp-flake"] = "diffuse"
    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    crosstalk: tuple[Triple, Triple, Triple] = ((1.0, 0.10, 0.02), (0.08, 1.0, 0.12), (0.02, 0.15, 1.0))
    yield_e_per_ma_ms: Positive = 500.0
    camera_distance_mm: Positive = 160.0
    light_radius_mm: Positive = 1.0
    vignetting: Fraction = 0.15
    distortion: Annotated[float, msgspec.Meta(ge=-0.2, le=0.2)] = 0.0
    point_spread_px: NotNegative = 0.5
    pigment_contrast: Fraction = 0.0
    frame_period_us: Positive = 16_667.0
    control_delay_frames: Annotated[int, msgspec.Meta(ge=0)] = 3


class BoardProfile(Table, frozen=True):
    """One board: facts about its hardware, no choices of the user.

    driver : "picamera2" for a real board, "uvc" for a sensor on USB, "twin" for a simulated one, "twin-camera" for
        this machine's bus and lines with the twin's camera
    """

    schema: Literal["retrograph.board/1"]
    name: str
    driver: Literal["twin", "twin-camera", "picamera2", "uvc"]
    sensor: SensorConfig
    camera: CameraConfig
    lights: tuple[LightConfig, LightConfig, LightConfig]
    gel: GelConfig
    lens: LensConfig | None = None
    beam: BeamConfig | None = None
    twin: TwinConfig | None = None
    libcamera: LibcameraConfig | None = None
    uvc: UvcConfig | None = None
    light_driver: LightDriverConfig | None = None
    button: ButtonConfig | None = None
    indicator: IndicatorConfig | None = None
    power: PowerConfig | None = None

    @property
    def currents_ma(self) -> dict[str, float]:
        """Current (mA) of each light by name, as `Lights.switch_on` takes them."""
        return {light.name: light.current_ma for light in self.lights}

    @property
    def pupil_height_mm(self) -> float | None:
        """Height of the entrance pupil over the untouched skin, as rays inside the gel see it; None if not stated."""
        if self.camera.pupil_height_mm is not None or self.lens is None:
            return self.camera.pupil_height_mm
        return self.lens.pupil_height_mm(self.sensor.pixel_pitch_um)

    @property
    def frame_period_us(self) -> float | None:
        """Locked frame period, µs; None for a simulated camera."""
        camera = self.libcamera or self.uvc
        return None if camera is None else camera.frame_period_us

    @property
    def lights_always_on(self) -> bool:
        """True if the lights cannot be switched: no frame shows one alone, or darkness."""
        return self.uvc is not None and self.uvc.lights == "always on"

    @property
    def capabilities(self) -> frozenset[str]:
        """Capabilities of the instrument beyond scanning.

        "indicator", "under-voltage", "battery", "focus", "light-current", and "live-aiming" (ten views per second with
        time to spare).
        """
        has = {
            "indicator": self.indicator is not None,
            "under-voltage": self.power is not None,
            "battery": self.power is not None and self.power.fuel_gauge is not None,
            "focus": self.libcamera is not None and self.libcamera.lens_position is not None,
            "live-aiming": self.frame_period_us is not None and self.frame_period_us <= LIVE_AIMING_US,
            "light-current": self.light_driver is not None and self.light_driver.chip == "PCA9955B",
        }
        return frozenset(name for name, present in has.items() if present)


def load_board_profile(name_or_path: str | Path) -> BoardProfile:
    """Return the shipped profile of that name, or the one at that path (`….toml`).

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
        profile = decode_toml(data, BoardProfile)
    except msgspec.ValidationError as error:
        problem = explain_with_accepted(error, BoardProfile, decode_toml(data, dict))
        raise BoardProfileError(f"{path}: {problem}") from error
    except msgspec.DecodeError as error:
        raise BoardProfileError(f"{path}: {error}: name a board profile") from error
    _check(profile, path)
    return profile


def _locate(name_or_path: str | Path) -> Path:
    if isinstance(name_or_path, Path) or name_or_path.endswith(".toml") or "/" in name_or_path:
        return Path(name_or_path)
    if name_or_path not in profile_names():
        known = ", ".join(profile_names())
        raise BoardProfileError(f"unknown board profile {name_or_path!r}: name one of {known}, or a .toml file")
    return profile_folder() / f"{name_or_path}.toml"


def _check(profile: BoardProfile, path: Path) -> None:
    """Refuse combinations of keys that are valid one by one."""
    for complaint in _errors(profile):
        raise BoardProfileError(f"{path}: {complaint}")


def _errors(profile: BoardProfile) -> Iterator[str]:
    for key in not_finite(profile):
        yield f"{key}: is not finite; accepted: a finite number"
    colours = "".join(light.colour for light in profile.lights)
    if colours != "RGB":
        yield f"lights: colours are {', '.join(colours)}; accepted: the order R, G, B"
    if len(profile.currents_ma) != len(profile.lights):
        yield "lights: two have the same name; give each its own"
    for light in profile.lights:
        if light.max_ma is not None and light.current_ma > light.max_ma:
            yield (
                f"lights: current_ma of {light.name} is {light.current_ma:g}; accepted: at most its max_ma, "
                f"{light.max_ma:g}"
            )
        if light.position_mm[2] <= 0.0:
            yield f"lights: position_mm of {light.name} is not above the skin; accepted: z > 0"
    if profile.sensor.white_level_dn <= profile.sensor.black_level_dn:
        yield "sensor.white_level_dn: accepted: more than black_level_dn"
    yield from _exposure_errors(profile.sensor, profile.camera)
    if profile.sensor.bayer_order == AS_GRANTED and profile.libcamera is None:
        yield f"sensor.bayer_order: only libcamera grants one, not the driver {profile.driver!r}; accepted: an order"
    if profile.driver.startswith("twin") and profile.twin is None:
        yield f"twin: the driver {profile.driver!r} needs a [twin] table; it may be empty"
    if profile.driver == "uvc":
        yield from _usb_errors(profile)
    elif profile.driver != "twin":
        yield from _wiring_errors(profile)


def _exposure_errors(sensor: SensorConfig, camera: CameraConfig) -> Iterator[str]:
    """Yield requests that the sensor cannot grant: every frame would be refused because its metadata differ."""
    if not sensor.min_gain <= camera.analogue_gain <= sensor.max_gain:
        yield (
            f"camera.analogue_gain: the {sensor.model} has no gain of {camera.analogue_gain:g}; accepted: "
            f"{sensor.min_gain:g} to {sensor.max_gain:g}"
        )
    shortest_us = sensor.min_exposure_us or sensor.exposure_step_us
    if camera.exposure_us < shortest_us:
        yield f"camera.exposure_us: accepted: at least {shortest_us:g}, the shortest exposure of the {sensor.model}"


def _usb_errors(profile: BoardProfile) -> Iterator[str]:
    """Yield problems in the table that a sensor on USB needs."""
    camera, sensor = profile.uvc, profile.sensor
    if camera is None:
        yield "uvc: the driver 'uvc' needs a [uvc] table"
        return
    if camera.left + sensor.columns > camera.columns or camera.top + sensor.rows > camera.rows:
        yield f"uvc.left, uvc.top: accepted: the frame lies within the picture of {camera.columns}x{camera.rows} pixels"
    if (sensor.bayer_order, sensor.black_level_dn, sensor.white_level_dn) != ("RGGB", 0.0, 65535.0):
        yield "sensor: accepted of a sensor on USB: bayer_order RGGB, black_level_dn 0, white_level_dn 65535"
    if camera.gain_units is None and profile.camera.analogue_gain != 1.0:
        yield "camera.analogue_gain: accepted: 1, as uvc.gain_units is not stated"
    if profile.camera.exposure_us > camera.frame_period_us:
        yield "camera.exposure_us: accepted: at most uvc.frame_period_us"


def _wiring_errors(profile: BoardProfile) -> Iterator[str]:
    """Yield problems in the tables that a real board needs."""
    for name in ("libcamera", "light_driver", "button"):
        if getattr(profile, name) is None and (name, profile.driver) != ("libcamera", "twin-camera"):
            yield f"{name}: the driver {profile.driver!r} needs a [{name}] table"
    for light in profile.lights:
        if light.max_ma is None:
            yield f"lights: {light.name} has no max_ma; accepted: the largest continuous current of its LEDs, mA"
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
    enable_line = profile.light_driver and profile.light_driver.enable_line
    if enable_line is not None and enable_line in {t.line for t in (indicator, profile.button) if t}:
        yield f"light_driver.enable_line: {enable_line} is the button's or the indicator's; accepted: another line"
    camera = profile.libcamera
    if camera and profile.sensor.white_level_dn >= 2**camera.raw_bits:
        yield f"sensor.white_level_dn: accepted: less than 2^raw_bits, {2**camera.raw_bits}"
    if camera and profile.camera.exposure_us > camera.frame_period_us:
        yield "camera.exposure_us: accepted: at most libcamera.frame_period_us"
    if camera:
        rows = camera.aiming_columns * profile.sensor.rows / profile.sensor.columns
        if abs(camera.aiming_rows - rows) > ASPECT_TOLERANCE * rows:
            yield (
                f"libcamera.aiming_rows: {camera.aiming_rows} would show only a part of the field; accepted: about "
                f"{2 * round(rows / 2)}, the sensor's aspect ratio"
            )
