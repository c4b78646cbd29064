"""Metrological characteristics of an instrument as ISO 25178-600 names and ISO 25178-700 measures them.

A characteristic that the given specimens cannot show is named with the specimen that it would take: never a zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np

from device.surface import Float32Array, Float64Array
from host_sync.certificate.specimen_measurement import SpecimenFile, SpecimenResult
from host_sync.errors import MeasurementError
from host_sync.filters.form import PolynomialForm
from host_sync.profile.profile_line import Line, profile_along
from host_sync.results.reader import ResultSurface

EDGE_LEVELS: Final = (0.1, 0.9)
Symbol = Literal["N_M", "z_FLT", "α_z", "l_z", "α_x", "α_y", "W_R"]


class Characteristic(msgspec.Struct, frozen=True, kw_only=True):
    """One metrological characteristic.

    value, expanded : in `unit`, the latter with k = 2; None where not determined or not known
    basis : what it was taken from, or what it would take
    """

    symbol: Symbol
    name: str
    unit: str
    value: float | None
    expanded: float | None = None
    basis: str


@dataclass(frozen=True, slots=True)
class CheckedSpecimen:
    """A specimen, its judged result, and the surfaces of those scans that show it."""

    file: SpecimenFile
    result: SpecimenResult
    surfaces: tuple[ResultSurface, ...]


def characteristics(checked: Sequence[CheckedSpecimen]) -> tuple[Characteristic, ...]:
    """Return every characteristic, in the order in which ISO 25178-600 lists them."""
    return (
        _noise(checked),
        _flatness(checked),
        *_vertical(checked),
        _lateral(checked, "x"),
        _lateral(checked, "y"),
        _resolution(checked),
    )


def _noise(checked: Sequence[CheckedSpecimen]) -> Characteristic:
    """Sq of the difference of two scans of the same surface, over √2; the mean square over pairs that follow."""
    squares, names = [], []
    flats = [one for one in checked if one.file.kind == "flat" and len(one.surfaces) > 1]
    for one in flats or checked:
        for first, second in zip(one.surfaces, one.surfaces[1:], strict=False):
            difference = _part(first, one.file) - _part(second, one.file)
            known = np.isfinite(difference)
            if known.sum() > 100:
                squares.append(float(_levelled(difference)[known].var()) / 2.0)
                names.append(one.file.name)
    basis = "needs two scans of one specimen, one after the other, nothing moved between them"
    value = None
    if squares:
        value = float(np.sqrt(np.mean(squares)))
        pairs = "1 pair" if len(squares) == 1 else f"{len(squares)} pairs"
        basis = f"differences of {pairs} of scans: {', '.join(dict.fromkeys(names))}"
    return Characteristic(symbol="N_M", name="measurement noise, Sq", unit="µm", value=value, basis=basis)


def _flatness(checked: Sequence[CheckedSpecimen]) -> Characteristic:
    """Sz of the mean of all scans of a flat, its plane taken off."""
    name = "flatness deviation, Sz of the mean"
    for one in checked:
        if one.file.kind == "flat" and one.surfaces:
            mean = np.mean([_part(surface, one.file) for surface in one.surfaces], axis=0)
            flat = _levelled(mean)
            known = flat[np.isfinite(flat)]
            value = float(known.max() - known.min())
            basis = f"{one.file.name}, mean of {len(one.surfaces)} scans; its own {one.file.certified_um:g} µm is in it"
            return Characteristic(symbol="z_FLT", name=name, unit="µm", value=value, basis=basis)
    return Characteristic(symbol="z_FLT", name=name, unit="µm", value=None, basis='needs a specimen of kind "flat"')


def _vertical(checked: Sequence[CheckedSpecimen]) -> tuple[Characteristic, Characteristic]:
    """Return the amplification in z from steps and grooves, and the largest deviation from it."""
    points = [one.result for one in checked if one.file.kind in ("step", "groove") and one.result.mean_um is not None]
    alpha = _amplification("α_z", "amplification coefficient in z", points, "needs a step or a groove")
    name = "linearity deviation in z"
    if alpha.value is None or len({point.certified_um for point in points}) < 2:
        basis = "needs steps or grooves of two heights"
        return alpha, Characteristic(symbol="l_z", name=name, unit="µm", value=None, basis=basis)
    off = [abs((point.mean_um or 0.0) - alpha.value * point.certified_um) for point in points]
    return alpha, Characteristic(symbol="l_z", name=name, unit="µm", value=max(off), basis=alpha.basis)


def _lateral(checked: Sequence[CheckedSpecimen], axis: Literal["x", "y"]) -> Characteristic:
    """Return the amplification along an axis from specimens of certified period."""
    points = [one.result for one in checked if one.file.axis == axis and one.result.mean_um is not None]
    needed = f'needs a specimen of kind "period" along {axis}'
    return _amplification("α_x" if axis == "x" else "α_y", f"amplification coefficient in {axis}", points, needed)


def _amplification(symbol: Symbol, name: str, points: Sequence[SpecimenResult], needed: str) -> Characteristic:
    """Return the least-squares line through zero of measured over certified values, as a characteristic.

    needed : reported where there is no point

    The scale is common to all specimens: their uncertainties are taken as fully correlated.
    """
    if not points:
        return Characteristic(symbol=symbol, name=name, unit="", value=None, basis=needed)
    true = np.array([point.certified_um for point in points])
    seen = np.array([point.mean_um for point in points], np.float64)
    expanded = None
    if all(point.expanded_um is not None for point in points):
        both = np.array([float(np.hypot(p.expanded_um or 0.0, p.certified_expanded_um)) for p in points])
        expanded = float((true * both).sum() / (true * true).sum())
    alpha = float((true * seen).sum() / (true * true).sum())
    basis = ", ".join(point.name for point in points)
    return Characteristic(symbol=symbol, name=name, unit="", value=alpha, expanded=expanded, basis=basis)


def _resolution(checked: Sequence[CheckedSpecimen]) -> Characteristic:
    """Return the width of a step's edge between a tenth and nine tenths of its height: specimen and skin are in it."""
    name = "topographic spatial resolution, 10–90 % width of an edge"
    widths, names = [], []
    steps = [one for one in checked if one.file.kind == "step"]
    for one in steps or checked:
        if one.file.kind in ("step", "groove"):
            widths += [width for surface in one.surfaces if (width := _edge_width_um(one.file, surface)) is not None]
            names.append(one.file.name)
    if not widths:
        return Characteristic(symbol="W_R", name=name, unit="µm", value=None, basis="needs a step or a groove")
    scatter = float(2.0 * np.std(widths, ddof=1) / np.sqrt(len(widths))) if len(widths) > 1 else None
    basis = f"{', '.join(names)}; an upper bound: the specimen's own edge is in it"
    return Characteristic(
        symbol="W_R", name=name, unit="µm", value=float(np.mean(widths)), expanded=scatter, basis=basis
    )


