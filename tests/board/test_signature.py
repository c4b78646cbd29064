"""A release is installed only as its maker signed it: no changed byte, no added file, no other key gets through."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SLOT = "board/retrograph-slot"
SIGNERS = "etc/retrograph/release-signers"

Run = Callable[..., subprocess.CompletedProcess[str]]
Release = Callable[..., Path]

pytestmark = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="ssh-keygen is not installed")


def new_key(path: Path) -> Path:
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "", "-f", path], check=True)
    return path


def seal(folder: Path, *key: Path) -> None:
    subprocess.run(["bash", ROOT / ".ci/seal", folder, *key], check=True, capture_output=True)


@pytest.fixture
def key(tmp_path: Path) -> Path:
    return new_key(tmp_path / "maker")


@pytest.fixture
def signed(release: Release, key: Path) -> Callable[[str], Path]:
    """Makes a signed release of a version, with packages beside it."""

    def make(version: str) -> Path:
        folder = release(version)
        (folder / "wheels").mkdir()
        (folder / "wheels" / "numpy-2.0.whl").write_bytes(b"a package")
        seal(folder, key)
        return folder

    return make


@pytest.fixture
def app(fresh: Path, signed: Callable[[str], Path], run: Run) -> Path:
    """A device that knows the maker's key and runs version 1.0."""
    folder = signed("1.0")
    (fresh / "etc/default/retroscan").write_text("RETROSCAN_BOARD=twin\n")
    (fresh / "etc/retrograph").mkdir()
    shutil.copy(folder.parent / "release-signers", fresh / SIGNERS)
    assert run(SLOT, "install", folder).returncode == 0
    return fresh / "data/app"


def changed_byte(path: Path) -> None:
    data = path.read_bytes() or b"\0"
    path.write_bytes(bytes([data[0] ^ 1]) + data[1:])


def signed_by(folder: Path, key: Path, namespace: str) -> None:
    (folder / "SHA256SUMS.sig").unlink()
    command = ["ssh-keygen", "-q", "-Y", "sign", "-f", key, "-n", namespace, folder / "SHA256SUMS"]
    subprocess.run(command, check=True, capture_output=True)


HARMS: dict[str, Callable[[Path, Path], object]] = {
    "a byte of the wheel": lambda folder, _: changed_byte(next(folder.glob("*.whl"))),
    "a byte of the lock": lambda folder, _: changed_byte(folder / "requirements-device.lock"),
    "a byte of a package": lambda folder, _: changed_byte(folder / "wheels" / "numpy-2.0.whl"),
    "a byte of the list": lambda folder, _: changed_byte(folder / "SHA256SUMS"),
    "a byte of the signature": lambda folder, _: changed_byte(folder / "SHA256SUMS.sig"),
    "a file more": lambda folder, _: (folder / "wheels" / "evil-1.whl").touch(),
    "a file less": lambda folder, _: (folder / "wheels" / "numpy-2.0.whl").unlink(),
    "a link more": lambda folder, _: (folder / "link").symlink_to("/etc/passwd"),
    "a link for a file": lambda folder, outside: link_for_a_file(folder / "requirements-device.lock", outside),
    "no signature": lambda folder, _: (folder / "SHA256SUMS.sig").unlink(),
    "no list": lambda folder, _: (folder / "SHA256SUMS").unlink(),
    "neither": lambda folder, _: [path.unlink() for path in folder.glob("SHA256SUMS*")],
    "another key": lambda folder, outside: seal(folder, new_key(outside / "other")),
    "the key for another purpose": lambda folder, outside: signed_by(folder, outside / "maker", "git"),
    "sealed again without a key": lambda folder, _: (changed_byte(next(folder.glob("*.whl"))), seal(folder)),
}


def link_for_a_file(path: Path, outside: Path) -> None:
    path.rename(outside / "moved")
    path.symlink_to(outside / "moved")


def test_a_signed_release_is_installed(app: Path, run: Run, signed: Callable[[str], Path]) -> None:
    folder = signed("1.1")
    assert "nothing speaks against it" in run(SLOT, "verify", folder).stdout
    ran = run(SLOT, "install", folder)
    assert ran.returncode == 0, ran.stderr
    assert (app / "current" / "ready").read_text() == "1.1\n"
    assert not (app / "incoming").exists()


