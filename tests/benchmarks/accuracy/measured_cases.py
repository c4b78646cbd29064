"""Measurements on presses of the twin, and how often the stated interval contains the true number.

The truth is measured by the same recipe on the true skin, where the reconstruction has a height: the difference is the
error of the reconstruction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import msgspec
import numpy as np

from device.surface import Float32Array, HeightMap, MaskArray
from host_sync.measurement.height_samples import StatedScale
from host_sync.measurement.measure import measure
from host_sync.measurement.recipe import ProfileTable, RadiusTable, Recipe, StepTable
from host_sync.results.reader import ResultSurface

FACE_UM: Final = (5500.0, 4500.0, 11900.0, 8500.0)
"""The middle of the blocks, where the skin touches them."""

_PROFILE: Final = ProfileTable(name="line", from_um=(5500.0, 6500.0), to_um=(11900.0, 6500.0), l_filter_um=800.0)
_AREAL: Final = Recipe(region_um=FACE_UM, s_filter_um=36.0, l_filter_um=2500.0, profile=(_PROFILE,))
_RAW: Final = Recipe(
    region_um=FACE_UM, profile=(ProfileTable(name="line", from_um=_PROFILE.from_um, to_um=_PROFILE.to_um),)
)


def _across(name: str, kind: str) -> Recipe:
    step = StepTable(name=name, from_um=(6200.0, 6500.0), to_um=(11200.0, 6500.0), width_um=500.0, kind=kind)
    return Recipe(region_um=FACE_UM, parameters=("Sa", "Sq", "Sz"), step=(step,))


RECIPES: Final = {
    "texture": (_AREAL, _RAW),
    "sinusoid": (_AREAL, _RAW),
    "step": (_across("step", "step"),),
    "groove": (_across("groove", "groove"),),
}

NOTHING: Final = 1e-3
"""A truth below this share of the number is too small to divide by."""


@dataclass(frozen=True, slots=True)
class Case:
    """One number of one press."""

    number: str
    value: float
    truth: float
    standard_um: float

    @property
    def ratio(self) -> float:
        """Error over the stated standard uncertainty."""
        return (self.value - self.truth) / self.standard_um


def judged(
    name: str, found: ResultSurface, truth_um: Float32Array, contact: MaskArray, scale: StatedScale
) -> Iterator[Case]:
    """Every number of a press of the named object (or ball) beside its truth."""
    masked = np.where(np.isfinite(found.height.z_um), truth_um, np.float32(np.nan)).astype(np.float32)
    # The truth has one kind of detail and no noise: both are taken from it, none of the result's is left beside it.
    record = msgspec.structs.replace(found.record, surface_detail="shrunk")
    height = HeightMap(masked, found.height.pitch_um)
    true = replace(found, height=height, other=None, record=record, samples_um=None, slope_sigma=None, sigma_um=None)
    for plain in RECIPES.get(name) or (_ball(contact, found.height.pitch_um),):
        recipe = msgspec.structs.replace(plain, scale=scale)
        pairs = zip(measure(found, recipe).quantities, measure(true, recipe).quantities, strict=True)
        for ours, real in pairs:
            if ours.value is not None and real.value is not None and ours.uncertainty:
                label = f"{name}{'' if recipe.l_filter_um else ' unfiltered'} {ours.subject}/{ours.name}"
                yield Case(label, ours.value, real.value, ours.uncertainty / ours.coverage_factor)


def shares(cases: Mapping[str, list[Case]]) -> Iterator[tuple[str, int, float, float, float, float]]:
    """By number: count, fraction within one and within two standard uncertainties, root mean square of error over
    uncertainty, and of error over truth."""
    for number, some in cases.items():
        ratio = np.abs([case.ratio for case in some])
        # Of a number that may be zero there is no share: then the error over its own size is shown.
        share = np.array([(case.value - case.truth) / _size(case) for case in some])
        spread, off = (float(np.sqrt((one**2).mean())) for one in (ratio, share))
        yield number, len(some), float((ratio <= 1.0).mean()), float((ratio <= 2.0).mean()), spread, off


def _size(case: Case) -> float:
    """Of the truth; of the number itself where that is next to nothing."""
    value, truth = abs(case.value), abs(case.truth)
    return (truth if truth > NOTHING * value else value) or 1.0


def _ball(contact: MaskArray, pitch_um: float) -> Recipe:
    """The radius over the square inside a ball's contact."""
    rows, columns = np.nonzero(contact)
    middle = np.array([columns.mean(), rows.mean()]) * pitch_um
    half = 0.6 * np.sqrt(contact.sum() / np.pi) * pitch_um
    left, top = (float(value) for value in middle - half)
    right, bottom = (float(value) for value in middle + half)
    region = (left, top, right, bottom)
    return Recipe(
        region_um=region, form="none", parameters=("Sq", "Sz"), radius=(RadiusTable(name="ball", region_um=region),)
    )
