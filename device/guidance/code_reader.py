"""The QR code or barcode in a frame: a part's label held before the camera while no gel is mounted."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import bin_bayer
from hal.frame import RawFrame

BINNING: Final = 2


def read_code(frame: RawFrame) -> str | None:
    """Return the text of the frame's code, also a mirrored one; None where none can be read."""
    grey = bin_bayer(frame, BINNING).rgb.mean(axis=-1)
    low, high = np.percentile(grey, (1.0, 99.0))
    spread = max(float(high - low), 1e-6)
    shown = (255.0 * np.clip((grey - low) / spread, 0.0, 1.0)).astype(np.uint8)
    for picture in (shown, np.ascontiguousarray(shown[:, ::-1])):
        text = cv2.QRCodeDetector().detectAndDecode(picture)[0]
        text = text or cv2.barcode.BarcodeDetector().detectAndDecode(picture)[0]
        if text and text.isprintable():
            return str(text)
    return None
