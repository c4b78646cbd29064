"""A certified specimen, as its `STEP.toml` describes it: what it is, its value with its ±, and scans of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec

from hal.decoding import decode_toml
from host_sync.errors import MeasurementError
from host_sync.frames.frame_set_file import ImageNames
from host_sync.measurement.recipe import Label, Length, Place, Rectangle

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
    """The specimen of a file, each key checked.

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
