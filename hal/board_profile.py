"""The board profile: facts about one kind of instrument, read from TOML and checked once."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from hal.errors import BoardProfileError
from hal.frame import BAYER_ORDERS, BayerOrder, CameraSettings

SCHEMA = "retrograph.board/1"

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
EvenSize = Annotated[int, msgspec.Meta(ge=16, multiple_of=2)]
Row3 = tuple[float, float, float]


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the profile: unknown keys are refused."""


class SensorFacts(_Table, frozen=True):
    """The sensor and its scale: counts in dn, charge in electrons, pitch at the skin in µm."""

    model: str
    columns: EvenSize
    rows: EvenSize
    bayer_order: BayerOrder
    black_level_dn: NotNegative
    white_level_dn: Positive
    pixel_pitch_um: Positive
    full_well_e: Positive
    read_noise_e: NotNegative


class CameraFacts(_Table, frozen=True):
    """Exposure (µs) and analogue gain that this board scans with."""

    exposure_us: Positive
    analogue_gain: Annotated[float, msgspec.Meta(ge=1)]

    @property
    def settings(self) -> CameraSettings:
        """The same as the request that a camera takes."""
        return CameraSettings(self.exposure_us, self.analogue_gain)


class LightFacts(_Table, frozen=True):
    """One light: its place in the skin's frame (mm) and the current (mA) that this board scans with."""

    name: str
    colour: Literal["R", "G", "B"]
    position_mm: Row3
    current_ma: Positive


class GelFacts(_Table, frozen=True):
    """The gel: identity and thickness of its slab (mm)."""

    id: str
    slab_thickness_mm: Positive


class TwinFacts(_Table, frozen=True):
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


class BoardProfile(_Table, frozen=True):
    """One board: everything that is a fact about hardware and nothing that is a choice of the user."""

    schema: Literal["retrograph.board/1"]
    name: str
    driver: Literal["twin", "picamera2"]
    sensor: SensorFacts
    camera: CameraFacts
    lights: tuple[LightFacts, LightFacts, LightFacts]
    gel: GelFacts
    twin: TwinFacts | None = None

    @property
    def currents_ma(self) -> dict[str, float]:
        """Current (mA) of each light by name, as `Lights.switch_on` takes them."""
        return {light.name: light.current_ma for light in self.lights}


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
        raise BoardProfileError(f"{path}: {_explain(str(error))}") from error
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


_ACCEPTED_VALUES = {
    "schema": (SCHEMA,),
    "driver": ("twin", "picamera2"),
    "sensor.bayer_order": BAYER_ORDERS,
    "lights[...].colour": ("R", "G", "B"),
    "twin.skin": ("diffuse", "flake", "sharp-flake"),
}

_TABLES: dict[str, type[_Table]] = {
    "": BoardProfile,
    "sensor": SensorFacts,
    "camera": CameraFacts,
    "lights[...]": LightFacts,
    "gel": GelFacts,
    "twin": TwinFacts,
}


def _explain(message: str) -> str:
    """One sentence that names the key and says what is accepted there."""
    what, _, where = message.partition(" - at `")
    key = where.rstrip("`").removeprefix("$").lstrip(".")
    accepted = ""
    any_item = re.sub(r"\[\d+\]", "[...]", key)
    if any_item in _ACCEPTED_VALUES:
        accepted = "; accepted: " + ", ".join(_ACCEPTED_VALUES[any_item])
    elif "unknown field" in what:
        accepted = "; accepted: " + ", ".join(_TABLES[any_item].__struct_fields__)
    return f"{key or 'top level'}: {what}{accepted}"


def _check(profile: BoardProfile, path: Path) -> None:
    """Refuse what each key allows alone but the keys together do not."""
    colours = "".join(light.colour for light in profile.lights)
    if colours != "RGB":
        raise BoardProfileError(f"{path}: lights: colours are {', '.join(colours)}; accepted is the order R, G, B")
    if len(profile.currents_ma) != len(profile.lights):
        raise BoardProfileError(f"{path}: lights: two of them have the same name; give each its own")
    for light in profile.lights:
        if light.position_mm[2] <= 0.0:
            raise BoardProfileError(
                f"{path}: lights: position_mm of {light.name} is not above the skin; accepted is z > 0"
            )
    if profile.sensor.white_level_dn <= profile.sensor.black_level_dn:
        raise BoardProfileError(f"{path}: sensor.white_level_dn: accepted is more than black_level_dn")
    if profile.driver == "twin" and profile.twin is None:
        raise BoardProfileError(f"{path}: twin: the driver 'twin' needs a [twin] table; an empty one is accepted")
