"""The overlay on device trees of real boards, compiled from Debian's kernel source by tests/system/build."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

OVERLAY = Path(__file__).parents[2] / "board" / "overlay" / "retrograph.dts"


def applied(tree: Path, tmp_path: Path) -> subprocess.CompletedProcess[str]:
    overlay, both = tmp_path / "retrograph.dtbo", tmp_path / "both.dtb"
    subprocess.run(["dtc", "-@", "-q", "-I", "dts", "-O", "dtb", "-o", overlay, OVERLAY], check=True)
    command = ["fdtoverlay", "-i", tree, "-o", both, overlay]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def prop(tree: Path, node: str, name: str) -> str:
    said = subprocess.run(["fdtget", tree, node, name], capture_output=True, text=True, check=True)
    return said.stdout.strip()


@pytest.mark.parametrize("board", ["bcm2711-rpi-4-b", "bcm2837-rpi-zero-2-w"])
def test_it_applies_to_the_tree_of_a_board(system_cache: Path, tmp_path: Path, board: str) -> None:
    tree = system_cache / "trees" / f"{board}.dtb"
    ran = applied(tree, tmp_path)
    assert ran.returncode == 0, ran.stderr
    both = tmp_path / "both.dtb"
    gpio, bus = (prop(both, "/__symbols__", label) for label in ("gpio", "i2c1"))
    assert prop(both, bus, "status") == "okay"
    assert prop(both, bus, "clock-frequency") == "400000"
    assert prop(both, "/retrograph-power-fail", "compatible") == "gpio-keys"
    key = prop(both, "/retrograph-power-fail/power-fail", "gpios").split()
    assert key == [prop(both, gpio, "phandle"), "22", "1"]


def test_debians_tree_of_a_pi_5_has_no_header_yet(system_cache: Path, tmp_path: Path) -> None:
    """The chip behind its header came into the kernel later: a real Pi 5 has to show it (bench checklist)."""
    ran = applied(system_cache / "trees" / "bcm2712-rpi-5-b.dtb", tmp_path)
    assert "FDT_ERR_NOTFOUND" in ran.stderr
