"""Mean shift over the slopes that fall into one bin: each cluster is one slope that produces the bin's colour.

Paper, section 5.1: the bandwidth is proportional to the mean norm of the bin's slopes, which groups normals that are
close in angle. It has a lower bound, because it vanishes at the flat. Modes connected by a chain of half bandwidths are
one cluster, so that a long sheet of slopes of equal colour stays whole.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float64Array
from host_sync.kernels.jit import njit

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
    """Limit of each slope when moved repeatedly to the mean of its neighbours within the bandwidth."""
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
    """Label of each mode; modes connected by a chain of distances below `link` share one."""
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
