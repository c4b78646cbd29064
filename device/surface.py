"""Gradient field, height map, stereographic slopes, the conventions of every module, and integration of a rectangle.

* Arrays are (row, column); the centre of the first pixel is (0, 0); rows grow downwards.
* p = dz/dcolumn and q = dz/drow, dimensionless (µm/µm).
* z is in µm, positive towards the camera, so a bump on the object is positive.
  Rows down and z to the camera make the frame left-handed; writers of formats with y upwards flip it once.
* Invalid is not zero: NaN in float arrays, False in masks.
* Colour order is R, G, B.

The stereographic slope u = 2 (p, q) / (1 + sqrt(1 + p² + q²)) is the target of fits. It stays bounded for steep
slopes, so that steep pixels do not dominate a least-squares fit.

`integrate_dct` finds the least-squares surface of min Σ (f_x − p)² + (f_y − q)² (paper, eq. 9) with free (Neumann)
borders. Differences are defined on the edges between neighbouring pixels, where the slope is the mean of the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

Float32Array: TypeAlias = NDArray[np.float32]
Float64Array: TypeAlias = NDArray[np.float64]
MaskArray: TypeAlias = NDArray[np.bool_]


MIN_FOURTH_ORDER: Final = 4
"""Pixels that a line must exceed for differences of fourth order."""

NOISE_KEPT: Final = 0.44
"""Share of a pixel's slope noise that integration and central differences leave: the rest belongs to no surface.

