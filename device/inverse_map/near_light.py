"""Lights so near that they stand elsewhere for every place of the field: intensity as the slopes of a matt skin.

A matt skin of slope g shows, divided by its reference, I √(1 + |g|²) = 1 + a·g under one light, and under mixtures of
lights too; a says where the light stands as seen from that place. Three channels then give three linear equations,

    s I_k = 1 + a_k(x, y)·g,        k = R, G, B,

for g and the inverse brightness s. Where skin glitters or a light has set behind it they are wrong, but as variables of
a polynomial they leave it little to do: colour and place are taken apart before it begins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import BallSamples
from device.inverse_map.regressor import field_position, monomials, position_exponents
from device.surface import Float32Array, Float64Array

PLACE_DEGREE: Final = 3
"""Degree in position of the lights' directions: 1 is a point's over a plane; of several lights, in a strip or through a
filter that lets others pass, each is the nearest somewhere, which takes more."""

OLD_PLACE_DEGREE: Final = 2
"""Degree of files written before."""

CUBIC_PENALTY: Final = 0.1
"""Price of terms of degree 3, relative to one ball's information on a direction: a dozen balls leave some open."""

GENTLE: Final = 0.35
"""Slopes up to which directions are fitted: no light has set behind them."""

MIN_BRIGHTNESS: Final = 0.2
"""1 / s is held above this: beyond it lies no skin that three lights show."""

MIN_VOLUME: Final = 1e-6
"""Of three directions; where they lie in one plane closer than this the equations say nothing."""

VOLUME_FRACTION: Final = 0.15
"""The same as a share of the median over the field, and never of the other sign: beyond the outermost balls polynomials
of place may let three directions fall into one plane, where pixel noise was read as slopes of any size."""

VOLUME_PLACES: Final = 9
"""Places along each side of the field at which the median is taken."""

_DEGREES: Final = {len(position_exponents(degree)): degree for degree in (OLD_PLACE_DEGREE, PLACE_DEGREE)}


@dataclass(frozen=True, slots=True, eq=False)
class NearLightModel:
    """Directions of the lights, each a polynomial in position.

    directions : float32 array of shape (K, 2, 3): for every position monomial a's two components in R, G, B
    """

    directions: Float32Array

    @classmethod
    def of(cls, samples: BallSamples, slope: Float64Array, shape: tuple[int, int]) -> NearLightModel:
        """Return the directions that gentle slopes, float64 array of shape (N, 2), of a full-size field (H, W) show.

        Where no slope is gentle every direction is zero, i.e. uninformative.
        """
        gentle = np.linalg.norm(slope, axis=1) < GENTLE
        place = monomials(field_position(samples.column[gentle], samples.row[gentle], shape), PLACE_DEGREE)
        features = direction_features(slope[gentle], place)
        bends = _bends(slope[gentle], place[:, :1])
        lit = lit_by(samples.intensity[gentle], slope[gentle])
        dear = np.repeat([float(i + j > OLD_PLACE_DEGREE) for i, j in position_exponents(PLACE_DEGREE)], 2)
        information = 0.5 * float((slope[gentle] ** 2).sum()) / max(len(np.unique(samples.ball[gentle])), 1)
        penalty = np.diag(np.append(CUBIC_PENALTY * np.sqrt(information) * dear, np.zeros(bends.shape[1])))
        design = np.concatenate([np.concatenate([features, bends], axis=1), penalty])
        directions = np.linalg.lstsq(design, np.concatenate([lit, np.zeros((len(penalty), 3))]), rcond=None)[0]
        return cls(directions[: features.shape[1]].reshape(place.shape[1], 2, 3).astype(np.float32))

    @property
    def degree(self) -> int:
        """Degree in position of its directions."""
        return _DEGREES[len(self.directions)]

    @property
    def min_volume(self) -> float:
        """Volume of the directions, with its sign, below which it is not taken to fall."""
        axis = np.linspace(-1.0, 1.0, VOLUME_PLACES)
        place = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        directions = np.tensordot(monomials(place, self.degree), self.directions.astype(np.float64), axes=1)
        median = float(np.median(np.cross(directions[:, 0], directions[:, 1]).sum(axis=1))) + 0.0  # no zero has a sign
        return float(np.copysign(max(VOLUME_FRACTION * abs(median), MIN_VOLUME), median))

    def seen(self, intensity: Float32Array, place: Float64Array) -> Float32Array:
        """Return slopes p, q and brightness 1 / s of intensities (N, 3) at position variables (N, 2): shape (N, 3)."""
        directions = np.tensordot(monomials(place, self.degree), self.directions.astype(np.float64), axes=1)
        return _solved(intensity, directions[:, 0], directions[:, 1], self.min_volume)

    def seen_rows(self, values: Float32Array, across: Float32Array, down: Float32Array) -> Float32Array:
        """Return what `seen` does, of whole rows (h, w, 3) at position variables `across` (w,) and `down` (h,)."""
        place = np.stack(np.broadcast_arrays(across[None, :], down[:, None]), axis=-1).reshape(-1, 2)
        return self.seen(values.reshape(-1, 3), place.astype(np.float64)).reshape(values.shape)

    def by_powers(self) -> Float32Array:
        """Return directions by component, channel, and power of column and of row: float32 (2, 3, 4, 4)."""
        powers = PLACE_DEGREE + 1
        table = np.zeros((2, 3, powers, powers), np.float32)
        for term, (i, j) in enumerate(position_exponents(self.degree)):
            table[:, :, i, j] = self.directions[term]
        return table

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        return {"directions": self.directions}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> NearLightModel:
        """Return the field that `arrays` wrote; KeyError or ValueError when malformed."""
        directions = np.asarray(arrays["directions"], np.float32)
        if directions.shape[1:] != (2, 3) or len(directions) not in _DEGREES or not np.isfinite(directions).all():
            raise ValueError(f"directions of lights of shape {directions.shape}")
        return cls(directions)


