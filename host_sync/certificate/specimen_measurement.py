"""Measures scans of a specimen with the measurement package, and compares the mean with the certified value.

The E_n number of ISO 13528 and ISO/IEC 17043, (x - X) / sqrt(U_x² + U_X²) with both U at k = 2, is at most one in
magnitude where instrument and certificate agree within what they state.

The period of a certified grating along a line, by a least-squares fit of its harmonics: a fraction of a pixel.

Counting profile elements (RSm) is good to a fraction of an element; the phase of a wave over the whole line is not
limited by that.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from scipy.optimize import minimize_scalar

from device.surface import Float64Array
from hal.validation import decode_toml
from host_sync.errors import MeasurementError
from host_sync.frames.frame_set_file import ImageNames
from host_sync.measurement.height_samples import HeightSamples, StatedScale
from host_sync.measurement.measure import measure
from host_sync.measurement.quantity import Quantity, uncertainty_of
from host_sync.measurement.recipe import Label, Length, Place, RadiusTable, Recipe, Rectangle, StepTable
from host_sync.profile.profile_line import Line, Profile, profile_along
from host_sync.profile.step_height import StepKind
from host_sync.results.reader import ResultSurface

COVERAGE: Final = 2.0
MAX_E_N: Final = 1.0
SPHERE_SIGMA: Final = 0.02
"""Standard uncertainty of the shape of what is a ball, as a fraction: see `height_draws`."""

SUBJECT: Final = "specimen"


class SpecimenResult(msgspec.Struct, frozen=True, kw_only=True):
    """Values from the scans of a specimen; lengths µm, uncertainties expanded with k = 2.

    values_um : of every scan that shows the specimen
    expanded_um : of their mean; None where a scan's ± is not known
    error_um : mean over certified
    e_n : None where it cannot be judged
    agrees : whether |E_n| is at most one; None likewise
    words : what cannot be judged and why, or which scan failed
    """

    name: str
    kind: str
    serial: str
    certificate: str
    quantity: str
    certified_um: float
    certified_expanded_um: float
    values_um: tuple[float, ...]
    mean_um: float | None
    expanded_um: float | None
    error_um: float | None
    e_n: float | None
    agrees: bool | None
    words: tuple[str, ...] = ()


def recipe_of(specimen: SpecimenFile) -> Recipe:
    """Return the recipe that measures a specimen; standard uncertainties."""
    how = specimen.measure
    scale = StatedScale(pixel_pitch_share=how.pixel_pitch_share, ball_radius_share=how.ball_radius_share)
    plain = Recipe(name=specimen.name, parameters=("Sq",), scale=scale)
    if specimen.kind in ("step", "groove"):
        kind: StepKind = "step" if specimen.kind == "step" else "groove"
        start, end = _ends(specimen)
        table = StepTable(
            name=SUBJECT, from_um=start, to_um=end, width_um=how.width_um, kind=kind, edges_um=how.edges_um
        )
        return msgspec.structs.replace(plain, step=(table,))
    if specimen.kind == "sphere" and how.region_um is not None:
        ball = RadiusTable(name=SUBJECT, region_um=how.region_um)
        sphere = msgspec.structs.replace(scale, unlike_balls_share=min(SPHERE_SIGMA, scale.unlike_balls_share))
        return msgspec.structs.replace(plain, radius=(ball,), region_um=how.region_um, form="none", scale=sphere)
    return msgspec.structs.replace(
        plain,
        region_um=how.region_um,
        s_filter_um=how.s_filter_um,
        l_filter_um=how.l_filter_um,
        parameters=(how.parameter if specimen.kind == "roughness" else "Sz",),
    )


def measured_quantity(specimen: SpecimenFile, surface: ResultSurface) -> Quantity:
    """Return the certified number as one scan shows it.

    Raises
    ------
    MeasurementError
        The scan does not show it.
    """
    if specimen.kind == "period":
        return measured_period(specimen, surface, recipe_of(specimen).scale)
    found = measure(surface, recipe_of(specimen)).quantities
    wanted = {"sphere": "radius", "flat": "Sz", "roughness": specimen.measure.parameter}
    name = wanted.get(specimen.kind)
    for quantity in found:
        own = quantity.subject == SUBJECT or specimen.kind in ("roughness", "flat")
        if own and name in (None, quantity.name) and quantity.value is not None:
            return quantity
    raise MeasurementError(f"{surface.folder}: does not show the {specimen.kind} that is to be measured")


def judge(specimen: SpecimenFile, quantities: Sequence[Quantity], failures: Sequence[str]) -> SpecimenResult:
    """Return the comparison of all scans of a specimen with its certificate.

    What scans share (the calibration) does not average out: the mean of the scans' own standard uncertainties stays,
    and their scatter, divided by the root of their number, comes beside it.
    """
    values = tuple(float(quantity.value) for quantity in quantities if quantity.value is not None)
    sigmas = [quantity.uncertainty / quantity.coverage_factor for quantity in quantities if quantity.uncertainty]
    certified_expanded_um = COVERAGE * specimen.standard_uncertainty_um
    words = tuple(failures)
    mean = expanded = error = e_n = None
    if values:
        mean = float(np.mean(values))
        error = mean - specimen.certified_um
        if len(sigmas) == len(values):
            scatter = float(np.std(values, ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else 0.0
            expanded = COVERAGE * float(np.hypot(np.mean(sigmas), scatter))
            e_n = error / float(np.hypot(expanded, certified_expanded_um))
        else:
            words += ("its E_n is not judged: the result states no uncertainty of this number",)
    if specimen.kind == "flat":
        e_n = None  # a maximum of noise has no error that could be judged: it is the flatness deviation itself
    return SpecimenResult(
        name=specimen.name,
        kind=specimen.kind,
        serial=specimen.serial,
        certificate=specimen.certificate,
        quantity=f"{quantities[0].name}" if quantities else "",
        certified_um=specimen.certified_um,
        certified_expanded_um=certified_expanded_um,
        values_um=values,
        mean_um=mean,
        expanded_um=expanded,
        error_um=error,
        e_n=e_n,
        agrees=None if e_n is None else abs(e_n) <= MAX_E_N,
        words=words,
    )


def _ends(specimen: SpecimenFile) -> tuple[Place, Place]:
    """Return both ends of the specimen's line."""
    how = specimen.measure
    assert how.from_um is not None  # noqa: S101 - checked where the file was read
    assert how.to_um is not None  # noqa: S101 - likewise
    return how.from_um, how.to_um


