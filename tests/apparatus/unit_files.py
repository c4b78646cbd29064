"""The project's systemd units, parsed like systemd does."""

from __future__ import annotations

from pathlib import Path

SYSTEMD = Path(__file__).parents[2] / "systemd"
INSTRUMENTS = ("retroscan.service", "retroscan-tui.service")

Settings = dict[str, list[str]]


def unit_files() -> list[Path]:
    """Every service, mount and path of the project."""
    return sorted(path for path in SYSTEMD.iterdir() if path.suffix in {".service", ".mount", ".path"})


def settings(name: str) -> Settings:
    """Settings of a unit, each key with all its values."""
    found: Settings = {}
    for line in (SYSTEMD / name).read_text(encoding="utf-8").splitlines():
        if "=" in line and not line.startswith(("#", "[")):
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found