def direction_features(slope: Float64Array, place: Float64Array) -> Float64Array:
    """Return what directions are multiplied by to give a·g: float64 array of shape (N, 2 K).

    slope : float64 array of shape (N, 2)
    place : float64 array of shape (N, K), monomials of position
    """
    return np.asarray((place[:, :, None] * slope[:, None, :]).reshape(len(place), 2 * place.shape[1]))


def _bends(slope: Float64Array, place: Float64Array) -> Float64Array:
    """Return squares and cubes of slopes: what skins that are not matt add, so that a is what holds at slope zero."""
    p, q = slope.T
    square = (slope**2).sum(axis=1, keepdims=True)
    return np.concatenate([np.stack([p * p, p * q, q * q], axis=1), square * direction_features(slope, place)], axis=1)


def lit_by(intensity: Float32Array, slope: Float64Array) -> Float64Array:
    """a·g of a matt skin that shows intensities (N, 3) at slopes (N, 2): float64 array of shape (N, 3)."""
    return np.asarray(intensity * np.sqrt(1.0 + (slope**2).sum(axis=1, keepdims=True)) - 1.0)


def _solved(intensity: Float32Array, across: Float64Array, down: Float64Array, least: float) -> Float32Array:
    """p, q, 1 / s of shape (N, 3) by Cramer's rule; `across` and `down`, (N, 3), are a's components by channel.

    least : as of `NearLightModel.min_volume`
    """
    ones = np.ones(3)
    volume = np.cross(across, down)
    whole = volume.sum(axis=1)
    whole = np.maximum(whole, least) if least > 0.0 else np.minimum(whole, least)
    # So written that untouched skin has brightness 1 where the volume is held up too.
    brightness = np.maximum(1.0 + ((intensity - 1.0) * volume).sum(axis=1) / whole, MIN_BRIGHTNESS)
    p = (intensity * np.cross(down, ones)).sum(axis=1) / (whole * brightness)
    q = (intensity * np.cross(ones, across)).sum(axis=1) / (whole * brightness)
    return np.stack([p, q, brightness], axis=1).astype(np.float32)


# The light that untouched skin sends back, place by place: what intensity is multiplied with to be light again.
#
# A frame divided by its reference carries the reference's own errors: lights that stood otherwise, a haze that was
# added and not multiplied. A curve that reads the frame's light itself is free of them
# (docs/decisions/0004-direct-inverse.md).

NODE_PX: Final = 8
"""Distance of the places at which the light is kept, pixels, about: the reference was blurred before."""


