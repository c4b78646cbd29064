"""Lookup table: colour to slope candidates with their first-order reflectance (paper, section 5.1).

A bin of the quantized colour cube points to the slopes that produce its colour. Balls are surfaces, so their colours
form a sheet in the cube; "bins that are empty after calibration are filled with the index of the bin containing the
closest observed colour". A candidate is 12 float32 (48 bytes), so one cache line serves one pixel.

Untouched skin has bins of its own: pressed skin is brighter or darker than untouched skin, so the balls' colour at
slope 0 is not 1, while intensity 1 is slope 0 by definition. Without these bins all untouched skin would be tilted, and
the height map bent.
"""

from __future__ import annotations

from itertools import product
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array, Float64Array
from host_sync.johnson2009.spherical_harmonics import ReflectanceSurface
from host_sync.kernels.jit import njit

# Mean shift over the slopes that fall into one bin: each cluster is one slope that produces the bin's colour.
#
# Paper, section 5.1: the bandwidth is proportional to the mean norm of the bin's slopes, which groups normals that are
# close in angle. It has a lower bound, because it vanishes at the flat. Modes connected by a chain of half bandwidths
# are one cluster, so that a long sheet of slopes of equal colour stays whole.

MAX_CLUSTERS: Final = 4

BANDWIDTH_FACTOR: Final = 0.3
"""Bandwidth relative to the mean norm of the slopes in a bin."""

BANDWIDTH_FLOOR: Final = 0.12
"""Smallest bandwidth, slope: 7 degrees at the flat."""

_MAX_MEMBERS: Final = 150
"""Crowded bins are thinned to about this many slopes; they are crowded where colour hardly changes with slope."""

_MAX_SHIFTS: Final = 20


def cluster_bins(slopes: Float64Array, first: NDArray[np.int64]) -> tuple[Float64Array, NDArray[np.int64]]:
    """Cluster centres of every bin, largest cluster first, and their number.

    slopes : float64 array of shape (N, 2), sorted by bin
    first : int array of shape (bins + 1,), where each bin's slopes begin

    Returns arrays of shape (bins, MAX_CLUSTERS, 2) and (bins,).
    """
    bins = len(first) - 1
    label = _labels(slopes, first.astype(np.int64), _MAX_MEMBERS)
    number = np.repeat(np.arange(bins), np.diff(first)) * _MAX_MEMBERS + label
    number = number[label >= 0]
    cluster, inverse, size = np.unique(number, return_inverse=True, return_counts=True)
    sums = [np.bincount(inverse, slopes[label >= 0, axis]) for axis in range(2)]
    means = np.stack(sums, axis=-1) / size[:, None]
    owner = cluster // _MAX_MEMBERS
    order = np.lexsort((-size, owner))
    rank = np.arange(len(order)) - np.searchsorted(owner, owner)
    kept = rank < MAX_CLUSTERS
    centres = np.zeros((bins, MAX_CLUSTERS, 2))
    centres[owner[kept], rank[kept]] = means[order[kept]]
    return centres, np.bincount(owner[kept], minlength=bins)


