"""One press as the camera sees it: the skin, the charge that each light brings to each pixel, and the sensor.

The skin has a pigment: a coat is never quite even, and what is fixed to the skin multiplies its light.

Light of LEDs behind a block's facet, or free in air: lobe, bore and refraction at the facet.

Block and gel are taken for one body, as their indices differ by 5 %. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from hal.board_profile import BoardProfile, SensorConfig, TwinConfig
from hal.errors import BoardProfileError
from hal.frame import AS_GRANTED, BayerOrder
from hal.profile_tables import BeamConfig
from hal.simulator.elastomer import Skin, drape
from hal.simulator.lens import GEL_INDEX, Lens
from hal.simulator.surfaces import Float32Array, FloatArray, Surface

ACRYLIC: Final = 1.49
"""Refractive index of the block."""

Place = tuple[float, float, float]


def led_places_mm(position_mm: Place, beam: BeamConfig) -> tuple[Place, ...]:
    """Place of each LED of the light at `position_mm`: side by side, level and square to its axis."""
    axis = _axis(position_mm, beam)
    side = np.cross(axis, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    places = (np.asarray(position_mm) + offset_mm * side for offset_mm in beam.led_offsets_mm)
    return tuple((float(x), float(y), float(z)) for x, y, z in places)


def beam_fraction(
    point_mm: tuple[FloatArray, FloatArray, FloatArray], led_mm: Place, position_mm: Place, beam: BeamConfig
) -> FloatArray:
    """Return the intensity of an LED towards points of the skin, relative to that of a bare one on its axis.

    Parameters
    ----------
    point_mm : x, y and z of the points, arrays that broadcast to (H, W)
    led_mm : the LED's place
    position_mm : the light's position, which gives the axis

    Returns
    -------
    array of shape (H, W), 0 where the bore or total reflection leaves nothing
    """
    axis = _axis(position_mm, beam)
    away = [here - at for here, at in zip(point_mm, led_mm, strict=True)]
    distance = np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
    cosine = (away[0] * axis[0] + away[1] * axis[1] + away[2] * axis[2]) / distance
    inside = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    exponent = np.log(0.5) / np.log(np.cos(np.radians(beam.led_angle_deg / 2.0)))  # 1 for 120 degrees: Lambert's law
    if not beam.facet:
        return np.asarray(np.maximum(cosine, 0.0) ** exponent)
    # Nothing beyond the critical angle comes out of air.
    sine = ACRYLIC * inside
    outside = np.minimum(sine, 1.0)
    lobe = np.sqrt(1.0 - outside**2) ** exponent
    tangent = np.where(sine < 1.0, sine / np.sqrt(np.maximum(1.0 - sine**2, 1e-12)), np.inf)
    open_there = (tangent * beam.behind_mm <= beam.bore_mm / 2.0) & (cosine > 0.0)
    return np.where(open_there, lobe * _passed(outside, inside), 0.0)


def _axis(position_mm: Place, beam: BeamConfig) -> FloatArray:
    """Return the unit vector along which the light's LEDs look."""
    level = np.asarray((-position_mm[0], -position_mm[1], 0.0))
    across = float(np.linalg.norm(level))
    past = level * (beam.aim_past_mm / across) if across > 0.0 else level
    towards = past - np.asarray(position_mm)
    return np.asarray(towards / np.linalg.norm(towards))


def _passed(outside: FloatArray, inside: FloatArray) -> FloatArray:
    """Return the fraction of unpolarised light that enters the facet (Fresnel).

    outside, inside : sines of the angles to the normal on either side
    """
    cos_out, cos_in = np.sqrt(1.0 - outside**2), np.sqrt(1.0 - inside**2)
    across = (cos_out - ACRYLIC * cos_in) / (cos_out + ACRYLIC * cos_in)
    along = (ACRYLIC * cos_out - cos_in) / (ACRYLIC * cos_out + cos_in)
    return np.asarray(1.0 - (across**2 + along**2) / 2.0)


SPOT_PX = 2.0
"""Standard deviation of the spots, pixels; as much of the contrast is grain of single pixels."""


