"""The device-tree overlay compiles, applies to a small tree with a Pi's labels, and agrees with wiring and profiles."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from hal.board_profile import load_board_profile
from hal.profile_tables import profile_names

BOARD = Path(__file__).parents[2] / "board"
OVERLAY = BOARD / "overlay" / "retrograph.dts"
BASE = """/dts-v1/;
/ {
    compatible = "raspberrypi,4-model-b", "brcm,bcm2711";
    soc {
        gpio: gpio@7e200000 { compatible = "brcm,bcm2711-gpio"; gpio-controller; #gpio-cells = <2>; };
        i2c1: i2c@7e804000 { compatible = "brcm,bcm2835-i2c"; status = "disabled"; };
    };
};
"""
needs_dtc = pytest.mark.skipif(
    shutil.which("dtc") is None or shutil.which("fdtoverlay") is None, reason="device-tree-compiler is not installed"
)


def numbers(property_name: str) -> list[int]:
    found = re.search(rf"{property_name} = <([\d ]+)>", OVERLAY.read_text(encoding="utf-8"))
    assert found, property_name
    return [int(word) for word in found[1].split()]


@pytest.fixture
def applied(tmp_path: Path) -> str:
    """The tree after the overlay, as source."""
    base, overlay, both = tmp_path / "base.dtb", tmp_path / "retrograph.dtbo", tmp_path / "both.dtb"
    (tmp_path / "base.dts").write_text(BASE)
    subprocess.run(["dtc", "-@", "-q", "-I", "dts", "-O", "dtb", "-o", base, tmp_path / "base.dts"], check=True)
    compiled = subprocess.run(
        ["dtc", "-@", "-I", "dts", "-O", "dtb", "-o", overlay, OVERLAY], capture_output=True, text=True, check=True
    )
    assert compiled.stderr == ""
    subprocess.run(["fdtoverlay", "-i", base, "-o", both, overlay], check=True)
    source = subprocess.run(["dtc", "-q", "-I", "dtb", "-O", "dts", both], capture_output=True, text=True, check=True)
    return source.stdout


@needs_dtc
def test_it_applies(applied: str) -> None:
    key = applied[applied.index("retrograph-power-fail {") :]
    assert 'compatible = "gpio-keys"' in key
    assert "linux,code = <0x74>" in key
    bus = applied[applied.index("i2c@7e804000 {") :]
    assert 'status = "okay"' in bus[: bus.index("}")]
    gpio_handle = re.search(r"gpio@7e200000 \{.*?phandle = <(0x\w+)>", applied, re.DOTALL)
    assert gpio_handle
    assert f"gpios = <{gpio_handle[1]} 0x16 0x01>" in key


def test_it_names_the_lines_that_are_wired() -> None:
    wiring = tomllib.loads((BOARD / "wiring" / "wiring.toml").read_text(encoding="utf-8"))
    assert numbers("brcm,pins") == [wiring["power_fail"]["line"]]
    configured = (BOARD / "config.txt").read_text(encoding="utf-8")
    pins = {int(line): state for line, state in re.findall(r"^gpio=(\d+)=(\S+)", configured, re.MULTILINE)}
    (button, indicator), dark = list(pins)[:2], list(pins)[2:]
    profiles = [load_board_profile(name) for name in profile_names()]
    wired = [profile for profile in profiles if profile.button is not None]
    assert {profile.button.line for profile in wired if profile.button} == {button}
    enables = {p.light_driver.chip: p.light_driver.enable_line for p in wired if p.light_driver}
    assert sorted(enables.values(), key=str) == sorted(dark, key=str)
    # As the chips' pins are: OE is active low, RESET too, and both rest where nothing shines.
    assert {chip: pins[line] for chip, line in enables.items() if line} == {"PCA9955B": "ip,pu", "TLC59116": "ip,pd"}
    lines = {profile.indicator.line for profile in wired if profile.indicator}
    assert lines - {None} == {indicator}
    assert (numbers("brcm,function"), numbers("brcm,pull")) == ([0], [2])


def test_config_txt_says_what_the_drivers_need() -> None:
    lines = (BOARD / "config.txt").read_text(encoding="utf-8").splitlines()
    assert {"camera_auto_detect=1", "dtparam=i2c_arm=on", "dtoverlay=retrograph", "dtparam=watchdog=on"} <= set(lines)
    sections = [line for line in lines if line.startswith("[")]
    assert sections[-1] == "[all]", "what is appended must not fall into one board's section"
    assert not any(line.startswith("dtoverlay=cma") for line in lines), "it would shrink what vc4-kms-v3d keeps"
    assert max(map(len, lines)) < 98, "the firmware cuts longer lines"
