"""Peer: the network of the open-source kits, 5-32-32-32-2 on (R, G, B, x, y), in torch on the CPU.

Its weights are random; they do not affect its speed.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from device.surface import Float32Array

CHUNK = 1 << 16
"""Pixels per chunk: its activations stay in cache."""


def has_torch() -> bool:
    """Whether torch is installed."""
    return find_spec("torch") is not None


def network_methods(values: Float32Array, threads: int) -> dict[str, Callable[[], Any]]:
    """The network on intensities of shape (H, W, 3), all pixels at once (as it is used) and in chunks."""
    import torch

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    layers: list[torch.nn.Module] = []
    for inputs, outputs in ((5, 32), (32, 32), (32, 32)):
        layers += [torch.nn.Linear(inputs, outputs), torch.nn.ReLU()]
    network = torch.nn.Sequential(*layers, torch.nn.Linear(32, 2)).eval()
    pixels = torch.from_numpy(_with_places(values))

    def at_once() -> Any:
        with torch.inference_mode():
            return network(pixels)

    def in_chunks() -> Any:
        with torch.inference_mode():
            return torch.cat([network(chunk) for chunk in pixels.split(CHUNK)])

    return {"torch network": at_once, "torch network, chunked": in_chunks}


def _with_places(values: Float32Array) -> Float32Array:
    """Float32 array of shape (H W, 5): colour and position of every pixel."""
    rows, columns, _ = values.shape
    y, x = np.mgrid[:rows, :columns]
    place = np.stack([x / columns, y / rows], axis=-1).astype(np.float32)
    return np.concatenate([values, place], axis=-1).reshape(-1, 5)
