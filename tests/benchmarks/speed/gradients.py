"""Slopes per pixel: our position-aware inverse, plain numpy, and the peer network, on the same image."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.surface import GradientField
from host_sync.calibration.calibrate import Calibration
from tests.benchmarks.speed.machine import cores
from tests.benchmarks.speed.ours_slopes import estimate_slopes
from tests.benchmarks.speed.peer_network import has_torch, network_methods
from tests.benchmarks.speed.plan import Plan, Shape
from tests.benchmarks.speed.specimen import at_size
from tests.benchmarks.speed.timing import side_by_side


def measure(plan: Plan, calibration: Calibration, report_progress: Callable[[str], None]) -> dict[str, Any]:
    """All figures of the slopes."""
    report_progress("slopes per pixel")
    image = _image(calibration, plan.large)
    inverse_map = at_size(calibration.inverse.map, plan.large)
    methods: dict[str, Callable[[], Any]] = {
        "ours": lambda: estimate_slopes(inverse_map, image),
        "plain numpy": lambda: inverse_map.gradients(image),
    }
    if has_torch():
        methods |= network_methods(image.values, cores())
    figures = side_by_side(methods, min(plan.rounds, 3))
    found, expected = methods["ours"](), methods["plain numpy"]()
    figures["ours"]["mean_difference_to_numpy_deg"] = _mean_difference_deg(found, expected)
    figures["ours"]["share_of_other_pixels"] = float((found.valid != expected.valid).mean())
    small = _image(calibration, plan.small)
    small_map = at_size(calibration.inverse.map, plan.small)
    figures["small"] = side_by_side({"ours": lambda: estimate_slopes(small_map, small)}, plan.rounds)
    return figures


def _image(calibration: Calibration, shape: Shape) -> NormalizedImage:
    """Intensities of a ball press, enlarged to (H, W), with pixel noise."""
    picture = next(press.picture for press in calibration.presses if press.picture is not None)
    intensity = np.asarray((picture / 255.0) ** 1.25 / 0.45, np.float32)
    enlarged = cv2.resize(intensity, shape[::-1], interpolation=cv2.INTER_LINEAR)
    values = np.asarray(np.random.default_rng(0).standard_normal(enlarged.shape), np.float32)
    values *= np.float32(0.01)
    values += enlarged
    return NormalizedImage(values, np.ones(shape, bool), np.zeros(shape, bool))


def _mean_difference_deg(found: GradientField, expected: GradientField) -> float:
    """Mean angle between the normals of both surfaces where both are valid, degrees."""
    both = found.valid & expected.valid
    a, b = (np.stack([-g.p[both], -g.q[both], np.ones(both.sum(), np.float32)]) for g in (found, expected))
    cross = np.linalg.norm(np.cross(a, b, axis=0), axis=0)
    return float(np.degrees(np.arctan2(cross, (a * b).sum(axis=0))).mean())
