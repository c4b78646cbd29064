"""Check that frames were taken under one set of lights with one gel: their untouched skin must look alike.

Most of every frame shows untouched skin, so that the median over the frame of the difference of two frames is that of
the skin. Lights of real sensors drift; what drifts has neighbours on the way, what was changed has none.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from device.calibration.acceptance import CLEAR_DISAGREEMENT, REFERENCE_CLIPPED
from device.errors import CalibrationMismatch, FrameError
from device.imaging.flat_field import DARK_FLOOR, MAX_DISAGREEMENT, LinearFrame, NormalizedImage, check_exposed
from device.surface import Float32Array, Float64Array

BLOCKS = 48
"""Frames are compared when reduced to this width."""

ENOUGH_FRAMES = 4
"""From so many frames on it shows how much they differ when nothing was changed."""

SURROUNDINGS = 5.0
"""Standard deviation, in blocks, of the surroundings that local changes are seen against."""

BRIGHT_PERCENTILE = 95.0
DARK = 0.1
"""Blocks darker than this fraction of the light at this percentile do not show skin."""

OBJECT_PERCENTILE = 99.0
OBJECT_CHANGE = 0.2
OBJECT_STANDS_OUT = 6.0
OBJECT_OF_REFERENCE = 1.35
"""An object in the reference changes the logarithm of light over this part of the blocks by so much, by so many times
the median change, and the reference's own light there by so many times what the presses' median light changes."""


def check_reference(reference: LinearFrame) -> None:
    """Refuse a reference that is black or saturated.

    Raises
    ------
    FrameError
        Says how much of it is.
    """
    check_exposed(reference, "the reference")
    clipped = float(reference.clipped.mean())
    if clipped > REFERENCE_CLIPPED:
        raise FrameError(
            f"the reference is saturated over {clipped:.0%} of its area, at most {REFERENCE_CLIPPED:.0%} may be: "
            "lower the exposure and take reference and presses again"
        )


def check_untouched(reference: LinearFrame, presses: Sequence[LinearFrame]) -> None:
    """Refuse a reference with an object in it: a local change that no press shows, and no press explains.

    Raises
    ------
    CalibrationMismatch
        Says where.
    """
    if len(presses) < ENOUGH_FRAMES:
        return
    at_rest, pressed = _log_blocks(reference.rgb), np.median([_log_blocks(press.rgb) for press in presses], axis=0)
    change, own, usual = (np.linalg.norm(_local(part), axis=-1) for part in (pressed - at_rest, at_rest, pressed))
    most = change >= np.percentile(change, OBJECT_PERCENTILE)
    size = float(change[most].min())
    if size < max(OBJECT_CHANGE, OBJECT_STANDS_OUT * float(np.median(change))):
        return
    if own[most].mean() < OBJECT_OF_REFERENCE * usual[most].mean():
        return
    rows, columns = reference.shape
    row, column = (float(np.median(at)) for at in np.nonzero(most))
    across, down = (column + 0.5) / change.shape[1] * columns, (row + 0.5) / change.shape[0] * rows
    raise CalibrationMismatch(
        f"the reference is not of untouched skin: near column {across:.0f}, row {down:.0f} it shows something that the "
        "presses do not: take it again with nothing on the gel"
    )


def _local(blocks: Float64Array) -> Float64Array:
    """Return the difference of blocks from their surroundings."""
    around = cv2.GaussianBlur(blocks, (0, 0), SURROUNDINGS, borderType=cv2.BORDER_REFLECT)
    return blocks - np.asarray(around).reshape(blocks.shape)


def check_agreement(
    names: Sequence[str], images: Sequence[NormalizedImage], flat_field: Float32Array, reference: bool
) -> None:
    """Refuse presses (and, when there is one, the reference they were divided by) that do not belong together.

    Dark surroundings of the skin count for nothing: a level of 8 bits changes them by a third.

    flat_field : what the images were divided by, shape (H, W, C)

    Raises
    ------
    CalibrationMismatch
        Names the frames that differ and by how much.
    """
    light = _log_blocks(flat_field)
    lit = (light > np.percentile(light, BRIGHT_PERCENTILE, axis=(0, 1)) + np.log(DARK)).all(axis=-1)
    apart = check_consistency([_blocks(image)[lit][None] for image in images], reference)
    if len(apart) < 2:
        return
    *others, gap = _steps_between_nearest(apart)
    within = others[-1] if others else 0.0
    limit = MAX_DISAGREEMENT
    if len(apart) >= ENOUGH_FRAMES:
        limit = min(limit, max(CLEAR_DISAGREEMENT, 2.0 * within))
    if gap <= limit:
        return
    from scipy.cluster.hierarchy import fcluster, linkage  # here, because it takes 0.1 s to load
    from scipy.spatial.distance import squareform

    group = fcluster(linkage(squareform(apart), "single"), 0.5 * (gap + within), "distance")
    usual = np.argmax(np.bincount(group, np.append(np.ones(len(group) - 1), 1.5 if reference else 1.0)))
    odd = [names[i] for i in range(len(names)) if group[i] != usual]
    if reference and (group[-1] != usual or not odd):
        raise CalibrationMismatch(
            f"the reference is not of these presses: untouched skin of the presses is {gap:.0%} off it, and within "
            f"{within:.0%} of another press's: take the reference again with this gel, these lights and this exposure"
        )
    raise CalibrationMismatch(
        f"two sets of lights, or two gels, are mixed: untouched skin of {', '.join(odd)} is {gap:.0%} off that of any "
        f"other frame, which agree to {within:.0%}: calibrate from one set"
    )


def check_consistency(blocks: Sequence[Float64Array], reference: bool) -> Float64Array:
    """Return shares by which untouched skin differs between frames, worst channel; the reference, if any, comes last.

    blocks : log intensity of each frame, float64 arrays of shape (h, w, 3)
    """
    everyone = [*blocks, np.zeros_like(blocks[0])] if reference else list(blocks)
    apart = np.zeros((len(everyone), len(everyone)))
    for i, one in enumerate(everyone):
        for j in range(i):
            apart[i, j] = apart[j, i] = float(np.median(np.abs(one - everyone[j]), axis=(0, 1)).max())
    return apart


def _steps_between_nearest(apart: Float64Array) -> list[float]:
    """Return the lengths of the minimum spanning tree of the frames (Prim's algorithm), shortest first."""
    nearest, steps = apart[0].copy(), []
    reached = np.zeros(len(apart), np.bool_)
    reached[0] = True
    while not reached.all():
        following = int(np.argmin(np.where(reached, np.inf, nearest)))
        steps.append(float(nearest[following]))
        reached[following] = True
        nearest = np.minimum(nearest, apart[following])
    return sorted(steps)


def _blocks(image: NormalizedImage) -> Float64Array:
    """Return the log intensity of a frame reduced by area, float64 array of shape (h, w, 3)."""
    return _log_blocks(np.nan_to_num(image.values))


def _log_blocks(values: Float32Array) -> Float64Array:
    rows, columns, channels = values.shape
    size = (min(BLOCKS, columns), max(1, round(rows * min(BLOCKS, columns) / columns)))
    small = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA)).reshape(*size[::-1], channels)
    return np.asarray(np.log(np.maximum(small, DARK_FLOOR)), np.float64)