@lru_cache(maxsize=1)
def pigment_pattern(shape: tuple[int, int], contrast: float, seed: int) -> Float32Array:
    """Return the reflectance of the coat over its mean, float32 array of `shape` (H, W).

    Its standard deviation is `contrast`. All presses of a skin share the array; nobody may write to it.
    """
    if contrast == 0.0:
        return np.ones(shape, np.float32)
    random = np.random.Generator(np.random.SFC64([seed, 0x5C]))
    grain = random.standard_normal(shape, dtype=np.float32)
    spots = cv2.GaussianBlur(random.standard_normal(shape, dtype=np.float32), (0, 0), SPOT_PX)
    mixed = (grain + spots / np.float32(spots.std())) / np.float32(np.sqrt(2.0))
    pattern = np.asarray(np.maximum(np.float32(1.0) + np.float32(contrast) * mixed, np.float32(0.05)), np.float32)
    pattern.setflags(write=False)
    return pattern


@dataclass(frozen=True, slots=True)
class Press:
    """An object on the gel: origin at `centre_mm`, turned by `turn_rad`, its top `indentation_mm` deep."""

    surface: Surface
    centre_mm: tuple[float, float]
    turn_rad: float
    indentation_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A press, rendered without noise.

    charge_e : for each light, float32 array of shape (H, W), electrons per mA and ms of exposure
    """

    skin: Skin
    charge_e: tuple[Float32Array, ...]


def render(profile: BoardProfile, press: Press | None) -> Scene:
    """Return the scene of a press, or of the untouched skin for None."""
    twin = profile.twin
    if twin is None:
        raise ValueError(f"board {profile.name!r} has no [twin] table")
    lens = Lens.of(profile)
    skin = _lay_skin(profile, lens, press)
    geometry = skin_geometry(lens, skin.height_mm)
    pigment = pigment_pattern(skin.height_mm.shape, twin.pigment_contrast, twin.seed)
    charges = []
    for index, light in enumerate(profile.lights):
        seen = light_on_skin(profile, geometry, lens, light.position_mm)
        red, green, blue = (row[index] for row in twin.crosstalk)
        weights = mosaic_weights(profile.sensor, (red, green, blue)) * np.float32(twin.yield_e_per_ma_ms)
        charges.append(lens.transmit(seen * pigment, skin.height_mm) * weights)
    return Scene(skin, tuple(charges))


def light_on_skin(
    profile: BoardProfile, geometry: SkinGeometry, lens: Lens, position_mm: tuple[float, float, float]
) -> Float32Array:
    """Return the radiance of the skin under one light, float32 array (H, W): a bare point, or the mean of its LEDs."""
    twin = profile.twin or TwinConfig()
    if profile.beam is None:
        return radiance(geometry, lens, coat(twin.skin), position_mm, twin.light_radius_mm)
    points_mm = (geometry.x_mm, geometry.y_mm, geometry.z_mm)
    total = np.zeros_like(geometry.z_mm)
    leds_mm = led_places_mm(position_mm, profile.beam)
    for led_mm in leds_mm:
        bare = radiance(geometry, lens, coat(twin.skin), led_mm, twin.light_radius_mm)
        total += bare * np.asarray(beam_fraction(points_mm, led_mm, position_mm, profile.beam), np.float32)
    return total / np.float32(len(leds_mm))


def _lay_skin(profile: BoardProfile, lens: Lens, press: Press | None) -> Skin:
    """Return the skin on the camera's pixel grid.

    The object is seen in perspective before the skin is laid over it, so contact is exact; the free skin between is
    stretched by height over camera distance, about one percent, as in the image.
    """
    if press is None:
        shape = (profile.sensor.rows, profile.sensor.columns)
        return Skin(np.zeros(shape, np.float32), np.zeros(shape, np.bool_))
    seen = lens.see(press.surface, press.centre_mm, press.turn_rad, press.indentation_mm)
    return drape(seen, lens.pitch_mm, profile.gel.slab_thickness_mm)


def mosaic_weights(sensor: SensorConfig, passed: tuple[float, float, float]) -> Float32Array:
    """Return the fraction of a light that each pixel's filter passes, float32 array of shape (H, W).

    passed : fractions that the filters of R, G and B pass
    """
    cell = np.array([passed["RGB".index(letter)] for letter in native_order(sensor)], np.float32).reshape(2, 2)
    return np.tile(cell, (sensor.rows // 2, sensor.columns // 2))


def native_order(sensor: SensorConfig) -> BayerOrder:
    """Return the order that the simulated sensor has, and grants to a profile that leaves it to the camera."""
    return "RGGB" if sensor.bayer_order == AS_GRANTED else sensor.bayer_order


def expose(
    charge_e: Float32Array, sensor: SensorConfig, analogue_gain: float, random: np.random.Generator
) -> NDArray[np.uint16]:
    """Return counts (dn), uint16 array of shape (H, W), for the expected charge (e⁻) of each pixel.

    Shot noise is approximated as normal: accurate above ten electrons, and below that read noise dominates.
    """
    noise = random.standard_normal(charge_e.shape, dtype=np.float32)
    noise *= np.sqrt(charge_e + np.float32(sensor.read_noise_e**2))
    collected = np.minimum(charge_e + noise, np.float32(sensor.full_well_e))
    dn_per_e = analogue_gain * (sensor.white_level_dn - sensor.black_level_dn) / sensor.full_well_e
    counts = collected * np.float32(dn_per_e) + np.float32(sensor.black_level_dn)
    return np.asarray(np.clip(np.rint(counts), 0.0, sensor.white_level_dn), np.uint16)


# Light on the skin: near point lights, fall-off, cosine law, metal flakes, cast shadows. Physics, no fitted model.

UNIT_DISTANCE_MM: Final = 25.0
"""Distance of the light at which a white skin facing it has radiance 1."""


@dataclass(frozen=True, slots=True)
class Coat:
    """Reflectance of the skin: a Lambertian part, and flakes that scatter about the surface normal.

    flake_fraction : 0 for a diffuse skin
    lobe_half_width_rad : angle between normal and half vector at which the lobe of the flakes has fallen to one half
    """

    flake_fraction: float
    lobe_half_width_rad: float


_COATS: Final[dict[str, Coat]] = {
    "diffuse": Coat(0.0, 1.0),
    "flake": Coat(0.5, float(np.radians(20.0))),
    "sharp-flake": Coat(0.5, float(np.radians(8.0))),
}


def coat(name: str) -> Coat:
    """Return the coat of that name in a board profile."""
    return _COATS[name]


@dataclass(frozen=True, slots=True, eq=False)
class SkinGeometry:
    """Points (mm) and unit normals of the skin, float32 arrays of shape (H, W)."""

    x_mm: Float32Array
    y_mm: Float32Array
    z_mm: Float32Array
    normal_x: Float32Array
    normal_y: Float32Array
    normal_z: Float32Array


def skin_geometry(lens: Lens, height_mm: FloatArray) -> SkinGeometry:
    """Return points and normals of a skin from its height on the pixel grid, array of shape (H, W), mm."""
    x, y = lens.points_mm(height_mm)
    slope_x, slope_y = lens.skin_slopes(height_mm)
    up = 1.0 / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    arrays = (x, y, height_mm, -slope_x * up, -slope_y * up, up)
    return SkinGeometry(*(np.asarray(a, np.float32) for a in arrays))


def radiance(
    skin: SkinGeometry, lens: Lens, skin_coat: Coat, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Return the radiance of the skin towards the camera under one light, float32 array of shape (H, W)."""
    away = [np.float32(at) - here for at, here in zip(light_mm, (skin.x_mm, skin.y_mm, skin.z_mm), strict=True)]
    squared = away[0] ** 2 + away[1] ** 2 + away[2] ** 2
    inverse = 1.0 / np.sqrt(squared)
    to_light = [a * inverse for a in away]
    normal = (skin.normal_x, skin.normal_y, skin.normal_z)
    cosine = np.maximum(sum(n * a for n, a in zip(normal, to_light, strict=True)), np.float32(0.0))
    reflected = cosine * np.float32(1.0 - skin_coat.flake_fraction)
    if skin_coat.flake_fraction > 0.0:
        reflected = reflected + np.float32(skin_coat.flake_fraction) * _flakes(skin, lens, skin_coat, to_light, cosine)
    seen = visible_fraction(skin.z_mm, lens.pitch_mm, light_mm, light_radius_mm)
    return np.asarray(reflected * seen * np.float32(UNIT_DISTANCE_MM**2) / squared, np.float32)


