"""The period of a certified grating along a line, by a least-squares fit of its harmonics: a fraction of a pixel.

Counting profile elements (RSm) is good to a fraction of an element; the phase of a wave over the whole line is not
limited by that.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from device.surface.fields import Float64Array
from host_sync.certificate.specimen_file import SpecimenFile
from host_sync.errors import MeasurementError
from host_sync.measurement.height_samples import HeightSamples, StatedScale
from host_sync.measurement.quantity import Quantity, uncertainty_of
from host_sync.profile.profile_line import Line, Profile, profile_along
from host_sync.results.reader import ResultSurface

HARMONICS: Final = 3
SEARCHED: Final = 0.1
"""The period is looked for within this fraction of the certified one."""

MIN_PERIODS: Final = 3.0
MIN_EXPLAINED: Final = 0.5
"""The line must show so many periods, and their harmonics so much of its variance."""


def measured_period(specimen: SpecimenFile, surface: ResultSurface, scale: StatedScale) -> Quantity:
    """The period along the specimen's line, and its ± from every surface that the result's samples allow.

    scale : standard uncertainties that the calibration did not measure

    Raises
    ------
    MeasurementError
        The line is too short, or shows no such period.
    """
    how, pitch_um = specimen.measure, surface.height.pitch_um
    assert how.from_um is not None  # noqa: S101 - checked where the file was read
    assert how.to_um is not None  # noqa: S101 - likewise
    line = Line(how.from_um, how.to_um, how.width_um)
    profile = profile_along(surface.height.z_um, pitch_um, line)
    value = period_um(profile, specimen.certified_um, str(surface.folder))
    drawn = []
    for one in HeightSamples(surface, scale).surfaces():
        seen = profile_along(one.z_um, pitch_um, line)
        try:
            drawn.append(one.stretch * period_um(seen, specimen.certified_um, str(surface.folder)))
        except MeasurementError:
            drawn.append(float("nan"))  # as any number that a sample does not show
    known = uncertainty_of(value, np.array(drawn))
    return Quantity(
        subject=specimen.name,
        name="period",
        unit="µm",
        value=value,
        uncertainty=known[0] if known else None,
        coverage_factor=1,
        offset=known[1] if known else None,
        samples=known[2] if known else 0,
        masked_share=profile.masked_share,
    )


def period_um(profile: Profile, expected_um: float, source: str) -> float:
    """The period nearest to the expected one that explains a profile best, µm; `source` names it in errors.

    Raises
    ------
    MeasurementError
        As for `measured_period`.
    """
    known = np.isfinite(profile.z_um)
    along, z_um = profile.along_um[known], profile.z_um[known]
    if along.size < 8 or along[-1] - along[0] < MIN_PERIODS * expected_um:
        raise MeasurementError(f"{source}: the line shows fewer than {MIN_PERIODS:g} periods: lengthen it")
    # Steps so fine that the phase over the whole line cannot slip by half a turn between two of them.
    count = int(np.ceil(8.0 * 2.0 * SEARCHED * (along[-1] - along[0]) / expected_um)) + 3
    tried = expected_um * np.linspace(1.0 - SEARCHED, 1.0 + SEARCHED, count)
    left = [_unexplained(along, z_um, period) for period in tried]
    best = int(np.clip(np.argmin(left), 1, count - 2))
    found = minimize_scalar(
        lambda period: _unexplained(along, z_um, period), bounds=(tried[best - 1], tried[best + 1]), method="bounded",
        options={"xatol": 1e-7 * expected_um},
    )  # fmt: skip
    if float(found.fun) > 1.0 - MIN_EXPLAINED:
        raise MeasurementError(
            f"{source}: shows no period near {expected_um:g} µm along the line: check from_um, to_um"
        )
    return float(found.x)


def _unexplained(along: Float64Array, z_um: Float64Array, period_um: float) -> float:
    """Fraction of a profile's variance that a line and the harmonics of a period leave."""
    phase = 2.0 * np.pi * along / period_um
    waves = [wave(n * phase) for n in range(1, HARMONICS + 1) for wave in (np.sin, np.cos)]
    plain = np.stack([np.ones_like(along), along - along.mean()], axis=-1)
    straight = z_um - plain @ np.linalg.lstsq(plain, z_um, rcond=None)[0]
    design = np.hstack([plain, np.stack(waves, axis=-1)])
    left = z_um - design @ np.linalg.lstsq(design, z_um, rcond=None)[0]
    return float((left**2).sum() / max(float((straight**2).sum()), 1e-12))