Of white noise the fourth-order edges, least squares and the central difference of the height map let pass 0.44 of the
standard deviation (the mean over all frequencies of the product of their transfer functions). So much of it counts when
forms and penalties are judged.
"""


@dataclass(frozen=True, slots=True, eq=False)
class GradientField:
    """Slopes of a surface, estimated per pixel.

    p, q : float32 arrays of shape (H, W), µm/µm; finite where `valid` is True
    valid : bool array of shape (H, W)
    weight : float32 array of shape (H, W), relative confidence >= 0, zero where invalid
    """

    p: Float32Array
    q: Float32Array
    valid: MaskArray
    weight: Float32Array


def full_rectangle(p: Float32Array, q: Float32Array) -> GradientField:
    """Return a gradient field without holes or weights: every pixel is valid and has weight 1.

    `valid` and `weight` are read-only broadcast views of one value.
    """
    return GradientField(p, q, np.broadcast_to(np.True_, p.shape), np.broadcast_to(np.float32(1.0), p.shape))


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """A surface on a grid.

    z_um : float32 array of shape (H, W), µm, NaN where invalid
    pitch_um : distance of neighbouring pixels on the skin, µm
    """

    z_um: Float32Array
    pitch_um: float


def surface_slopes(height: HeightMap) -> tuple[Float32Array, Float32Array]:
    """Return slopes (p, q) by central differences: float32 arrays of shape (H, W), NaN next to invalid pixels.

    They are of fourth order, which keep 0.995 of a wave of 10 px instead of 0.935; of second order, or one-sided, next
    to invalid pixels and the border.
    """
    z = np.ascontiguousarray(height.z_um / np.float32(height.pitch_um), np.float32)
    return _slope(z, 1), _slope(z, 0)


def _slope(z: Float32Array, axis: int) -> Float32Array:
    """Return the slope along an axis of at least two pixels."""
    near = np.asarray(np.gradient(z, axis=axis), np.float32)
    if z.shape[axis] > MIN_FOURTH_ORDER:
        kernel = np.array([[1.0, -8.0, 0.0, 8.0, -1.0]], np.float32) / np.float32(12.0)
        inner = (slice(None),) * axis + (slice(2, -2),)
        far = cv2.filter2D(z, cv2.CV_32F, kernel if axis else kernel.T)[inner]
        np.copyto(near[inner], far, where=np.isfinite(far))
    return near


def slope_from_stereographic(u: NDArray[Any], steepest: float = 20.0) -> NDArray[Any]:
    """Return slopes (p, q) of shape (..., 2) from stereographic slopes; steeper ones become as steep as `steepest`."""
    size, largest = np.sqrt((u * u).sum(axis=-1, keepdims=True)), stereographic_size(steepest)
    held = largest / np.maximum(size, largest)
    return np.asarray(held * u / (1.0 - 0.25 * np.minimum(size, largest) ** 2))


def stereographic_size(steepness: float) -> float:
    """Return the size of the stereographic slope of a slope."""
    return 2.0 * steepness / (1.0 + float(np.sqrt(1.0 + steepness * steepness)))


def stereographic_from_slope(p: NDArray[Any], q: NDArray[Any]) -> NDArray[Any]:
    """Return the stereographic slopes of shape (N, 2)."""
    scale = 2.0 / (1.0 + np.sqrt(1.0 + p * p + q * q))
    return np.asarray(np.stack([p, q], axis=-1) * scale[..., None])


def integrate_dct(p: Float32Array, q: Float32Array, pitch_um: float) -> Float32Array:
    """Return the height with mean zero: float32 array of shape (H, W), µm, from slopes of the same shape (µm/µm).

    pitch_um : distance of neighbouring pixels, µm
    """
    # Twice the divergence: slopes of the edges left of and above a pixel minus those of the edges after it.
    divergence = np.empty(p.shape, np.float32)
    np.subtract(p[:, :-2], p[:, 2:], out=divergence[:, 1:-1])
    divergence[:, 0] = -(p[:, 0] + p[:, 1])
    divergence[:, -1] = p[:, -2] + p[:, -1]
    divergence[1:-1] += q[:-2] - q[2:]
    divergence[0] -= q[0] + q[1]
    divergence[-1] += q[-2] + q[-1]
    spectrum = dctn(divergence, type=2, norm="ortho", overwrite_x=True)
    spectrum *= _inverse_eigenvalues(p.shape, pitch_um)
    return np.asarray(idctn(spectrum, type=2, norm="ortho", overwrite_x=True), np.float32)


@lru_cache(maxsize=2)
def _inverse_eigenvalues(shape: tuple[int, ...], pitch_um: float) -> Float32Array:
    """Return the height per unit of twice the divergence, µm, for each cosine: float32 array (H, W); 0 for the mean."""
    return np.asarray(0.5 * pitch_um / eigenvalues(shape), np.float32)


def eigenvalues(shape: tuple[int, ...]) -> Float64Array:
    """Return the eigenvalue of the least-squares operator for each cosine: float64 array of shape (H, W).

    The zero eigenvalue of the mean is replaced by infinity, so that dividing by these gives heights with mean zero.
    """
    rows, columns = (2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in shape)
    eigenvalue = np.add.outer(rows, columns)
    eigenvalue[0, 0] = np.inf
    return np.asarray(eigenvalue)


# Height of skin at rest, which is zero: what a height map shows there is error, which continues into its surroundings.
#
# Slopes of the free skin around an object do not close, and integration spreads what does not close over the field.
# Skin at rest that calm or gentle skin connects lies at one height: its height against the mean of those at rest is
# error, which continues over the rest of the field as a solution of Laplace's equation would. Parts that steep slopes
# separate, such as the two sides of a step, keep their distance.

GENTLE_SIGMAS: Final = 6.0
"""Slopes of cells up to this multiple of the standard uncertainty of slopes connect skin at rest of one height: about
twice that of free skin, on which balls show no slopes."""

FLANK_FRACTION: Final = 0.3
STEEPEST_PERCENT: Final = 99.0
"""Gentle slopes also stay below this fraction of the steepest, so that the flank of a low step connects nothing."""

BULGE: Final = 0.03
"""Depth of skin around an object as a fraction of the object's height: incompressible gel gives way, but not far."""

BULGE_ROUNDS: Final = 8

PIT_CELLS: Final = 4
PIT_FRACTION: Final = 0.3
"""Depth of a doubted pit as a fraction of the object's height, at least, and the other way round: a surface that hardly
rises above its recesses is engraved."""


