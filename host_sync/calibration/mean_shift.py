"""Mean shift over the slopes that fall into one bin: each cluster is one slope that makes the bin's colour.

Paper, section 5.1: the bandwidth is proportional to the mean norm of the bin's slopes, which groups normals that are
close in angle; it has a floor, for it vanishes at the flat. Modes that a chain of half bandwidths connects are one
cluster, so that a long sheet of slopes of equal colour is not cut to pieces.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from device.surface import Float64Array

MOST_CLUSTERS: Final = 4

BANDWIDTH_SHARE: Final = 0.3
"""Bandwidth over the mean norm of the slopes in a bin."""

BANDWIDTH_FLOOR: Final = 0.12
"""Least bandwidth, slope: 7 degrees at the flat."""

_MOST_MEMBERS: Final = 150
"""Slopes of a crowded bin are thinned to about this many: their number grows where colour hardly changes."""

_MOST_SHIFTS: Final = 20


def cluster_bins(slopes: Float64Array, first: NDArray[np.int64]) -> tuple[Float64Array, NDArray[np.int64]]:
    """Cluster centres of every bin, largest cluster first, and how many there are.

    slopes : float64 array of shape (N, 2), sorted by bin
    first : int array of shape (bins + 1,), where each bin's slopes begin

    Returns arrays of shape (bins, MOST_CLUSTERS, 2) and (bins,).
    """
    bins = len(first) - 1
    label = _labels(slopes, first.astype(np.int64), _MOST_MEMBERS)
    number = np.repeat(np.arange(bins), np.diff(first)) * _MOST_MEMBERS + label
    number = number[label >= 0]
    cluster, inverse, size = np.unique(number, return_inverse=True, return_counts=True)
    sums = [np.bincount(inverse, slopes[label >= 0, axis]) for axis in range(2)]
    means = np.stack(sums, axis=-1) / size[:, None]
    owner = cluster // _MOST_MEMBERS
    order = np.lexsort((-size, owner))
    rank = np.arange(len(order)) - np.searchsorted(owner, owner)
    kept = rank < MOST_CLUSTERS
    centres = np.zeros((bins, MOST_CLUSTERS, 2))
    centres[owner[kept], rank[kept]] = means[order[kept]]
    return centres, np.bincount(owner[kept], minlength=bins)


@njit(cache=True)
def _labels(slopes: Float64Array, first: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Cluster number of every slope within its bin, below `most`; -1 where a crowded bin was thinned."""
    labels = np.full(len(slopes), -1, np.int64)
    for index in range(len(first) - 1):
        stride = 1 + (first[index + 1] - first[index] - 1) // most
        members = slopes[first[index] : first[index + 1] : stride]
        norm = 0.0
        for i in range(len(members)):
            norm += np.sqrt(members[i, 0] ** 2 + members[i, 1] ** 2)
        bandwidth = max(BANDWIDTH_SHARE * norm / len(members), BANDWIDTH_FLOOR)
        found = _linked(_modes(members, bandwidth), 0.5 * bandwidth)
        for i in range(len(members)):
            labels[first[index] + i * stride] = found[i]
    return labels


@njit(cache=True)
def _modes(members: Float64Array, bandwidth: float) -> Float64Array:
    """Where each slope ends when it keeps moving to the mean of its neighbours within the bandwidth."""
    modes = members.copy()
    reach, rest = bandwidth**2, (1e-2 * bandwidth) ** 2
    for i in range(len(members)):
        for _ in range(_MOST_SHIFTS):
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
    """Label of each mode; modes closer than `link` share one, and so do those that a chain of such pairs connects."""
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
