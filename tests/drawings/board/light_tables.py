"""The tables of board/light-geometry.md, computed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hal.board_profile import load_board_profile
from hal.profile_tables import BeamConfig
from tests.drawings.board.aperture import BOARDS, blur
from tests.drawings.board.beam import (
    ENDLESS,
    brightest_to_darkest,
    centre_to_darkest,
    half_field_mm,
    light_over_field,
)
from tests.drawings.board.light_geometry import (
    Geometry,
    all_lit_deg,
    gain,
    scale_error,
    slope_noise,
    told_to_deg,
    unevenness,
    worst_corner_deg,
)

BLOCK = re.compile(r"(<!-- made by `make board`: (\w+) -->\n).*?(<!-- end -->\n)", re.DOTALL)
ELEVATIONS_DEG = (15, 20, 25, 30, 35, 40, 50, 60)
DISTANCES_MM = (15, 20, 25, 35, 50, 100, 250)
GAPS_DEG = (120, 130, 150, 180, 210)


def _sleeve(led_angle_deg: float, led_offsets_mm: tuple[float, ...], behind_mm: float, bore_mm: float) -> BeamConfig:
    return BeamConfig(led_angle_deg=led_angle_deg, led_offsets_mm=led_offsets_mm, behind_mm=behind_mm, bore_mm=bore_mm)


SLEEVES = {
    "30° wide, one | bore of 4 mm, 5 mm before the LED": _sleeve(30.0, (0.0,), 5.0, 4.0),
    "30° wide, two | at the facet": _sleeve(30.0, (-2.65, 2.65), 1.0, 4.4),
    "**60° wide, two** | **at the facet**": _sleeve(60.0, (-2.65, 2.65), 1.0, 4.4),
    "120° wide, two | at the facet": _sleeve(120.0, (-2.65, 2.65), 1.0, 4.4),
}
MOVES_MM = (0.02, 0.05, 0.1, 0.5)


def with_tables(page: str) -> str:
    """The page with each of its marked blocks computed again."""
    tables = {"elevation": _elevation, "distance": _distance, "spacing": _spacing, "paint": _paint, "moved": _moved}
    tables |= {"beam": _beam, "aperture": _aperture}
    return BLOCK.sub(lambda found: found[1] + "\n".join(tables[found[2]]()) + "\n" + found[3], page)


def _beam() -> Iterator[str]:
    yield "| LEDs | sleeve | centre : side edge, red | centre : darkest | brightest : darkest |"
    yield "|---|---|---|---|---|"
    profile = load_board_profile("pi5-imx296")
    for words, sleeve in SLEEVES.items():
        lit = [light_over_field(light.position_mm, sleeve, half_field_mm(profile)) for light in profile.lights]
        edge = lit[0][10, 10] / max(lit[0][10, 0], 1e-12)
        ratios = (edge, max(map(centre_to_darkest, lit)), max(map(brightest_to_darkest, lit)))
        yield f"| {words} | " + " | ".join(f"{one:.1f} : 1" if one < ENDLESS else "dark" for one in ratios) + " |"


def _aperture() -> Iterator[str]:
    yield "| board | f-number | diffraction | depth ± | in focus | 0.25 mm below | 0.5 mm below |"
    yield "|---|---|---|---|---|---|---|"
    for board in BOARDS:
        for f_number in (2.8, 4.0, 5.6, 8.0):
            b = blur(board, f_number)
            cells = (b.at_um(0.0), b.at_um(0.25), b.at_um(0.5))
            yield (
                f"| {board} | f/{f_number:g} | {b.airy_um:.1f} µm | {b.depth_mm:.2f} mm | "
                + " | ".join(f"{cell:.0f} µm" for cell in cells)
                + " |"
            )


def _elevation() -> Iterator[str]:
    yield "| elevation | gain | all lights reach the skin up to | slopes known up to | slope noise flat | at 20° |"
    yield "|---|---|---|---|---|---|"
    for degrees in ELEVATIONS_DEG:
        lights = Geometry(elevation_deg=degrees)
        yield (
            f"| {degrees}° | {gain(lights):.2f} | {all_lit_deg(lights):.0f}° | {told_to_deg(lights):.0f}° "
            f"| {_noise(lights, 0.0)} | {_noise(lights, 20.0)} |"
        )


def _distance() -> Iterator[str]:
    yield "| distance | current, same light | brightest : darkest of flat skin | all lights, at the worst corner |"
    yield "|---|---|---|---|"
    for distance in DISTANCES_MM:
        lights = Geometry(distance_mm=distance)
        yield (
            f"| {distance} mm | {(distance / 25.0) ** 2:.3g} × | {unevenness(lights):.1f} : 1 "
            f"| up to {worst_corner_deg(lights):.0f}° |"
        )


def _spacing() -> Iterator[str]:
    yield "| widest gap between two lights | slope noise flat, worst direction | at 20°, worst direction |"
    yield "|---|---|---|"
    for gap in GAPS_DEG:
        lights = Geometry(azimuths_deg=(-90.0, 90.0 - gap / 2, 90.0 + gap / 2))
        yield f"| {gap}° | {_noise(lights, 0.0)} | {_noise(lights, 20.0)} |"


def _paint() -> Iterator[str]:
    yield "| paint | elevation | gain | slope noise flat | at 20°, worst direction | slopes known up to |"
    yield "|---|---|---|---|---|---|"
    for skin in ("diffuse", "flake", "sharp-flake"):
        for degrees in (30, 50, 70):
            lights = Geometry(elevation_deg=degrees, skin=skin)
            yield (
                f"| {skin} | {degrees}° | {gain(lights):.2f} | {_noise(lights, 0.0)} | {_noise(lights, 20.0)} "
                f"| {told_to_deg(lights):.0f}° |"
            )


def _moved() -> Iterator[str]:
    yield "| a light moved by | up or down its arc | towards the skin | sideways |"
    yield "|---|---|---|---|"
    lights = Geometry()
    for move in MOVES_MM:
        turn = float(np.degrees(move / lights.distance_mm))
        first, *others = lights.azimuths_deg
        moved = (
            replace(lights, elevation_deg=lights.elevation_deg + turn),
            replace(lights, distance_mm=lights.distance_mm - move),
            replace(lights, azimuths_deg=(first + turn, *others)),
        )
        errors = " | ".join(f"{100.0 * scale_error(lights, after):.1f} %" for after in moved)
        yield f"| {move:g} mm | {errors} |"


def _noise(lights: Geometry, tilt_deg: float) -> str:
    """Slope noise of the worst direction, as printed."""
    worst = float(slope_noise(lights, tilt_deg).max())
    return f"{worst:.4f}" if worst < 0.1 else "undetermined"