HARMONICS: Final = 3
SEARCHED: Final = 0.1
"""The period is looked for within this fraction of the certified one."""

MIN_PERIODS: Final = 3.0
MIN_EXPLAINED: Final = 0.5
"""The line must show so many periods, and their harmonics so much of its variance."""


def measured_period(specimen: SpecimenFile, surface: ResultSurface, scale: StatedScale) -> Quantity:
    """Return the period along the specimen's line, and its ± from every surface that the result's samples allow.

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
    """Return the period nearest to the expected one that explains a profile best, µm; `source` names it in errors.

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
    """Return the fraction of a profile's variance that a line and the harmonics of a period leave."""
    phase = 2.0 * np.pi * along / period_um
    waves = [wave(n * phase) for n in range(1, HARMONICS + 1) for wave in (np.sin, np.cos)]
    plain = np.stack([np.ones_like(along), along - along.mean()], axis=-1)
    straight = z_um - plain @ np.linalg.lstsq(plain, z_um, rcond=None)[0]
    design = np.hstack([plain, np.stack(waves, axis=-1)])
    left = z_um - design @ np.linalg.lstsq(design, z_um, rcond=None)[0]
    return float((left**2).sum() / max(float((straight**2).sum()), 1e-12))


# A certified specimen, as its `STEP.toml` describes it: what it is, its value with its ±, and scans of it.

Kind = Literal["step", "groove", "sphere", "roughness", "period", "flat"]
Axis = Literal["x", "y"]

