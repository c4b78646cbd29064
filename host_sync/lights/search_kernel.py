"""The search for slopes under lamps, place by place: the kernel of `move_past_hidden`.

The rays from a place to the lamps do not change with its slope: they are followed once for all steps.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from host_sync.kernels.jit import njit
from host_sync.lights.lamp_kernel import GRAZING, ray_to, reflected, to_camera
from host_sync.lights.step_kernel import shown_by, solved


@njit(cache=True, nogil=True, error_model="numpy")
def write_search(
    lamps: Any, skin: Any, seen: Any, before: Any, trust: Any, scale: Any, steps: int, slope: Any, weight: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """Move the rows `first` to `last` - 1 of `slope`, shape (N, 2), by Gauss-Newton steps towards what is seen.

    lamps : points, axes and coat as of `write_light`; mixing, haze and bounce as of `write_shown`
    skin : places x, y and z in widths of the field, shape (N,); intensity at rest, shares of lamps and skin close by,
        shape (N, 3), (N, 3, 3) and (N, 3); what arrives of the lamps' points, as of `write_light`
    seen : intensity, shape (N, 3)
    before : slopes that are known beforehand, shape (N, 2)
    trust : which channels may be hidden, and how much they count at most, shape (N, 3), or (0, 3) where all count in
        full; `apart`, `setting` and `free_steps` of `ChannelTrust`
    scale : slope by which derivatives are taken, one over the variance of intensity and of slopes that are known
        beforehand, longest step
    weight : shape (N, 3), receives how much channels counted in the last step, or (0, 3)
    """
    points, axes, coat, mixing, haze, bounce = lamps
    x, y, z, rest, shares, close, visible = skin
    hidden, counts, apart, setting, free_steps = trust
    delta, per_variance, known, longest = scale
    tilt_gain, count = coat[6], points.shape[1]
    rays, normal = np.empty((3, count, 5)), np.empty((3, 4))
    own, shown, counted = np.empty((3, 3)), np.empty((3, 3)), np.ones(3)
    lacking, lost = np.empty(3), np.empty(3)
    for i in range(first, last):
        v0, v1, v2 = to_camera(coat[8], x[i], y[i], z[i])
        for channel in range(3):
            for point in range(count):
                l0, l1, l2, bright = ray_to(points[channel, point], axes[channel], coat, x[i], y[i], z[i])
                if len(visible):
                    bright *= visible[i, channel, point]
                rays[channel, point, 0], rays[channel, point, 1], rays[channel, point, 2] = l0, l1, l2
                rays[channel, point, 3], rays[channel, point, 4] = l0 * v0 + l1 * v1 + l2 * v2, bright
        for step in range(steps):
            for k in range(3):
                p = slope[i, 0] + delta * (k == 1)
                q = slope[i, 1] + delta * (k == 2)
                up = 1.0 / np.sqrt(1.0 + p * p + q * q)
                normal[k, 0], normal[k, 1], normal[k, 2] = -p * up, -q * up, up
                normal[k, 3] = max(-p * up * v0 - q * up * v1 + up * v2, GRAZING)
            for channel in range(3):
                own[0, channel] = own[1, channel] = own[2, channel] = 0.0
                for point in range(count):
                    l0, l1, l2 = rays[channel, point, 0], rays[channel, point, 1], rays[channel, point, 2]
                    between, bright = rays[channel, point, 3], rays[channel, point, 4]
                    for k in range(3):
                        lit = max(normal[k, 0] * l0 + normal[k, 1] * l1 + normal[k, 2] * l2, 0.0)
                        own[k, channel] += bright * reflected(lit, normal[k, 3], between, coat)
            for k in range(3):
                for channel in range(3):
                    own[k, channel] *= 1.0 + tilt_gain * (1.0 - normal[k, 2])
                for channel in range(3):
                    shown[k, channel] = shown_by(
                        own[k],
                        mixing[channel],
                        haze[channel],
                        rest[i, channel],
                        close[i, channel],
                        bounce,
                        normal[k, 2],
                    )
            for channel in range(3):
                lacking[channel] = seen[i, channel] - shown[0, channel]
            if len(hidden):
                for channel in range(3):
                    counted[channel] = 1.0
                    if hidden[i, channel] and step < free_steps:
                        counted[channel] = 0.0
                    elif hidden[i, channel]:
                        # As `trust_in` has it for shadows without fitted lamps, but on both sides.
                        off = (abs(lacking[channel]) - apart[0]) / (apart[1] - apart[0])
                        low = (setting[0] - shown[0, channel]) / (setting[0] - setting[1])
                        trusted = (1.0 - min(max(off, 0.0), 1.0)) * (1.0 - min(max(low, 0.0), 1.0))
                        counted[channel] = min(counts[i, channel], trusted * trusted)
                    weight[i, channel] = counted[channel]
                _add_what_others_lack(shares[i], counted, lost, lacking)
            pp, pq, qq = known, 0.0, known
            along_p, along_q = known * (before[i, 0] - slope[i, 0]), known * (before[i, 1] - slope[i, 1])
            for channel in range(3):
                by_p = (shown[1, channel] - shown[0, channel]) / delta
                by_q = (shown[2, channel] - shown[0, channel]) / delta
                share = per_variance * counted[channel]
                pp += share * by_p * by_p
                pq += share * by_p * by_q
                qq += share * by_q * by_q
                along_p += share * lacking[channel] * by_p
                along_q += share * lacking[channel] * by_q
            across, down = solved(pp, pq, qq, along_p, along_q)
            bound = min(1.0, longest / max(np.sqrt(across * across + down * down), 1e-9))
            slope[i, 0] += bound * across
            slope[i, 1] += bound * down


@njit(cache=True, error_model="numpy")
def _add_what_others_lack(shares: Any, counted: Any, lost: Any, lacking: Any) -> None:
    """Add to what channels lack (3,) the light that they lack where the lamps of others do not arrive: as far as those
    do not count, and are darker than predicted.

    lost : room for what each of those lacks, shape (3,)
    """
    for channel in range(3):
        lost[channel] = (1.0 - counted[channel]) * max(-lacking[channel], 0.0)
    for channel in range(3):
        for lamp in range(3):
            if lamp != channel:
                lacking[channel] += shares[channel, lamp] * lost[lamp] / shares[lamp, lamp]
