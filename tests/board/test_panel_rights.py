"""What the instrument's user may change of the machine from the panel: exactly that, and only with a panel."""

import re
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
RULES = "etc/polkit-1/rules.d/50-retrograph.rules"
ALLOWED = {
    "org.freedesktop.timedate1.set-time",
    "org.freedesktop.timedate1.set-timezone",
    "org.freedesktop.timedate1.set-ntp",
    "org.freedesktop.NetworkManager.network-control",
    "org.freedesktop.NetworkManager.settings.modify.system",
    "org.freedesktop.NetworkManager.enable-disable-wifi",
    "org.freedesktop.NetworkManager.wifi.scan",
}


def test_the_polkit_rule_allows_the_instruments_user_these_actions_alone() -> None:
    text = (ROOT / "systemd/polkit-retrograph.rules").read_text(encoding="utf-8")
    assert set(re.findall(r'"([^"]+)"', text)) == {*ALLOWED, "retroscan"}
    assert text.count("polkit.Result.YES") == 1
    assert 'if (subject.user === "retroscan" && allowed.indexOf(action.id) >= 0) return polkit.Result.YES;' in text
    assert text.count("{") == text.count("}")
    assert text.count("(") == text.count(")")
    user = re.search(
        r"^User=(\w+)$", (ROOT / "systemd/retroscan-tui.service").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert user is not None
    assert user[1] == "retroscan"


def test_the_rule_comes_with_the_panel(fresh: Path, run: Callable[..., object]) -> None:
    run("board/install.sh", "--root", fresh, "--board", "pi4-imx477", "--no-app", "--screen", "none")
    assert not (fresh / RULES).exists()
    run("board/install.sh", "--root", fresh, "--board", "pi4-imx477", "--no-app", "--screen", "panel")
    assert (fresh / RULES).read_bytes() == (ROOT / "systemd/polkit-retrograph.rules").read_bytes()
    run("board/install.sh", "--root", fresh, "--uninstall")
    assert not (fresh / "etc/polkit-1").exists()


def test_udev_lets_the_users_group_write_the_brightness_which_the_unit_can_reach() -> None:
    rules = (ROOT / "board/99-retrograph.rules").read_text(encoding="utf-8")
    (line,) = [line for line in rules.splitlines() if line.startswith('SUBSYSTEM=="backlight"')]
    assert "/bin/chgrp video /sys%p/brightness" in line
    assert "/bin/chmod g+w /sys%p/brightness" in line
    unit = (ROOT / "systemd/retroscan-tui.service").read_text(encoding="utf-8")
    assert re.search(r"^SupplementaryGroups=.*\bvideo\b", unit, re.MULTILINE)
    assert "ReadWritePaths=-/sys/devices\n" in unit
