"""What an empty bin of the lookup table reads (paper, section 5.1).

Balls are surfaces, so their colours are a sheet in the cube of all colours; "bins that are empty after calibration are
filled with the index of the bin containing the closest observed colour".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from device.surface import Float32Array


def nearest_filled(filled: NDArray[np.intp], step: Float32Array, bins: int) -> NDArray[np.int32]:
    """For every bin the index of the filled bin with the closest colour, itself when filled: shape (bins,) * 3.

    filled : int array of shape (N,), numbers of the filled bins
    step : float32 array of shape (3,), intensity that a bin spans
    """
    index = np.full(bins**3, -1, np.int32)
    index[filled] = np.arange(len(filled), dtype=np.int32)
    cube = index.reshape(bins, bins, bins)
    nearest = distance_transform_edt(
        cube < 0, sampling=step.astype(np.float64), return_distances=False, return_indices=True
    )
    return np.ascontiguousarray(cube[tuple(nearest)])
