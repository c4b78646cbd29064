"""The light that untouched skin sends back, place by place: what intensity is multiplied with to be light again.

A frame divided by its reference carries the reference's own errors: lights that stood otherwise, a haze that was added
and not multiplied. A curve that reads the frame's light itself is free of them (docs/decisions/0004-direct-inverse.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.surface.fields import Float32Array

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
        """Return the light of whole rows of intensities (h, w, 3) at position variables `across` (w,) and `down`
        (h,)."""
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
    """Return True if an array can be read between nodes: finite, so many values at each of two or more places a
    side."""
    return nodes.ndim == 3 and nodes.shape[2] == values and min(nodes.shape[:2]) >= 2 and bool(np.isfinite(nodes).all())


def between_nodes(nodes: Float32Array, place: NDArray[Any]) -> Float32Array:
    """Return values (N, C) at position variables (N, 2) of what `nodes`, (h, w, C), hold at places even over the
    field."""
    (left, right_share), (top, down_share) = (_between(place[:, axis], nodes.shape[1 - axis]) for axis in (0, 1))
    upper = _mix(nodes[top, left], nodes[top, left + 1], right_share)
    lower = _mix(nodes[top + 1, left], nodes[top + 1, left + 1], right_share)
    return _mix(upper, lower, down_share)


def rows_between_nodes(nodes: Float32Array, across: Float32Array, down: Float32Array) -> Float32Array:
    """Return the same for whole rows: shape (h, w, C) at position variables `across` (w,) and `down` (h,)."""
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
