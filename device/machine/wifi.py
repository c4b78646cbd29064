"""Wi-Fi through NetworkManager's `nmcli`, whose terse output is meant for programs.

A password goes to nmcli's standard input as a `passwd-file`; the profile that is being tried has a name of its own, so
that a failure leaves every known network as it was.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from device.errors import MachineError
from device.machine.interfaces import Security, WifiNetwork

JOIN_S: Final = 45
"""Time that NetworkManager may take to join a network, s."""

TRIED: Final = "retrograph: "
"""Begins the names of profiles that were made here."""

MIN_PASSWORD, MAX_PASSWORD = 8, 63

_NOT_RUNNING: Final = 8
"""Exit code of nmcli without NetworkManager."""

_REASONS: Final = (
    ("secrets were required", "the password of {name} is wrong: try again"),
    ("network could not be found", "{name} is out of range: go closer to its access point and try again"),
    (
        "ip configuration could not be reserved",
        "{name} gave no address: try again, or ask its administrator",
    ),
    ("insufficient privileges", "this user may not join a network: run board/install.sh again for its rule"),
    ("not authorized", "this user may not join a network: run board/install.sh again for its rule"),
    ("timeout", "{name} did not answer within {seconds} s: go closer to its access point and try again"),
)
"""Words of nmcli, and what is said instead."""


class NetworkManagerWifi:
    """Wi-Fi of a machine with NetworkManager.

    Parameters
    ----------
    program : nmcli, by name or path
    """

    def __init__(self, program: str = "nmcli") -> None:
        self._program = program

    def active(self) -> str | None:
        """Return the present network; errors as for `Wifi.active`."""
        self._check_adapter()
        rows = self._rows("ACTIVE,SSID", "device", "wifi", "list", "--rescan", "no")
        return next((name for is_active, name in rows if is_active == "yes"), None)

    def networks(self) -> tuple[WifiNetwork, ...]:
        """Return networks in range, each once with its strongest access point."""
        self._check_adapter()
        found: dict[str, WifiNetwork] = {}
        fields = "ACTIVE,SIGNAL,SECURITY,SSID"
        for is_active, signal, security, name in self._rows(fields, "device", "wifi", "list", "--rescan", "auto"):
            seen = found.get(name)
            if name:
                strength = max(int(signal or 0) / 100.0, seen.signal if seen else 0.0)
                is_ours = is_active == "yes" or (seen is not None and seen.is_active)
                found[name] = WifiNetwork(name, strength, _security_of(security), is_ours)
        return tuple(sorted(found.values(), key=lambda network: -network.signal))

    def join(self, network: WifiNetwork, password: str) -> None:
        """Join a network; errors as for `Wifi.join`."""
        if network.security == "unsupported":
            raise MachineError(f"{network.name} needs a user account or is not safe: join another network")
        self._check_adapter()
        before = self._profiles_of(network.name)
        profile = self._add_profile(network, password)
        try:
            feed = f"802-11-wireless-security.psk:{_escaped(password)}\n" if password else ""
            secret = ("passwd-file", "/dev/stdin") if password else ()
            self._run("--wait", str(JOIN_S), "connection", "up", "uuid", profile, *secret, feed=feed, name=network.name)
        except MachineError:
            with suppress(MachineError):
                self._run("connection", "delete", "uuid", profile)
            raise
        for older in before:
            with suppress(MachineError):
                self._run("connection", "delete", "uuid", older)

    def _add_profile(self, network: WifiNetwork, password: str) -> str:
        """Return the id of a new profile of a network, without its password."""
        known = {uuid for uuid, _, _ in self._profiles()}
        kind = ("connection", "add", "type", "wifi", "ifname", "*", "con-name", f"{TRIED}{network.name}")
        secured = ("wifi-sec.key-mgmt", "wpa-psk") if password else ()
        self._run(*kind, "ssid", network.name, *secured, name=network.name)
        added = [uuid for uuid, name, _ in self._profiles() if name == f"{TRIED}{network.name}" and uuid not in known]
        if not added:
            raise MachineError(f"NetworkManager did not keep the network {network.name}: try again")
        return added[0]

    def _profiles_of(self, name: str) -> list[str]:
        """Return ids of the known profiles of a network."""
        wireless = [uuid for uuid, _, kind in self._profiles() if kind == "802-11-wireless"]
        return [uuid for uuid in wireless if self._ssid(uuid) == name]

    def _ssid(self, uuid: str) -> str:
        shown = self._run("-g", "802-11-wireless.ssid", "-e", "no", "connection", "show", "uuid", uuid)
        return shown.removesuffix("\n")

    def _profiles(self) -> list[list[str]]:
        return self._rows("UUID,NAME,TYPE", "connection", "show")

    def _check_adapter(self) -> None:
        """Refuse a machine without Wi-Fi; switch on what was switched off."""
        states = self._adapter_states()
        if "unavailable" in states:
            self._run("radio", "wifi", "on")
            states = self._adapter_states()
        if not states:
            raise MachineError("this machine has no Wi-Fi adapter")
        if states == ["unavailable"]:
            raise MachineError("Wi-Fi is blocked: set its country once (raspi-config, Localisation), then try again")

    def _adapter_states(self) -> list[str]:
        return [state for kind, state in self._rows("TYPE,STATE", "device") if kind == "wifi"]

    def _rows(self, fields: str, *arguments: str) -> list[list[str]]:
        """Return the fields of each line of a terse answer."""
        lines = self._run("-t", "-f", fields, *arguments).splitlines()
        rows = [_split(line) for line in lines]
        return [row for row in rows if len(row) == fields.count(",") + 1]

    def _run(self, *arguments: str, feed: str = "", name: str = "the network") -> str:
        try:
            return run_program([self._program, *arguments], feed=feed, timeout_s=JOIN_S + 15.0)
        except ProgramFailed as error:
            if error.code == _NOT_RUNNING:
                raise MachineError("NetworkManager is not running on this machine: it joins networks") from error
            said = error.said.casefold()
            for words, sentence in _REASONS:
                if words in said:
                    raise MachineError(sentence.format(name=name, seconds=JOIN_S)) from error
            raise MachineError(f"{name} was not joined: {error.said.removeprefix('Error: ')}") from error


def password_complaint(password: str) -> str:
    """Return what is wrong with a password of WPA; empty if nothing is."""
    if MIN_PASSWORD <= len(password.encode()) <= MAX_PASSWORD:
        return ""
    return f"a Wi-Fi password has {MIN_PASSWORD} to {MAX_PASSWORD} characters"


def _security_of(words: str) -> Security:
    """Return what nmcli's column SECURITY means, such as "WPA2 802.1X"."""
    names = set(words.replace("--", "").split())
    if not names:
        return "open"
    return "password" if names & {"WPA1", "WPA2"} and "802.1X" not in names else "unsupported"