@dataclass(frozen=True, slots=True, eq=False)
class IlluminationMap:
    """Light of untouched skin relative to its mean over the field, at places even over the field, borders included.

    nodes : float32 array of shape (h, w, 3), h and w at least 2; between them it runs straight
    """

    nodes: Float32Array

    @classmethod
    def of(cls, flat_field: Float32Array) -> IlluminationMap:
        """Return the illumination map of a reference, float32 array of shape (H, W, 3), share of full scale."""
        rows, columns = flat_field.shape[:2]
        counts = [max(size // NODE_PX, 1) + 1 for size in (rows, columns)]
        row, column = (
            np.linspace(0.0, size, count, dtype=np.float32) - np.float32(0.5)
            for size, count in zip((rows, columns), counts, strict=True)
        )
        smooth = cv2.blur(flat_field, (NODE_PX, NODE_PX), borderType=cv2.BORDER_REPLICATE)
        grid = np.meshgrid(column, row)
        nodes = cv2.remap(smooth, grid[0], grid[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cls(np.asarray(nodes / flat_field.mean(axis=(0, 1), dtype=np.float64), np.float32))

    def at(self, place: NDArray[Any]) -> Float32Array:
        """Return the light of shape (N, 3) at position variables of shape (N, 2), -1 to 1 over the field."""
        return between_nodes(self.nodes, place)

    def seen(self, intensity: Float32Array, place: NDArray[Any]) -> Float32Array:
        """Return the light of intensities (N, 3) at position variables (N, 2): shape (N, 3)."""
        return np.asarray(intensity * self.at(place), np.float32)

    def seen_rows(self, values: Float32Array, across: Float32Array, down: Float32Array) -> Float32Array:
        """Return the light of whole rows of intensities (h, w, 3).

        across, down : position variables of the columns (w,) and rows (h,)
        """
        return np.asarray(values * self.rows(across, down), np.float32)

    def rows(self, across: Float32Array, down: Float32Array) -> Float32Array:
        """Return the light of shape (h, w, 3) of whole rows at position variables `across` (w,) and `down` (h,)."""
        return rows_between_nodes(self.nodes, across, down)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        return {"nodes": self.nodes}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> IlluminationMap:
        """Return the field that `arrays` wrote; KeyError or ValueError when malformed."""
        nodes = np.asarray(arrays["nodes"], np.float32)
        if not is_node_grid(nodes, 3):
            raise ValueError(f"light of shape {nodes.shape}")
        return cls(nodes)


def is_node_grid(nodes: Float32Array, values: int) -> bool:
    """Return True if values can be interpolated between an array's nodes.

    It is finite, with two or more nodes along either side, and so many values at each.
    """
    return nodes.ndim == 3 and nodes.shape[2] == values and min(nodes.shape[:2]) >= 2 and bool(np.isfinite(nodes).all())


def between_nodes(nodes: Float32Array, place: NDArray[Any]) -> Float32Array:
    """Return values (N, C) interpolated between `nodes` (h, w, C), which are even over the field.

    place : position variables (N, 2)
    """
    (left, right_share), (top, down_share) = (_between(place[:, axis], nodes.shape[1 - axis]) for axis in (0, 1))
    upper = _mix(nodes[top, left], nodes[top, left + 1], right_share)
    lower = _mix(nodes[top + 1, left], nodes[top + 1, left + 1], right_share)
    return _mix(upper, lower, down_share)


def rows_between_nodes(nodes: Float32Array, across: Float32Array, down: Float32Array) -> Float32Array:
    """Return what `between_nodes` does, for whole rows: shape (h, w, C).

    across, down : position variables of the columns (w,) and rows (h,)
    """
    left, right_share = _between(across, nodes.shape[1])
    top, down_share = _between(down, nodes.shape[0])
    coarse = nodes[top] + (nodes[top + 1] - nodes[top]) * down_share[:, None, None]
    return np.asarray(
        coarse[:, left] + (coarse[:, left + 1] - coarse[:, left]) * right_share[None, :, None], np.float32
    )


def _between(position: NDArray[Any], count: int) -> tuple[NDArray[np.intp], Float32Array]:
    """Return the index of the node before each position variable, and the share of the way to the next, float32."""
    at = np.clip((np.asarray(position, np.float64) + 1.0) * (0.5 * (count - 1)), 0.0, count - 1.0)
    before = np.minimum(at.astype(np.intp), count - 2)
    return before, (at - before).astype(np.float32)


def _mix(first: Float32Array, second: Float32Array, share: Float32Array) -> Float32Array:
    return np.asarray(first + (second - first) * share[:, None], np.float32)
