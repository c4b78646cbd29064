"""A report's template: whose report it is, by whom, with what, and which parts it has; a TOML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import cv2
import msgspec
import numpy as np

from hal.decoding import decode_toml
from hal.validation import split_validation
from host_sync.errors import MeasurementError
from host_sync.report.content import Picture

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
    """The template in a file, and its logo.

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
    """A logo, reduced to its place."""
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
