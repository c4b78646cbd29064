"""The colour of a height: from deep blue over green to sand, ever brighter, so that it still reads without colour."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array

_ANCHORS: Final = np.array(
    [(26, 34, 74), (36, 82, 120), (48, 132, 134), (112, 174, 124), (206, 198, 128), (252, 238, 208)], np.float32
)


def height_colours(share: Float32Array, shade: Float32Array) -> NDArray[np.int32]:
    """Colours as 0xRRGGBB.

    Parameters
    ----------
    share : float32 array, height from 0 (lowest) to 1 (highest); NaN counts as 0
    shade : float32 array of the same shape, brightness by which the colour is multiplied, 1 leaves it
    """
    place = np.clip(np.nan_to_num(share), 0.0, 1.0) * (len(_ANCHORS) - 1)
    below = np.minimum(place.astype(np.int32), len(_ANCHORS) - 2)
    within = (place - below)[..., np.newaxis]
    colour = (_ANCHORS[below] * (1.0 - within) + _ANCHORS[below + 1] * within) * shade[..., np.newaxis]
    red, green, blue = np.moveaxis(np.clip(colour + 0.5, 0.0, 255.0).astype(np.int32), -1, 0)
    return np.asarray((red << 16) | (green << 8) | blue, np.int32)