@pytest.mark.parametrize("harm", HARMS)
def test_what_its_maker_did_not_sign_is_refused_before_anything_is_unpacked(
    app: Path, run: Run, signed: Callable[[str], Path], tmp_path: Path, harm: str
) -> None:
    folder = signed("1.1")
    HARMS[harm](folder, tmp_path)
    for command in ("verify", "install"):
        ran = run(SLOT, command, folder)
        assert ran.returncode == 2
        assert ran.stderr.count("\n") == 1
        assert re.search("nothing was installed; (remove it, and )?fetch the release again", ran.stderr)
    assert (app / "current" / "ready").read_text() == "1.0\n"
    assert sorted(path.name for path in app.iterdir()) == ["a", "current", "lock"]


def test_without_known_keys_a_changed_byte_is_refused_all_the_same(fresh: Path, run: Run, release: Release) -> None:
    folder = release("1.0")
    seal(folder)
    changed_byte(next(folder.glob("*.whl")))
    assert "is not what its SHA256SUMS says" in run(SLOT, "install", folder).stderr
    seal(folder)
    (fresh / "etc/default/retroscan").write_text("RETROSCAN_BOARD=twin\n")
    assert run(SLOT, "install", folder).returncode == 0


@pytest.fixture
def whole(tmp_path: Path, key: Path) -> Path:
    """A release folder with install.sh in it, signed."""
    folder = tmp_path / "dist" / "release"
    for name in ("board", "systemd"):
        shutil.copytree(ROOT / name, folder / name)
    seal(folder, key)
    return folder


def install(run: Run, fresh: Path, folder: Path, *more: str | Path) -> subprocess.CompletedProcess[str]:
    script = str(folder / "board" / "install.sh")
    return run(script, "--root", fresh, "--board", "pi5-imx296", "--no-app", *more)


@pytest.mark.skipif(shutil.which("systemd-sysusers") is None, reason="systemd is not installed")
def test_install_proves_itself_before_it_changes_anything(fresh: Path, run: Run, whole: Path, tmp_path: Path) -> None:
    signers = whole.parent / "release-signers"
    stranger = tmp_path / "strangers"
    stranger.write_text(f"retrograph-release {new_key(tmp_path / 'other').with_suffix('.pub').read_text()}")
    ran = install(run, fresh, whole, "--signers", stranger)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "is not signed by a key of" in ran.stderr
    assert not (fresh / SIGNERS).exists()
    assert install(run, fresh, whole, "--signers", signers).returncode == 0
    assert (fresh / SIGNERS).read_bytes() == signers.read_bytes()
    before = sorted(fresh.rglob("*"))
    changed_byte(whole / "systemd" / "retroscan.service")
    ran = install(run, fresh, whole)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "is not what its SHA256SUMS says" in ran.stderr
    assert sorted(fresh.rglob("*")) == before
    assert run("board/install.sh", "--root", fresh, "--uninstall").returncode == 0
    assert not (fresh / SIGNERS).exists()


def test_the_bill_names_every_package_of_the_lock_with_its_hashes(tmp_path: Path) -> None:
    lock = (ROOT / "requirements-device.lock").read_text()
    (tmp_path / "requirements-device.lock").write_text(lock)
    (tmp_path / "retrograph-0.1.0-py3-none-any.whl").write_bytes(b"wheel")
    bills = []
    for _ in range(2):
        subprocess.run([sys.executable, ROOT / ".ci/sbom.py", tmp_path], check=True)
        bills.append((tmp_path / "sbom.cdx.json").read_bytes())
    assert bills[0] == bills[1]
    bill = json.loads(bills[0])
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    named = {part["name"]: part for part in bill["components"]}
    pins = [line.split(" ")[0].split("==") for line in lock.splitlines() if line[:1].isalpha()]
    assert set(named) == {name for name, _ in pins} | {"three"}
    assert all(named[name]["version"] == version for name, version in pins)
    held = [one["value"] for part in named.values() for one in part["properties"] if one["name"].endswith("sha256")]
    assert len(held) == lock.count("--hash=sha256:")
    assert bill["metadata"]["component"]["version"] == "0.1.0"


def test_the_tools_of_make_lock_are_pinned_by_hash() -> None:
    pinned = (ROOT / ".ci" / "uv.lock").read_text()
    assert "--hash=sha256:" in pinned
    makefile = (ROOT / "Makefile").read_text()
    assert "--require-hashes --only-binary :all: -r .ci/uv.lock" in makefile
    assert '"uv==' not in makefile
