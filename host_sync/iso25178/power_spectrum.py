"""The power spectral density of a surface, averaged over directions.

One-sided in the radial frequency, µm³: its integral over spatial frequency (1/µm) is the mean square height, Sq², of
the windowed surface. A Hann window over the valid pixels suppresses leakage; invalid pixels have no weight, and the
window's loss of power is compensated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.fft

from device.surface import Float32Array, Float64Array, MaskArray

BINS_PER_OCTAVE: Final = 6
EVEN_BANDS: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class PowerSpectrum:
    """Densities by spatial frequency.

    per_um, width_per_um : float64 arrays of shape (N,), centre and width of the bands, 1/µm
    density_um3 : float64 array of shape (N,), µm³
    """

    per_um: Float64Array
    width_per_um: Float64Array
    density_um3: Float64Array


class RadialSpectrum:
    """The spectrum on one mask; window and frequency bands are computed once.

    Parameters
    ----------
    valid : bool array of shape (H, W)
    pitch_um : pixel pitch, µm
    """

    def __init__(self, valid: MaskArray, pitch_um: float) -> None:
        down, across = (np.hanning(side + 2)[1:-1].astype(np.float32) for side in valid.shape)
        self._window = np.where(valid, down[:, None] * across, np.float32(0.0))
        self._size = [scipy.fft.next_fast_len(side, real=True) for side in valid.shape]
        self._pitch_um = pitch_um
        row = scipy.fft.fftfreq(self._size[0], pitch_um)
        column = scipy.fft.rfftfreq(self._size[1], pitch_um)
        frequency = np.hypot(row[:, None], column).astype(np.float32)
        self._edges = _band_edges(1.0 / (min(valid.shape) * pitch_um), 0.5 / pitch_um)
        self._band = np.digitize(frequency, self._edges).astype(np.int32)
        self._seen = np.bincount(self._band.ravel(), minlength=len(self._edges) + 1)[1:-1] > 0
        self.per_um: Float64Array = np.sqrt(self._edges[:-1] * self._edges[1:])[self._seen]
        self.width_per_um: Float64Array = np.diff(self._edges)[self._seen]
        # The half spectrum represents both signs of the column frequency.
        self._twice = np.full(column.size, 2.0, np.float32)
        self._twice[0] = 1.0
        if self._size[1] % 2 == 0:
            self._twice[-1] = 1.0

    def of(self, z_um: Float32Array) -> PowerSpectrum:
        """Return the spectrum of a surface that is finite where valid; bands without a frequency are dropped."""
        weight = float((self._window.astype(np.float64) ** 2).sum())
        mean = np.float32(np.sum(np.where(self._window > 0, z_um, 0.0) * self._window, dtype=np.float64))
        mean /= np.float32(self._window.sum(dtype=np.float64))
        values = np.where(self._window > 0, z_um - mean, np.float32(0.0)) * self._window
        spectrum = scipy.fft.rfft2(values, self._size)
        power = (spectrum.real**2 + spectrum.imag**2) * self._twice
        total = np.bincount(self._band.ravel(), power.ravel(), len(self._edges) + 1)[1:-1]
        density = total / (weight * self._size[0] * self._size[1]) / np.diff(self._edges)
        return PowerSpectrum(self.per_um, self.width_per_um, density[self._seen])


def _band_edges(step: float, most: float) -> Float64Array:
    """Return the band edges: steps of the lowest frequency first, then sixths of an octave from the eighth band on."""
    even = step * (np.arange(EVEN_BANDS + 1) + 0.5)
    count = max(int(np.ceil(BINS_PER_OCTAVE * np.log2(most / even[-1]))), 1) if most > even[-1] else 0
    return np.concatenate([even[even < most], np.geomspace(even[-1], most, count + 1)[1:] if count else [most]])
