"""Content of a report, independent of its layout: facts, pictures, tables, notes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import cv2
import msgspec
import numpy as np

from hal.validation import decode_toml, split_validation
from host_sync.errors import MeasurementError

VERDICT_HEAD: Final = "tolerance"
"""Head of the column whose cells begin with a verdict."""

VERDICTS: Final = ("pass", "fail", "undecided")


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture: caption, PNG bytes, and size in pixels (columns, rows); a sheet of many pictures takes a page."""

    caption: str
    png: bytes
    size: tuple[int, int]
    is_sheet: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts under a header; `remarks` concern all rows."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...] = ()


SIGNED: Final = "SHA-256 of the report's words and numbers and its files' hashes, without pictures and logo"


@dataclass(frozen=True, slots=True)
class Report:
    """One result's report.

    title : its name
    head : lines above it, such as the organisation
    logo : beside the head
    verdict : pass, fail or undecided over all tolerances; empty without
    signature : SHA-256 of every word and number that the report prints and of the files' hashes, without pictures
    footer : at the foot of every page
    appendix : tables behind the numbers, such as the calibration
    operations : operations on the surface before the measurement
    facts : label and value, in order
    warnings : shown first
    """

    title: str
    operations: str
    facts: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    pictures: tuple[Picture, ...]
    tables: tuple[Table, ...]
    notes: tuple[str, ...]
    appendix: tuple[Table, ...] = ()
    head: tuple[str, ...] = ()
    logo: Picture | None = None
    verdict: str = ""
    signature: str = ""
    footer: str = ""


# A report's template: whose report it is, by whom, with what, and which parts it has; a TOML file.

Part = Literal["pictures", "numbers", "notes", "calibration", "provenance"]
Words = Annotated[str, msgspec.Meta(max_length=400)]

PARTS: Final[tuple[Part, ...]] = ("pictures", "numbers", "notes", "calibration", "provenance")
MAX_LOGO_BYTES: Final = 4_000_000
LOGO_PX: Final = (420, 140)
"""Largest columns and rows of a logo in a report."""


class Template(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file.

    organisation, address : at the head of the report
    logo : picture (PNG, JPEG, WebP), relative to the template
    operator : who measured; else the scan's annotation
    instrument : what measured; else the scan's device
    procedure : which procedure or order this follows
    footer : at the foot of every page
    parts : which parts the report has, numbers at least
    """

    organisation: Words = ""
    address: Words = ""
    logo: Words = ""
    operator: Words = ""
    instrument: Words = ""
    procedure: Words = ""
    footer: Words = ""
    parts: tuple[Part, ...] = PARTS


def read_template(path: Path) -> tuple[Template, Picture | None]:
    """Return the template in a file, and its logo.

    Raises
    ------
    MeasurementError
        Names the file, the key, and what is accepted.
    """
    try:
        template = decode_toml(path.read_bytes(), Template)
    except OSError as error:
        raise MeasurementError(
            f"{path}: cannot be read ({error.strerror}): name a report's template in TOML"
        ) from error
    except msgspec.ValidationError as error:
        key, problem = split_validation(error)
        known = ", ".join(Template.__struct_fields__)
        raise MeasurementError(
            f"{path}: {key}: {problem}; accepted keys are {known}; parts: {', '.join(PARTS)}"
        ) from error
    except msgspec.DecodeError as error:
        raise MeasurementError(f"{path}: {error}") from error
    if "numbers" not in template.parts:
        raise MeasurementError(f"{path}: parts: a report has numbers: add them")
    return template, _logo(path.parent / template.logo) if template.logo else None


def _logo(path: Path) -> Picture:
    """Return a logo, reduced to its place."""
    try:
        data = path.read_bytes() if path.stat().st_size <= MAX_LOGO_BYTES else b""
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror}): name the logo's file") from error
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if pixels is None:
        raise MeasurementError(f"{path}: is no picture of at most {MAX_LOGO_BYTES >> 20} MB: name a PNG, JPEG or WebP")
    scale = min(LOGO_PX[0] / pixels.shape[1], LOGO_PX[1] / pixels.shape[0], 1.0)
    size = (max(1, round(pixels.shape[1] * scale)), max(1, round(pixels.shape[0] * scale)))
    _, png = cv2.imencode(".png", cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    return Picture("Logo", png.tobytes(), size)
