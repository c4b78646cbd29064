"""Steps of slopes under lamps, place by place: the kernels of `LampSkin` and of `gauss_newton_step`, and parts."""

from __future__ import annotations

from typing import Any

import numpy as np

from host_sync.kernels.jit import njit


@njit(cache=True, nogil=True, error_model="numpy")
def write_shown(
    own: Any, mixing: Any, haze: Any, rest: Any, close: Any, bounce: Any, p: Any, q: Any, shown: Any,
    first: int, last: int,
) -> None:  # fmt: skip
    """Write intensity into the rows `first` to `last` - 1 of `shown`, float64 array of shape (N, K, 3).

    own : what K slopes at each place show of each channel's own lamp, shape (N, K, 3)
    mixing, haze : by channel what it passes of each lamp's light, shape (3, 3), and light that is no lamp's
    rest, close : of untouched skin and of skin close by, shape (N, 3)
    bounce : light from skin farther away, and from that close by over what it shows
    p, q : slopes, shape (N, K)
    """
    for i in range(first, last):
        for k in range(p.shape[1]):
            up = 1.0 / np.sqrt(1.0 + p[i, k] * p[i, k] + q[i, k] * q[i, k])
            for channel in range(3):
                shown[i, k, channel] = shown_by(
                    own[i, k], mixing[channel], haze[channel], rest[i, channel], close[i, channel], bounce, up
                )


@njit(cache=True, nogil=True, error_model="numpy")
def write_step(
    change: Any, weight: Any, missing: Any, back: Any, known: float, step: Any, first: int, last: int
) -> None:
    """Write Gauss-Newton steps into the rows `first` to `last` - 1 of `step`, float64 array of shape (N, 2).

    change, weight, missing, back : as of `gauss_newton_step`
    known : one over the variance of slopes that are known beforehand
    """
    for i in range(first, last):
        pp, pq, qq, along_p, along_q = 0.0, 0.0, 0.0, 0.0, 0.0
        for channel in range(3):
            by_p, by_q, counts = change[i, channel, 0], change[i, channel, 1], weight[i, channel]
            pp += counts * by_p * by_p
            pq += counts * by_p * by_q
            qq += counts * by_q * by_q
            along_p += counts * missing[i, channel] * by_p
            along_q += counts * missing[i, channel] * by_q
        along_p += known * back[i, 0]
        along_q += known * back[i, 1]
        pp += known
        qq += known
        step[i, 0], step[i, 1] = solved(pp, pq, qq, along_p, along_q)


@njit(cache=True, error_model="numpy")
def shown_by(own: Any, mixing: Any, haze: Any, rest: Any, close: Any, bounce: Any, up: Any) -> Any:
    """What one channel shows of the light of the lamps (3,), whose normal's cosine to the vertical is `up`."""
    mixed = own[0] * mixing[0] + own[1] * mixing[1] + own[2] * mixing[2]
    return (mixed + haze) / rest + (1.0 - up) * (bounce[0] + bounce[1] * close)


@njit(cache=True, error_model="numpy")
def solved(pp: Any, pq: Any, qq: Any, along_p: Any, along_q: Any) -> Any:
    """The solution of two normal equations."""
    determinant = pp * qq - pq * pq
    return (qq * along_p - pq * along_q) / determinant, (pp * along_q - pq * along_p) / determinant
