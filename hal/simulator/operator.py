"""The twin's operator: carries out requests in the simulated world, then pushes the button."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from hal.errors import OperatorError
from hal.interfaces import ButtonPress, LiftOff, MayLift, NeverMind, OperatorRequest, PressBall, PressObject, SetFault
from hal.simulator.bench import SimulatedScene
from hal.simulator.elastomer import MAX_COMPRESSION, ball_indentation_mm
from hal.simulator.scene import Press
from hal.simulator.surfaces import (
    Block,
    Coin,
    Groove,
    Leaning,
    Pebbles,
    Plane,
    Sinusoid,
    Sphere,
    SphereGrid,
    Step,
    Surface,
    Texture,
)


@dataclass(frozen=True, slots=True)
class Specimen:
    """A surface and its indentation (mm)."""

    surface: Surface
    indentation_mm: float


_GALLERY: Mapping[str, Callable[[], Specimen]] = {
    "sphere": lambda: Specimen(Sphere(3.0), 1.2),
    "sphere-grid": lambda: Specimen(SphereGrid(1.0, 2.5, 2), 0.45),
    "plane": lambda: Specimen(Plane(Block(3.0, 2.5), 0.05, 0.03), 0.6),
    "sinusoid": lambda: Specimen(Sinusoid(Block(5.0, 3.5), 1.5, 0.06), 0.45),
    "groove": lambda: Specimen(Groove(Block(4.5, 3.5), 0.8, 0.2, 0.12), 0.5),
    "step": lambda: Specimen(Step(Block(4.5, 3.5), 0.1, 0.15), 0.5),
    "coin": lambda: Specimen(Coin(5.0, 0.18, 0.18), 0.5),
    "pebbles": lambda: Specimen(Pebbles(0.9, 2.8, 11), 0.4),
    "texture": lambda: Specimen(Texture(Block(4.5, 3.5), 0.012, 0.5, 0.15), 0.45),
}


def gallery_names() -> tuple[str, ...]:
    """Return names of the specimens."""
    return tuple(_GALLERY)


def specimen(name: str) -> Specimen:
    """Return the specimen of that name.

    Raises
    ------
    KeyError
        Unknown name.
    """
    return _GALLERY[name]()


BALL_SLOPE_DEG: Final = 40.0
"""Slope at the rim of the contact to which the operator presses a ball."""

DIM_LEVEL: Final = 0.9
WOBBLE_MM: Final = 0.3
LOW_BATTERY: Final = 0.08
LEAN: Final = 0.18
LEAN_REACH_MM: Final = 5.0
LEAN_DEPTH: Final = 0.8
"""What the faults of `SetFault` amount to: a light's level, the hand's movement, charge, and slope and depth of a press
that leans."""

_BUTTON_AFTER_S: Final = 0.8
_BUTTON_HELD_S: Final = 0.12
_PLACEMENT_MM: Final = 0.1
_TURN_RAD: Final = 0.03
_RESET: Final = 0.3
"""Error of a hand that moves from where it stood, as a share of one that places an object."""


class TwinOperator:
    """A slightly imprecise hand, repeatable by its seed; see `hal.interfaces.Operator`."""

    def __init__(self, bench: SimulatedScene) -> None:
        self._bench = bench
        self._random = np.random.default_rng([bench.seed, 0x0B])
        self._shown: Press | None = None
        self._placed: tuple[str, complex, float] | None = None
        self._pushes: list[ButtonPress] = []

    def ask(self, request: OperatorRequest) -> None:
        """Carry out the request at once and push the button a little later; lift what was pressed by name.

        Raises
        ------
        OperatorError
            Unknown specimen, or the gel is too thin for it.
        """
        if isinstance(request, MayLift):
            if self._shown is not None and self._bench.pressed is self._shown:
                self._bench.place(None)
            return
        if isinstance(request, SetFault):
            self._set_fault(request)
            return
        if isinstance(request, NeverMind):
            self._bench.place(None)
            for push in self._to_come():
                self._bench.withdraw_button(push)
            return
        press = self._press_for(request)
        self._shown = press if isinstance(request, PressObject) else None
        self._bench.place(press)
        if isinstance(request, PressObject) and not request.pushes:
            return
        began_ns = self._bench.clock.monotonic_ns() + round(_BUTTON_AFTER_S * 1e9)
        self._pushes = [*self._to_come(), ButtonPress(began_ns, _BUTTON_HELD_S)]
        self._bench.schedule_button(self._pushes[-1])

    def _to_come(self) -> list[ButtonPress]:
        """Return own pushes of the button that have not begun."""
        now_ns = self._bench.clock.monotonic_ns()
        return [push for push in self._pushes if push.began_ns > now_ns]

    def _press_for(self, request: LiftOff | PressBall | PressObject) -> Press | None:
        match request:
            case LiftOff():
                return None
            case PressBall():
                return self._ball(request)
            case PressObject():
                return self._object(request)

    def _object(self, request: PressObject) -> Press:
        name = request.name
        if name not in gallery_names():
            raise OperatorError(f"the twin has no object {name!r}: choose one of {', '.join(gallery_names())}")
        shown = specimen(name)
        if shown.indentation_mm > self._max_depth_mm():
            raise OperatorError(
                f"{name!r} needs {shown.indentation_mm:g} mm, more than the {self._max_depth_mm():g} mm of this gel: "
                "use a board with a thicker slab"
            )
        centre, turn = self._place(name, request.way)
        centre_mm = (centre.real, centre.imag)
        faults, depth_mm, surface = self._bench.faults, shown.indentation_mm, shown.surface
        if faults.leaning:
            surface, depth_mm = Leaning(surface, LEAN, LEAN_REACH_MM), LEAN_DEPTH * self._max_depth_mm()
        if faults.too_deep:
            depth_mm = self._max_depth_mm()
        return Press(surface, centre_mm, turn, depth_mm)

    def _place(self, name: str, way: tuple[float, float, float] | None) -> tuple[complex, float]:
        """Return the place of the object in the view, mm right and (imaginary) down, and its turn."""
        x, y, turn = (float(value) for value in self._random.normal(0.0, 1.0, 3))
        off, off_rad = complex(x, y) * _PLACEMENT_MM, turn * _TURN_RAD
        if way is not None and self._placed is not None and self._placed[0] == name:
            _, centre, before_rad = self._placed
            right_mm, down_mm, clockwise_deg = way
            turned_rad = float(np.radians(clockwise_deg))
            # What the view shows moves against the instrument.
            centre = (centre - complex(right_mm, down_mm)) * np.exp(-1j * turned_rad)
            off, off_rad = complex(centre + _RESET * off), before_rad - turned_rad + _RESET * off_rad
        self._placed = name, off, off_rad
        return off, off_rad

    def _set_fault(self, request: SetFault) -> None:
        """Switch one of the world's faults; every light that is affected is the last one."""
        faults, light = self._bench.faults, self._bench.profile.lights[-1].name
        match request.name:
            case "dim":
                faults.dimmed = {light: DIM_LEVEL} if request.on else {}
            case "break":
                faults.open_lights = {light} if request.on else set()
            case "wobble":
                faults.wobble_mm = WOBBLE_MM if request.on else 0.0
            case "dirt":
                faults.dirty = request.on
            case "tilt":
                faults.leaning = request.on
            case "depth":
                faults.too_deep = request.on
            case "battery":
                faults.battery_share = LOW_BATTERY if request.on else None
            case "stall":
                faults.camera_stalled = request.on

    def _ball(self, request: PressBall) -> Press:
        """Return a ball pressed to `BALL_SLOPE_DEG`, less where slab or field are too small, inside the field."""
        sensor = self._bench.profile.sensor
        size_mm = np.array([sensor.columns, sensor.rows]) * sensor.pixel_pitch_um * 1e-3
        if not request.radius_mm > 0.0:
            raise OperatorError(f"a ball of radius {request.radius_mm:g} mm cannot be pressed: name a radius above 0")
        slope_rad = self._rim_slope_rad(request.radius_mm, float(size_mm.min()))
        contact_mm = request.radius_mm * np.sin(slope_rad)
        requested = (np.array([request.column_share, request.row_share]) - 0.5) * size_mm
        reach = size_mm / 2.0 - 1.1 * contact_mm
        centre = np.clip(requested + self._random.normal(0.0, _PLACEMENT_MM, 2), -reach, reach)
        depth_mm = ball_indentation_mm(request.radius_mm, slope_rad, self._bench.profile.gel.slab_thickness_mm)
        return Press(Sphere(request.radius_mm), (float(centre[0]), float(centre[1])), 0.0, depth_mm)

    def _rim_slope_rad(self, radius_mm: float, field_mm: float) -> float:
        thickness_mm = self._bench.profile.gel.slab_thickness_mm
        for slope_deg in np.arange(BALL_SLOPE_DEG, 0.0, -0.5):
            slope_rad = float(np.radians(slope_deg))
            fits = 2.2 * radius_mm * np.sin(slope_rad) <= field_mm
            if fits and ball_indentation_mm(radius_mm, slope_rad, thickness_mm) <= self._max_depth_mm():
                return slope_rad
        raise OperatorError(f"a ball of radius {radius_mm:g} mm does not fit into the field: use a smaller one")

    def _max_depth_mm(self) -> float:
        return MAX_COMPRESSION * self._bench.profile.gel.slab_thickness_mm