NEEDED: dict[Kind, tuple[str, ...]] = {
    "step": ("from_um", "to_um"),
    "groove": ("from_um", "to_um"),
    "sphere": ("region_um",),
    "roughness": ("region_um", "l_filter_um"),
    "period": ("from_um", "to_um"),
    "flat": (),
}
"""Keys of `[measure]` that a kind cannot do without."""


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file: unknown keys are refused."""


class ScanTable(_Table, frozen=True, kw_only=True):
    """One scan of the specimen: a frame to reconstruct, or a folder that `retrosync reconstruct` wrote."""

    image: ImageNames | None = None
    result: str | None = None


class MeasureTable(_Table, frozen=True, kw_only=True):
    """Place and manner of its measurement; lengths and places as in a recipe, from the middle of the first pixel.

    from_um, to_um, width_um : line across a step or groove, or along a period
    edges_um : places of the edges along the line; found when not given
    region_um : face of a sphere, a rough surface, or the part of a flat
    parameter : areal roughness parameter
    """

    from_um: Place | None = None
    to_um: Place | None = None
    width_um: Annotated[float, msgspec.Meta(ge=0, le=1e6)] = 0.0
    edges_um: tuple[float, ...] | None = None
    region_um: Rectangle | None = None
    parameter: Literal["Sa", "Sq", "Sz"] = "Sa"
    s_filter_um: Length | None = None
    l_filter_um: Length | None = None
    pixel_pitch_share: Annotated[float, msgspec.Meta(gt=0, lt=1)] | None = None
    ball_radius_share: Annotated[float, msgspec.Meta(gt=0, lt=1)] | None = None


class SpecimenFile(_Table, frozen=True, kw_only=True):
    """The whole file.

    certified_um : height of a step, depth of a groove, radius of a sphere, the parameter's value, or the period; of a
        flat its own deviation from flatness
    expanded_uncertainty_um : coverage factor times standard uncertainty, as its certificate states it
    axis : of a period: x runs along columns
    certificate : number and date of the specimen's own certificate
    """

    name: Label
    kind: Kind
    certified_um: Annotated[float, msgspec.Meta(ge=0, le=1e7)]
    expanded_uncertainty_um: Annotated[float, msgspec.Meta(gt=0, le=1e7)]
    coverage_factor: Annotated[float, msgspec.Meta(ge=1, le=4)] = 2.0
    axis: Axis | None = None
    serial: str = ""
    certificate: str = ""
    scan: Annotated[tuple[ScanTable, ...], msgspec.Meta(min_length=1, max_length=50)]
    measure: MeasureTable = MeasureTable()

    @property
    def standard_uncertainty_um(self) -> float:
        """Of the certified value."""
        return self.expanded_uncertainty_um / self.coverage_factor


def read_specimen(path: Path) -> SpecimenFile:
    """Return the specimen of a file, each key checked.

    Raises
    ------
    MeasurementError
        Names the file, the key, and what is wrong with it.
    """
    try:
        specimen = decode_toml(path.read_bytes(), SpecimenFile)
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name a specimen's TOML file") from error
    except msgspec.DecodeError as error:
        # A ValidationError is a DecodeError too; its text names the key.
        raise MeasurementError(f"{path}: {error}: see docs/certificate.md") from error
    _check(specimen, path)
    return specimen


def _check(specimen: SpecimenFile, path: Path) -> None:
    """Refuse a file whose keys do not belong together."""
    missing = [key for key in NEEDED[specimen.kind] if getattr(specimen.measure, key) is None]
    if missing:
        raise MeasurementError(f"{path}: measure.{missing[0]}: a {specimen.kind} cannot be measured without it")
    if specimen.kind != "flat" and specimen.certified_um == 0.0:
        raise MeasurementError(f"{path}: certified_um: a {specimen.kind} of 0 µm certifies nothing")
    if (specimen.kind == "period") != (specimen.axis is not None):
        raise MeasurementError(f"{path}: axis: a period needs one, x or y, and no other kind has one")
    for number, scan in enumerate(specimen.scan):
        if (scan.image is None) == (scan.result is None):
            raise MeasurementError(f"{path}: scan[{number}]: name either an image or a result, and not both")