def rest_height(
    height: HeightMap, resting: MaskArray, calm: MaskArray, slope_sigma: float, weight: Float32Array | None = None
) -> Float32Array:
    """Return what to subtract from heights in cells, so that skin at rest is level and zero on its largest part.

    Objects press skin towards the camera only. Where the information of slopes is known, gentle skin that is connected
    to skin at rest is lifted where it lies below it.

    Float32 array of shape (h, w), µm, 0 where no height at rest is known; bilinear between the middles of cells.

    height : NaN where invalid
    resting, calm : bool arrays of shape (h, w), cells at rest, and cells that connect those of one height
    slope_sigma : standard uncertainty of slopes; gentle skin connects cells at rest, too
    weight : float32 array of shape (h, w), information of slopes; None where it is not known
    """
    means, known = mean_heights(height.z_um, (calm.shape[0], calm.shape[1]))
    resting = known & resting
    if not resting.any():
        return np.zeros_like(means)
    labels = _connected(means, known, calm, _cell_um(height, calm), GENTLE_SIGMAS * slope_sigma)
    sizes = np.bincount(labels[resting], minlength=labels.max() + 1)
    levels = np.bincount(labels[resting], means[resting], minlength=len(sizes)) / np.maximum(sizes, 1)
    above = means - levels.astype(np.float32)[labels]
    zero_um = np.float32(levels[sizes.argmax()])
    error = _continued(np.where(resting, above, np.float32(0.0)), resting.astype(np.float32))
    if weight is not None:
        skin = known & (sizes > 0)[labels]
        z_um = np.where(skin, above, (means - zero_um) * known) - error
        error -= np.where(resting, np.float32(0.0), enlarged(_lift(z_um, skin, resting, weight), error.shape))
    return error + zero_um


def levels_apart_um(height: HeightMap, resting: MaskArray, calm: MaskArray, slope_sigma: float) -> float:
    """Return how far apart skin at rest lies that no steep flank separates, µm; 0 where that may be noise.

    Either an object rises gently to a flat face, or slopes are wrong. Arguments are those of `rest_height`.
    """
    means, known = mean_heights(height.z_um, (calm.shape[0], calm.shape[1]))
    resting = known & resting
    labels = _connected(means, known, calm, _cell_um(height, calm), np.inf)
    levels = [means[resting & (labels == part)] for part in np.unique(labels[resting])]
    apart_um = max((float(np.ptp(level)) for level in levels), default=0.0)
    noise_um = max(BULGE * float(means.max()), slope_sigma * _cell_um(height, calm))
    return apart_um if apart_um > noise_um else 0.0


def pit_um(height: HeightMap, shape: tuple[int, int], slope_sigma: float) -> float:
    """Return how deep skin around an object lies below its zero, µm; 0 without a pit several cells wide.

    An object presses skin towards the camera only: either it has a recess, or slopes are wrong.

    shape : numbers of cells over the field, rows and columns
    slope_sigma : standard uncertainty of slopes, of which a shallower pit may be noise
    """
    rows, columns = (-(-cells // PIT_CELLS) for cells in shape)
    means, known = mean_heights(height.z_um, (rows, columns))
    depth_um, highest_um = (float((sign * means[known]).max(initial=0.0)) for sign in (-1.0, 1.0))
    shallowest_um = slope_sigma * height.pitch_um * height.z_um.shape[1] / columns
    alike = PIT_FRACTION * max(depth_um, highest_um) < min(depth_um, highest_um)
    return depth_um if alike and depth_um > shallowest_um else 0.0


def _cell_um(height: HeightMap, cells: MaskArray) -> float:
    """Return the distance of neighbouring cells over the field of a height map, µm."""
    return float(height.pitch_um * height.z_um.shape[1] / cells.shape[1])


def _connected(
    means: Float32Array, known: MaskArray, calm: MaskArray, cell_um: float, steepest: float
) -> NDArray[np.int32]:
    """Return the number of the part of connected calm or gentle skin that each cell belongs to, 0 for none: (h, w).

    steepest : slope of gentle skin, at most
    """
    slope = np.hypot(*surface_slopes(HeightMap(means, cell_um)))
    limit = min(steepest, FLANK_FRACTION * float(np.percentile(slope, STEEPEST_PERCENT)))
    gentle = (calm | (known & (slope < limit))).astype(np.uint8)
    return np.asarray(cv2.connectedComponents(gentle, connectivity=4)[1], np.int32)


def _lift(z_um: Float32Array, skin: MaskArray, resting: MaskArray, weight: Float32Array) -> Float32Array:
    """Return what brings skin that lies too low up to its level, in cells of twice the side, µm.

    It changes heights of much information as a whole. Arguments are arrays of shape (h, w).

    z_um : height above the level of skin at rest
    skin, resting : cells that may lie too low, and cells that stay
    weight : information of slopes
    """
    share, held, z_um, weight = _halved(skin), _halved(resting) > 0.0, _halved(z_um), _halved(weight)
    lift, given = np.zeros_like(z_um), np.zeros_like(z_um)
    highest_um = z_um.max()
    deepest_um = np.float32(BULGE) * highest_um
    for _ in range(BULGE_ROUNDS):
        depth_um = -(z_um + lift)
        sunk = ~held & (share > 0.5) & (depth_um > deepest_um) & (depth_um < highest_um)
        if not sunk.any():
            break
        given, held = np.where(sunk, -z_um - deepest_um, given), held | sunk
        lift = _membrane(given, held, weight)
    return lift


def _membrane(given: Float32Array, held: MaskArray, weight: Float32Array) -> Float32Array:
    """Return values (h, w) of the least weighted sum of squared differences, given where they are held."""
    from scipy.linalg import solveh_banded  # here, because no command needs it before its first frame

    rows, columns = given.shape
    # Arrays run along columns: neighbours in a column follow each other, so that the matrix has 2 rows + 1 diagonals.
    values, free = np.where(held, given, np.float32(0.0)).T.astype(np.float64), ~held.T
    stiff = weight.T.astype(np.float64)
    banded = np.zeros((rows + 1, columns, rows))
    pull = np.zeros((columns, rows))
    for axis, offset in ((0, rows), (1, 1)):
        one, other = ((slice(None),) * axis + (part,) for part in (slice(None, -1), slice(1, None)))
        edge = 2.0 * stiff[one] * stiff[other] / (stiff[one] + stiff[other])
        for here, beyond in ((one, other), (other, one)):
            banded[0][here] += edge
            pull[here] += edge * values[beyond]
        banded[offset][one] -= edge * (free[one] & free[other])
    right, banded[0] = np.where(free, pull, values), np.where(free, banded[0], 1.0)
    found = solveh_banded(
        banded.reshape(rows + 1, -1), right.ravel(), lower=True, overwrite_ab=True, check_finite=False
    )
    return np.asarray(found.reshape(columns, rows).T, np.float32)


def large_parts(mask: MaskArray, at_border: float, inside: float = 1.0, connectivity: int = 8) -> MaskArray:
    """Return the large connected parts of a mask: bool array of its shape (H, W).

    at_border, inside : fraction of the field that parts at its border, and others, exceed
    connectivity : 8 where diagonal neighbours are connected, else 4
    """
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=connectivity)
    least = np.full(labels.max() + 1, inside)
    least[np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])] = at_border
    large = np.bincount(labels.ravel()) / labels.size > least
    return np.asarray(mask & large[labels], np.bool_)


