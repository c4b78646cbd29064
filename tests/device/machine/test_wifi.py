"""Wi-Fi through an executable in the place of nmcli: what it is asked, and what its refusals become."""

from collections.abc import Callable
from pathlib import Path

import pytest

from device.errors import MachineError
from device.machine.interfaces import WifiNetwork
from device.machine.wifi import NetworkManagerWifi, password_complaint

Fake = Callable[[str, str], Path]
Calls = Callable[[], list[str]]

HOME = WifiNetwork("Hall 3: left", 0.82, "password", is_active=False)
OPEN = WifiNetwork("visitors", 0.4, "open", is_active=False)

ANSWERS = r"""
case "$*" in
"-t -f TYPE,STATE device") printf 'ethernet:connected\nwifi:disconnected\n' ;;
*"ACTIVE,SSID device wifi list"*) printf 'no:visitors\nyes:Hall 3\\: left\n' ;;
*"device wifi list"*)
    printf '%s\n' 'no:40::visitors' 'no:61:WPA2:Hall 3\: left' 'no:82:WPA2 WPA3:Hall 3\: left' \
        'no:90:WPA2 802.1X:company' 'no:20:WEP:old' 'no:70:WPA2:' 'no:10:WPA3:new' ;;
"-t -f UUID,NAME,TYPE connection show")
    printf '%s\n' 'u-old:retrograph\: Hall 3\: left:802-11-wireless' 'u-lan:cable:802-3-ethernet' \
        'u-vis:guests:802-11-wireless'
    [ ! -e "$log.added" ] || echo 'u-new:retrograph\: Hall 3\: left:802-11-wireless'
    [ ! -e "$log.open" ] || echo 'u-new:retrograph\: visitors:802-11-wireless' ;;
*"connection show uuid u-old") echo 'Hall 3: left' ;;
*"connection show uuid u-vis") echo 'guests' ;;
"connection add"*visitors*) touch "$log.open" ;;
"connection add"*) touch "$log.added" ;;
*"connection up"*) cat >"$log"; FAILURE ;;
esac
"""


def wifi(fake: Fake, failure: str = ":") -> NetworkManagerWifi:
    return NetworkManagerWifi(str(fake("nmcli", ANSWERS.replace("FAILURE", failure))))


def test_networks_in_range_are_listed_once_strongest_first(fake: Fake) -> None:
    assert wifi(fake).networks() == (
        WifiNetwork("company", 0.9, "unsupported", is_active=False),
        HOME,
        OPEN,
        WifiNetwork("old", 0.2, "unsupported", is_active=False),
        WifiNetwork("new", 0.1, "unsupported", is_active=False),
    )


def test_the_present_network_is_named(fake: Fake) -> None:
    assert wifi(fake).active() == "Hall 3: left"


def test_a_password_goes_to_standard_input_and_never_to_the_command_line(
    fake: Fake, calls: Calls, tmp_path: Path
) -> None:
    wifi(fake).join(HOME, "a b:c\\1\u00e9 ")
    assert (tmp_path / "input").read_text() == "802-11-wireless-security.psk:a\\040b\\072c\\1341\\303\\251\\040\n"
    assert not [call for call in calls() if "a b:c" in call or "040b" in call]
    assert "--wait 45 connection up uuid u-new passwd-file /dev/stdin" in calls()
    assert calls()[-1] == "connection delete uuid u-old"  # the profile that was known before, now replaced


def test_an_open_network_needs_no_password(fake: Fake, calls: Calls, tmp_path: Path) -> None:
    wifi(fake).join(OPEN, "")
    assert "--wait 45 connection up uuid u-new" in calls()
    assert (tmp_path / "input").read_text() == ""
    assert not [call for call in calls() if "delete" in call or "key-mgmt" in call]


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ("Connection activation failed: Secrets were required, but not provided.", "the password of .* is wrong"),
        ("Connection activation failed: The Wi-Fi network could not be found", "is out of range"),
        ("Timeout expired (45 seconds)", "did not answer within 45 s"),
        ("Connection activation failed: Insufficient privileges", "this user may not join a network"),
        ("Connection activation failed: Carrier went off", "was not joined: Connection activation failed: Carrier"),
    ],
)
def test_a_failure_is_one_sentence_and_undone(fake: Fake, calls: Calls, said: str, sentence: str) -> None:
    with pytest.raises(MachineError, match=sentence):
        wifi(fake, f'echo "Error: {said}" >&2; exit 4').join(HOME, "long enough")
    assert calls()[-1] == "connection delete uuid u-new"
    assert "connection delete uuid u-old" not in calls()


def test_networks_that_cannot_be_joined_are_refused_before_anything_is_done(fake: Fake, calls: Calls) -> None:
    with pytest.raises(MachineError, match="company needs a user account or is not safe"):
        wifi(fake).join(WifiNetwork("company", 0.9, "unsupported", is_active=False), "")
    assert calls() == []


@pytest.mark.parametrize(
    ("script", "sentence"),
    [
        ("printf 'ethernet:connected\\n'", "this machine has no Wi-Fi adapter"),
        ('echo "Error: NetworkManager is not running." >&2; exit 8', "NetworkManager is not running"),
        ('[ "$1" != -t ] || echo wifi:unavailable', "Wi-Fi is blocked: set its country"),
    ],
)
def test_a_machine_without_wifi_says_why(fake: Fake, script: str, sentence: str) -> None:
    broken = NetworkManagerWifi(str(fake("nmcli", script)))
    for ask in (broken.active, broken.networks):
        with pytest.raises(MachineError, match=sentence):
            ask()


def test_a_radio_that_was_switched_off_is_switched_on(fake: Fake, calls: Calls) -> None:
    script = """case "$*" in
"radio wifi on") touch "$log" ;;
*TYPE,STATE*) if [ -e "$log" ]; then echo wifi:disconnected; else echo wifi:unavailable; fi ;;
esac"""
    assert NetworkManagerWifi(str(fake("nmcli", script))).active() is None
    assert "radio wifi on" in calls()


def test_a_machine_without_nmcli_says_so(tmp_path: Path) -> None:
    with pytest.raises(MachineError, match="nmcli is not installed on this machine"):
        NetworkManagerWifi(str(tmp_path / "nmcli")).networks()


def test_passwords_have_a_length() -> None:
    assert password_complaint("1234567") == password_complaint("x" * 64) != ""
    assert password_complaint("12345678") == password_complaint("x" * 63) == ""