@njit(cache=True)
def _labels(slopes: Float64Array, first: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Cluster number of every slope within its bin, below `most`; -1 for slopes dropped from a crowded bin."""
    labels = np.full(len(slopes), -1, np.int64)
    for index in range(len(first) - 1):
        stride = 1 + (first[index + 1] - first[index] - 1) // most
        members = slopes[first[index] : first[index + 1] : stride]
        norm = 0.0
        for i in range(len(members)):
            norm += np.sqrt(members[i, 0] ** 2 + members[i, 1] ** 2)
        bandwidth = max(BANDWIDTH_FACTOR * norm / len(members), BANDWIDTH_FLOOR)
        found = _linked(_modes(members, bandwidth), 0.5 * bandwidth)
        for i in range(len(members)):
            labels[first[index] + i * stride] = found[i]
    return labels


@njit(cache=True)
def _modes(members: Float64Array, bandwidth: float) -> Float64Array:
    """Return the limit of each slope when moved repeatedly to the mean of its neighbours within the bandwidth."""
    modes = members.copy()
    reach, rest = bandwidth**2, (1e-2 * bandwidth) ** 2
    for i in range(len(members)):
        for _ in range(_MAX_SHIFTS):
            p, q, near = 0.0, 0.0, 0
            for j in range(len(members)):
                if (members[j, 0] - modes[i, 0]) ** 2 + (members[j, 1] - modes[i, 1]) ** 2 <= reach:
                    p, q, near = p + members[j, 0], q + members[j, 1], near + 1
            moved = (p / near - modes[i, 0]) ** 2 + (q / near - modes[i, 1]) ** 2
            modes[i, 0], modes[i, 1] = p / near, q / near
            if moved < rest:
                break
    return modes


@njit(cache=True)
def _linked(modes: Float64Array, link: float) -> NDArray[np.int64]:
    """Return the label of each mode; modes connected by a chain of distances below `link` share one."""
    label = np.full(len(modes), -1, np.int64)
    queue = np.empty(len(modes), np.int64)
    found = 0
    for seed in range(len(modes)):
        if label[seed] >= 0:
            continue
        label[seed], queue[0] = found, seed
        head, tail = 0, 1
        while head < tail:
            i = queue[head]
            head += 1
            for j in range(len(modes)):
                near = (modes[j, 0] - modes[i, 0]) ** 2 + (modes[j, 1] - modes[i, 1]) ** 2 < link**2
                if label[j] < 0 and near:
                    label[j], queue[tail] = found, j
                    tail += 1
        found += 1
    return label


BINS: Final = 64

CANDIDATE_FIELDS: Final = 12
"""p, q, R (3), J by rows (∂R1/∂p, ∂R1/∂q, ∂R2/∂p, …: 6); the twelfth is unused."""

COLOUR_PERCENTILES: Final = (0.1, 99.9)
COLOUR_MARGIN: Final = 0.1
"""The cube extends beyond the observed range by this fraction of it on either side."""

SLOPE_NODES: Final = 256
"""Slopes along each axis that are entered into the table; dense enough to leave no gap between bins."""

OVERLAP: Final = 0.5
"""A slope is entered into every bin within this fraction of a bin of its colour, so that noise hides no ambiguity."""


class LookupTable(NamedTuple):
    """Slope candidates by quantized colour; a named tuple, so that kernels take it whole.

    low : float32 array of shape (3,), intensity at the lower corner of the cube
    step : float32 array of shape (3,), intensity range of a bin
    bin_of : int32 array of shape (BINS, BINS, BINS), the filled bin for a colour (R, G, B)
    first : int32 array of shape (filled + 1,), where each filled bin's candidates begin
    candidates : float32 array of shape (M, CANDIDATE_FIELDS)
    """

    low: Float32Array
    step: Float32Array
    bin_of: NDArray[np.int32]
    first: NDArray[np.int32]
    candidates: Float32Array

    @property
    def filled_bins(self) -> int:
        """Number of bins whose colour some slope produces."""
        return len(self.first) - 1

    @property
    def ambiguous_fraction(self) -> float:
        """Fraction of the filled bins with more than one candidate."""
        return float((np.diff(self.first) > 1).mean())

    def bin_indices(self, intensity: Float32Array) -> NDArray[np.intp]:
        """Bin indices (i, j, k) of shape (N, 3) of intensities of shape (N, 3), clipped to the cube."""
        return quantise(intensity, self.low, self.step, len(self.bin_of))

    def candidates_of(self, intensity: Float32Array) -> Float32Array:
        """Return candidates of one intensity (3,): float32 array of shape (K, CANDIDATE_FIELDS)."""
        i, j, k = self.bin_indices(intensity[None])[0]
        filled = self.bin_of[i, j, k]
        return self.candidates[self.first[filled] : self.first[filled + 1]]


def quantise(intensity: NDArray[np.floating], low: Float32Array, step: Float32Array, bins: int) -> NDArray[np.intp]:
    """Bin indices of shape (N, 3), clipped to the cube."""
    return np.asarray(np.clip(np.floor((intensity - low) / step), 0, bins - 1), np.intp)


def colour_cube(intensity: Float32Array, noise: float, bins: int = BINS) -> tuple[Float32Array, Float32Array]:
    """Return the lower corner and bin size, each of shape (3,), of the cube that holds the observed intensities (N, 3).

    noise : standard deviation of a pixel's intensity; no bin is narrower
    """
    low, high = np.percentile(intensity, COLOUR_PERCENTILES, axis=0)
    width = np.maximum((1.0 + 2.0 * COLOUR_MARGIN) * (high - low), bins * noise)
    return (0.5 * (low + high - width)).astype(np.float32), (width / bins).astype(np.float32)


def build_table(
    surface: ReflectanceSurface, low: Float32Array, step: Float32Array, untouched: float, bins: int = BINS
) -> LookupTable:
    """Return the table of a reflectance surface over the colour cube with corner `low` and bin size `step`.

    untouched : distance from intensity 1 within which a colour is untouched skin, slope 0
    """
    slopes, number = _entries(surface, low, step, bins)
    rest = _bin_number(_untouched_bins(low, step, untouched, bins), bins)
    kept = ~np.isin(number, rest)
    slopes, number = slopes[kept], number[kept]
    order = np.argsort(number, kind="stable")
    filled, start = np.unique(number[order], return_index=True)
    centres, count = cluster_bins(slopes[order], np.append(start, len(number)))
    chosen = centres[np.arange(centres.shape[1]) < count[:, None]]
    count = np.append(count, np.ones(len(rest), np.intp))
    candidates = np.concatenate([_packed(surface, chosen), np.repeat(_flat(surface), len(rest), axis=0)])
    bin_of = nearest_filled(np.append(filled, rest), step, bins)
    return LookupTable(low, step, bin_of, np.append(0, np.cumsum(count)).astype(np.int32), candidates)


def slopes_of_bin(surface: ReflectanceSurface, table: LookupTable, filled: int) -> Float64Array:
    """Return slopes that were entered into one filled bin of a surface's table, float64 array of shape (N, 2)."""
    bins = len(table.bin_of)
    slopes, number = _entries(surface, table.low, table.step, bins)
    # These include empty bins that point to the filled one; no slope was entered into them.
    pointing = np.flatnonzero(table.bin_of.ravel() == filled)
    return slopes[np.isin(number, pointing)]


def _entries(
    surface: ReflectanceSurface, low: Float32Array, step: Float32Array, bins: int
) -> tuple[Float64Array, NDArray[np.intp]]:
    """Dense slopes of shape (N, 2), one row per bin that they are entered into, and the numbers of those bins."""
    slopes, colours = _dense_slopes(surface)
    corners = OVERLAP * step * np.array(list(product((-1.0, 1.0), repeat=3)))
    numbers = np.stack([_bin_number(quantise(colours + corner, low, step, bins), bins) for corner in corners], axis=-1)
    numbers.sort(axis=-1)
    fresh = np.diff(numbers, axis=-1, prepend=-1) > 0
    return np.repeat(slopes, fresh.sum(axis=-1), axis=0), numbers[fresh]


def _bin_number(index: NDArray[np.intp], bins: int) -> NDArray[np.intp]:
    return np.asarray((index[:, 0] * bins + index[:, 1]) * bins + index[:, 2])


def _untouched_bins(low: Float32Array, step: Float32Array, radius: float, bins: int) -> NDArray[np.intp]:
    """Return bins of shape (N, 3) whose centres lie within `radius` of intensity 1, at least the one that holds it."""
    axes = [np.arange(bins, dtype=np.intp)] * 3
    index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = np.linalg.norm(low + (index + 0.5) * step - 1.0, axis=1)
    home = quantise(np.ones((1, 3)), low, step, bins)
    return np.asarray(np.unique(np.concatenate([index[distance <= radius], home]), axis=0))


def _flat(surface: ReflectanceSurface) -> Float32Array:
    """Return the candidate of untouched skin, shape (1, CANDIDATE_FIELDS): slope 0 at intensity 1."""
    flat = _packed(surface, np.zeros((1, 2)))
    flat[0, 2:5] = 1.0
    return flat


def _dense_slopes(surface: ReflectanceSurface) -> tuple[Float64Array, Float64Array]:
    """Return slopes of shape (N, 2) on a dense grid within reach, and their reflectance of shape (N, 3)."""
    axis = np.linspace(-surface.reach, surface.reach, SLOPE_NODES)
    p, q = np.meshgrid(axis, axis)
    inside = p * p + q * q <= surface.reach**2
    return np.stack([p[inside], q[inside]], axis=-1), surface.on_grid(axis)[inside]


def _packed(surface: ReflectanceSurface, slopes: Float64Array) -> Float32Array:
    """Return candidates of shape (M, CANDIDATE_FIELDS) at slopes of shape (M, 2)."""
    value, jacobian = surface.with_jacobian(slopes[:, 0], slopes[:, 1])
    packed = np.zeros((len(slopes), CANDIDATE_FIELDS), np.float32)
    packed[:, :2], packed[:, 2:5] = slopes, value
    packed[:, 5:11] = jacobian.reshape(-1, 6)
    return packed


def nearest_filled(filled: NDArray[np.intp], step: Float32Array, bins: int) -> NDArray[np.int32]:
    """Return the index of the filled bin with the closest colour for every bin, of shape (bins,) * 3.

    filled : int array of shape (N,), numbers of the filled bins
    step : float32 array of shape (3,), intensity range of a bin
    """
    from scipy.ndimage import distance_transform_edt  # here, because only calibrating needs it

    index = np.full(bins**3, -1, np.int32)
    index[filled] = np.arange(len(filled), dtype=np.int32)
    cube = index.reshape(bins, bins, bins)
    nearest = distance_transform_edt(
        cube < 0, sampling=step.astype(np.float64), return_distances=False, return_indices=True
    )
    return np.ascontiguousarray(cube[tuple(nearest)])