def _halved(cells: NDArray[Any]) -> Float32Array:
    """Return means over cells of twice the side."""
    rows, columns = cells.shape
    size = (max(columns // 2, 1), max(rows // 2, 1))
    return np.asarray(cv2.resize(cells.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def enlarged(cells: Float32Array, shape: tuple[int, ...]) -> Float32Array:
    """Return cells over the field at each of its pixels, float32 array of `shape` (H, W)."""
    return np.asarray(cv2.resize(cells, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def mean_heights(height: Float32Array, shape: tuple[int, int]) -> tuple[Float32Array, MaskArray]:
    """Return mean heights of cells, arrays of `shape` (h, w), and whether they are known for the most part."""
    means = np.asarray(cv2.resize(height, shape[::-1], interpolation=cv2.INTER_AREA), np.float32)
    if np.isfinite(means).all():
        return means, np.ones(shape, np.bool_)
    valid = np.isfinite(height)
    share = np.asarray(cv2.resize(valid.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA), np.float32)
    total = cv2.resize(np.where(valid, height, np.float32(0.0)), shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(total / np.maximum(share, np.float32(1e-6)), np.float32), share > 0.5


def _continued(values: Float32Array, known: Float32Array) -> Float32Array:
    """Return values (h, w) that continue smoothly from where they are known; `known` is their weight, 0 to 1.

    Means over ever coarser cells fill what is not known.
    """
    if min(values.shape) < 2:
        return np.full_like(values, (values * known).sum() / max(float(known.sum()), 1e-9))
    size = ((values.shape[1] + 1) // 2, (values.shape[0] + 1) // 2)
    weight = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA), np.float32)
    mean = cv2.resize(values * known, size, interpolation=cv2.INTER_AREA) / np.maximum(weight, np.float32(1e-6))
    coarser = _continued(np.asarray(mean, np.float32), np.minimum(np.float32(2.0) * weight, np.float32(1.0)))
    wide = cv2.resize(coarser, values.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(known * values + (np.float32(1.0) - known) * wide, np.float32)