def _edge_width_um(specimen: SpecimenFile, surface: ResultSurface) -> float | None:
    """10–90 % width of the first edge along the specimen's line; None where it has none."""
    how = specimen.measure
    if how.from_um is None or how.to_um is None:
        return None
    try:
        profile = profile_along(
            surface.height.z_um, surface.height.pitch_um, Line(how.from_um, how.to_um, how.width_um)
        )
    except MeasurementError:
        return None
    z_um, along = profile.z_um, profile.along_um
    known = np.isfinite(z_um)
    low, high = np.quantile(z_um[known], (0.05, 0.95))
    share = (np.interp(along, along[known], z_um[known]) - low) / max(high - low, 1e-9)
    return _crossing_width(along, share)


def _crossing_width(along: Float64Array, share: Float64Array) -> float | None:
    """Return the width of the steepest half-way crossing of a profile, 0 to 1; None without one.

    It is the distance between the places where the profile passes both `EDGE_LEVELS`.
    """
    half = np.flatnonzero(np.diff(share > 0.5))
    if not half.size:
        return None
    at = int(max(half, key=lambda i: abs(share[i + 1] - share[i])))
    rising = share[at + 1] > share[at]
    curve = share if rising else 1.0 - share
    before = np.flatnonzero(curve[: at + 1] <= EDGE_LEVELS[0])
    after = np.flatnonzero(curve[at:] >= EDGE_LEVELS[1])
    if not before.size or not after.size:
        return None
    first, last = int(before[-1]), at + int(after[0])
    start = np.interp(EDGE_LEVELS[0], curve[first : first + 2], along[first : first + 2])
    end = np.interp(EDGE_LEVELS[1], curve[last - 1 : last + 1], along[last - 1 : last + 1])
    return float(end - start)


def _part(surface: ResultSurface, specimen: SpecimenFile) -> Float32Array:
    """Return the heights of the specimen's region, the whole field where it has none."""
    z_um, region, pitch = surface.height.z_um, specimen.measure.region_um, surface.height.pitch_um
    if region is None:
        return z_um
    left, top, right, bottom = (round(edge / pitch) for edge in region)
    return z_um[max(top, 0) : bottom + 1, max(left, 0) : right + 1]


def _levelled(z_um: Float32Array) -> Float32Array:
    """Return heights without their plane."""
    return PolynomialForm(np.isfinite(z_um), 1).remove(z_um)
