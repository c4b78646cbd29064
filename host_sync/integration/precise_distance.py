"""Distances to the nearest pixel of a mask, with the same bits wherever they are computed.

With one thread, and on small fields, OpenCV leaves precise distances to Intel's library. Its rounding differs from that
of OpenCV's own code, and from call to call with where the array lies in memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from device.surface.fields import Float32Array, MaskArray


def distance_px(to: MaskArray) -> Float32Array:
    """Distance of each pixel's middle from that of the nearest True one, pixels: float32 array of shape (H, W).

    to : bool array of shape (H, W), True somewhere
    """
    with _own_code():
        found = cv2.distanceTransform((~to).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(found, np.float32)


@contextmanager
def _own_code() -> Iterator[None]:
    """Context in which this thread's calls of OpenCV use no code of Intel's library."""
    before = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(False)
    try:
        yield
    finally:
        cv2.ipp.setUseIPP(before)
