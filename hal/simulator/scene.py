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
import numpy as np
from numpy.typing import NDArray

from hal.board_profile import BoardProfile, SensorConfig, TwinConfig
from hal.frame import AS_GRANTED, BayerOrder
from hal.profile_tables import BeamConfig
from hal.simulator.arrays import Float32Array, FloatArray
from hal.simulator.elastomer import Skin, drape
from hal.simulator.lens import Lens
from hal.simulator.optics import SkinGeometry, coat, radiance, skin_geometry
from hal.simulator.surfaces import Surface

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
    """Intensity of an LED towards points of the skin, relative to that of a bare one on its axis.

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
    """Unit vector along which the light's LEDs look."""
    level = np.asarray((-position_mm[0], -position_mm[1], 0.0))
    across = float(np.linalg.norm(level))
    past = level * (beam.aim_past_mm / across) if across > 0.0 else level
    towards = past - np.asarray(position_mm)
    return np.asarray(towards / np.linalg.norm(towards))


def _passed(outside: FloatArray, inside: FloatArray) -> FloatArray:
    """Fraction of unpolarised light that enters the facet, from the sines of its angles to the normal (Fresnel)."""
    cos_out, cos_in = np.sqrt(1.0 - outside**2), np.sqrt(1.0 - inside**2)
    across = (cos_out - ACRYLIC * cos_in) / (cos_out + ACRYLIC * cos_in)
    along = (ACRYLIC * cos_out - cos_in) / (ACRYLIC * cos_out + cos_in)
    return np.asarray(1.0 - (across**2 + along**2) / 2.0)


SPOT_PX = 2.0
"""Standard deviation of the spots, pixels; as much of the contrast is grain of single pixels."""


@lru_cache(maxsize=1)
def pigment_pattern(shape: tuple[int, int], contrast: float, seed: int) -> Float32Array:
    """Reflectance of the coat over its mean: float32 array of `shape` (H, W), its standard deviation `contrast`.

    The same array for every press of a skin; nobody may write to it.
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
    """The scene of a press, or of the untouched skin for None."""
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
    """Radiance of the skin under one light, float32 array of shape (H, W): a bare point, or the mean of its LEDs."""
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
    """The skin on the camera's pixel grid.

    The object is seen in perspective before the skin is laid over it, so contact is exact; the free skin between is
    stretched by height over camera distance, about one percent, as in the image.
    """
    if press is None:
        shape = (profile.sensor.rows, profile.sensor.columns)
        return Skin(np.zeros(shape, np.float32), np.zeros(shape, np.bool_))
    seen = lens.see(press.surface, press.centre_mm, press.turn_rad, press.indentation_mm)
    return drape(seen, lens.pitch_mm, profile.gel.slab_thickness_mm)


def mosaic_weights(sensor: SensorConfig, passed: tuple[float, float, float]) -> Float32Array:
    """Fraction of a light that each pixel's filter passes, float32 array of shape (H, W), from `passed` by R, G, B."""
    cell = np.array([passed["RGB".index(letter)] for letter in native_order(sensor)], np.float32).reshape(2, 2)
    return np.tile(cell, (sensor.rows // 2, sensor.columns // 2))


def native_order(sensor: SensorConfig) -> BayerOrder:
    """The order that the simulated sensor has, and grants to a profile that leaves it to the camera."""
    return "RGGB" if sensor.bayer_order == AS_GRANTED else sensor.bayer_order


def expose(
    charge_e: Float32Array, sensor: SensorConfig, analogue_gain: float, random: np.random.Generator
) -> NDArray[np.uint16]:
    """Counts (dn), uint16 array of shape (H, W), for the expected charge (e⁻) of each pixel.

    Shot noise is approximated as normal: accurate above ten electrons, and below that read noise dominates.
    """
    noise = random.standard_normal(charge_e.shape, dtype=np.float32)
    noise *= np.sqrt(charge_e + np.float32(sensor.read_noise_e**2))
    collected = np.minimum(charge_e + noise, np.float32(sensor.full_well_e))
    dn_per_e = analogue_gain * (sensor.white_level_dn - sensor.black_level_dn) / sensor.full_well_e
    counts = collected * np.float32(dn_per_e) + np.float32(sensor.black_level_dn)
    return np.asarray(np.clip(np.rint(counts), 0.0, sensor.white_level_dn), np.uint16)