def _split(line: str) -> list[str]:
    """Return the fields of a terse line, in which a backslash protects colons and itself."""
    fields, is_escaped = [""], False
    for letter in line:
        if is_escaped or letter not in "\\:":
            fields[-1] += letter
            is_escaped = False
        elif letter == ":":
            fields.append("")
        else:
            is_escaped = True
    return fields


def _escaped(password: str) -> str:
    """Return the password for a `passwd-file`, which trims blanks and reads backslashes: most bytes in octal."""
    return "".join(chr(byte) if chr(byte).isalnum() and byte < 128 else f"\\{byte:03o}" for byte in password.encode())


# Runs the system's own programs; nothing secret is ever an argument, because every user can read those.

TIMEOUT_S: Final = 20.0


class ProgramFailed(MachineError):
    """A program of the system refused; `said` is what it wrote, `code` its exit code."""

    def __init__(self, sentence: str, said: str, code: int) -> None:
        super().__init__(sentence)
        self.said = said
        self.code = code


def run_program(arguments: Sequence[str], *, feed: str = "", timeout_s: float = TIMEOUT_S) -> str:
    """Run a program and return its output.

    Parameters
    ----------
    arguments : the program and its arguments
    feed : written to its standard input

    Raises
    ------
    ProgramFailed
        It ended with an error.
    MachineError
        It is not installed, or did not end within `timeout_s`.
    """
    program = arguments[0]
    found = shutil.which(program)
    if found is None:
        raise MachineError(f"{program} is not installed on this machine: install it, or change this setting elsewhere")
    environment = {**os.environ, "LC_ALL": "C.UTF-8", "SYSTEMD_PAGER": "", "SYSTEMD_COLORS": "0"}
    try:
        ran = subprocess.run(  # noqa: S603
            [found, *arguments[1:]],
            input=feed,
            capture_output=True,
            text=True,
            errors="replace",
            env=environment,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise MachineError(f"{program} did not answer within {timeout_s:.0f} s: try again") from error
    except OSError as error:
        raise MachineError(f"{program} cannot be started: {error.strerror}") from error
    if ran.returncode:
        said = " ".join((ran.stderr or ran.stdout).split())
        raise ProgramFailed(f"{program}: {said or 'failed without a word'}", said, ran.returncode)
    return ran.stdout
