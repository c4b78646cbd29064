"""Pictures for the page: thumbnails, the frame, and the uncertainty map."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.bundles.scan import read_scan
from device.errors import DeviceError
from device.imaging.flat_field import demosaic
from device.surface import Float32Array
from host_sync.errors import HostError, ViewError
from host_sync.frames.frame_set import ScanSpec
from host_sync.frames.linear_light import read_frame
from host_sync.render.shading import HIGHLIGHT, tint_table
from host_sync.viewer.entry import Entry

THUMBNAIL_PX: Final = 384
FRAME_PX: Final = 4096
SIGMA_PX: Final = 768
_LIGHT: Final = (-0.5417, -0.5417, 0.6428)
_AMBIENT: Final = 0.15
_WHITE_SHARE: Final = 99.7


def thumbnail(z_um: Float32Array, pitch_um: float) -> bytes:
    """Return a small relief as WebP, shaded from the upper left, transparent where invalid."""
    factor = max(1, int(np.ceil(max(z_um.shape) / THUMBNAIL_PX)))
    size = (max(2, z_um.shape[1] // factor), max(2, z_um.shape[0] // factor))
    small = cv2.resize(z_um, size, interpolation=cv2.INTER_AREA)
    q, p = np.gradient(small / np.float32(pitch_um * factor))
    steep = np.nan_to_num(np.hypot(p, q))
    p, q = (slope * max(1.0, 0.35 / max(float(np.percentile(steep, 97.0)), 0.35 / 20.0)) for slope in (p, q))
    light = (_LIGHT[2] - p * _LIGHT[0] - q * _LIGHT[1]) / np.sqrt(1.0 + p * p + q * q)
    brightness = _AMBIENT + (1.0 - _AMBIENT) * np.clip(light, 0.0, None)
    known = np.isfinite(brightness) & np.isfinite(small)  # a central difference ignores its own pixel
    low, high = np.percentile(small[known], [0.1, 99.9]) if known.any() else (0.0, 1.0)
    share = np.clip((np.nan_to_num(small, nan=low) - low) / max(high - low, 1e-3), 0.0, 1.0)
    colour = tint_table()[np.round(share * 255.0).astype(int)]
    flat = _AMBIENT + (1.0 - _AMBIENT) * _LIGHT[2]
    brightness = np.nan_to_num(brightness, nan=flat)[..., None]
    shaded = colour * np.minimum(brightness / flat, 1.0)
    shaded += (255.0 - shaded) * HIGHLIGHT * np.clip(brightness - flat, 0.0, None) / (1.0 - flat)
    picture = np.dstack([shaded[..., ::-1], np.where(known, 255.0, 0.0)])
    return _encoded(".webp", np.round(picture).astype(np.uint8), cv2.IMWRITE_WEBP_QUALITY, 88)


def frame_picture(entry: Entry, spec: ScanSpec | None) -> bytes:
    """Return the frame that a height map was made from, as JPEG.

    spec : the scan of the named frame set, for results outside a library

    Raises
    ------
    ViewError
        There is no frame, or it is damaged.
    """
    try:
        if entry.scan is not None:
            rgb = demosaic(read_scan(entry.scan).raw_frame()).rgb
        elif spec is not None:
            rgb = read_frame(spec.frame).rgb
        else:
            raise ViewError(f"{entry.title}: its frame is not known: name its frame set with --frames FRAMESET.toml")
    except (DeviceError, HostError) as error:
        raise ViewError(str(error)) from error
    factor = max(1, int(np.ceil(max(rgb.shape[:2]) / FRAME_PX)))
    if factor > 1:
        size = (rgb.shape[1] // factor, rgb.shape[0] // factor)
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float32)
    return _encoded(".jpg", _display_rgb(rgb)[..., ::-1], cv2.IMWRITE_JPEG_QUALITY, 92)


def grey_frames(first: Entry, second: Entry) -> tuple[Float32Array, Float32Array] | None:
    """Grey frames of two scans of one gel at the pixels of their height maps; None where they are not both known."""
    if first.scan is None or second.scan is None or first.shape != second.shape:
        return None
    try:
        scans = [read_scan(scan) for scan in (first.scan, second.scan)]
        if scans[0].record.gel_id != scans[1].record.gel_id:
            return None
        greys = [demosaic(scan.raw_frame()).rgb.mean(axis=-1) for scan in scans]
    except (DeviceError, HostError):
        return None  # the texture is one of several starts: a damaged frame costs no more than that
    size = first.shape[::-1]
    one, other = (np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float32) for grey in greys)
    return one, other


def _display_rgb(rgb: Float32Array) -> NDArray[np.uint8]:
    """sRGB of linear light, scaled to the full range."""
    white = max(float(np.percentile(rgb[::7, ::7], _WHITE_SHARE)), 1e-6)
    steps = np.clip(rgb / white, 0.0, 1.0) * np.float32(4095.0)
    linear = np.arange(4096) / 4095.0
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    shown: NDArray[np.uint8] = np.round(255.0 * curve).astype(np.uint8)[steps.astype(np.uint16)]
    return shown


def sigma_picture(sigma_um: Float32Array) -> Float32Array:
    """Return the reduced uncertainty map: float32 array of shape (h, w), µm; NaN where unknown."""
    factor = max(1, int(np.ceil(max(sigma_um.shape) / SIGMA_PX)))
    size = (max(1, sigma_um.shape[1] // factor), max(1, sigma_um.shape[0] // factor))
    known = np.isfinite(sigma_um).astype(np.float32)
    share = cv2.resize(known, size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(known > 0, sigma_um, np.float32(0.0)), size, interpolation=cv2.INTER_AREA)
    return np.where(share > 0, total / np.maximum(share, np.float32(1e-6)), np.float32(np.nan)).astype(np.float32)


def _encoded(form: str, picture: NDArray[np.uint8], setting: int, quality: int) -> bytes:
    _, data = cv2.imencode(form, picture, [setting, quality])
    return data.tobytes()