def _flakes(
    skin: SkinGeometry, lens: Lens, skin_coat: Coat, to_light: list[FloatArray], cosine: FloatArray
) -> FloatArray:
    """Return the lobe of the flakes, array (H, W): 1 where the normal halves the angle between light and camera."""
    to_camera = (-skin.x_mm, -skin.y_mm, np.float32(lens.distance_mm) - skin.z_mm)
    inverse = 1.0 / np.sqrt(sum(v**2 for v in to_camera))
    half = [a + v * inverse for a, v in zip(to_light, to_camera, strict=True)]
    length = np.sqrt(sum(h**2 for h in half))
    normal = (skin.normal_x, skin.normal_y, skin.normal_z)
    aligned = sum(n * h for n, h in zip(normal, half, strict=True)) / length
    angle = np.arccos(np.clip(aligned, -1.0, 1.0))
    lobe = np.exp(np.float32(-np.log(2.0)) * (angle / np.float32(skin_coat.lobe_half_width_rad)) ** 2)
    # Flakes shadow each other at grazing incidence.
    return lobe * (cosine / (cosine + np.float32(0.1)))


_GRID_CELLS: Final = 100_000
"""Size of the reduced grid on which cast shadows are computed."""


def visible_fraction(
    height_mm: FloatArray, pitch_mm: float, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Return the fraction (0 to 1) of the light's disc that each point sees, float32, shape of `height_mm`."""
    rows, columns = height_mm.shape
    reduction = max(1, round((rows * columns / _GRID_CELLS) ** 0.5))
    size = (max(columns // reduction, 2), max(rows // reduction, 2))
    small = np.asarray(cv2.resize(np.asarray(height_mm, np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    fraction = _march(small, pitch_mm * columns / size[0], light_mm, light_radius_mm)
    return np.asarray(cv2.resize(fraction, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)


def _march(
    height: Float32Array, cell_mm: float, light_mm: tuple[float, float, float], light_radius_mm: float
) -> Float32Array:
    """Walk from every cell towards the light; keep the smallest angle by which its ray clears the skin."""
    rows, columns = height.shape
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    away_x = np.float32(light_mm[0]) - (column - (columns - 1) / 2) * np.float32(cell_mm)
    away_y = np.float32(light_mm[1]) - (row - (rows - 1) / 2) * np.float32(cell_mm)
    across = np.hypot(away_x, away_y)
    rise = (np.float32(light_mm[2]) - height) / across
    step_column, step_row = away_x / across, away_y / across
    clearance = np.full_like(height, np.inf)
    reach_cells = float(np.ptp(height)) / float(rise.min()) / cell_mm + 2.0
    at_column, at_row, clear = np.empty_like(height), np.empty_like(height), np.empty_like(height)
    # The nearest cells are left to the cosine law: there the steps of the grid itself would cast shadows.
    for cells in np.arange(2.0, reach_cells + 1.0, 1.0, dtype=np.float32):
        np.multiply(step_column, cells, out=at_column)
        np.multiply(step_row, cells, out=at_row)
        at_column += column
        at_row += row
        cv2.remap(height, at_column, at_row, cv2.INTER_LINEAR, clear, cv2.BORDER_REPLICATE)
        np.subtract(height, clear, out=clear)
        clear /= cells * np.float32(cell_mm)
        clear += rise
        np.minimum(clearance, clear, out=clearance)
    half_angle = np.float32(light_radius_mm) / np.hypot(across, np.float32(light_mm[2]) - height)
    return np.asarray(np.clip(0.5 + 0.5 * clearance / half_angle, 0.0, 1.0), np.float32)


# A board's profile as a twin: its sensor, scale, lens and lights in the simulated world.


def twin_of(profile: BoardProfile) -> BoardProfile:
    """Return the profile with the twin's driver, its camera where the lens stands sharp.

    Raises
    ------
    BoardProfileError
        The profile has no [lens] table, so nobody knows how sharp it is or from where it looks.
    """
    if profile.lens is None:
        raise BoardProfileError(f"board {profile.name!r} has no [lens] table: state focal_mm, f_number and pixel_um")
    magnification = profile.lens.pixel_um / profile.sensor.pixel_pitch_um
    # From inside the gel the lens seems farther: rays bend where they leave the block.
    distance_mm = GEL_INDEX * profile.lens.focal_mm * (1.0 + 1.0 / magnification)
    twin = profile.twin or TwinConfig()
    as_twin = msgspec.structs.replace(twin, camera_distance_mm=distance_mm)
    return msgspec.structs.replace(profile, driver="twin", twin=as_twin)
