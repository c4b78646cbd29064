#!/bin/bash
# Makes a Retrograph handheld of a fresh Raspberry Pi OS Lite (64 bit; bookworm or trixie). Run it as root from a release
# folder (`make release`) or a checkout. It may be run again at any time, and after an interruption: it does what is missing.
# It never touches a scan, a calibration or a key of a paired workstation, not even with --uninstall.
#
# RETROGRAPH_PYTHON names the Python of the program's slots (tests).
set -euo pipefail

usage() {
    cat >&2 <<'END'
usage: sudo board/install.sh --board NAME [--data DEVICE|folder] [--screen panel|none] [--usb] [--read-only] [...]
       sudo board/install.sh --uninstall
       sudo board/install.sh --writable

  --board NAME        board profile, such as pi5-imx296, or a .toml file
  --data DEVICE       the data partition (ext4); `folder`: a folder of the root file system, for trying out
                      [the partition labelled retrograph-data]
  --screen panel      the TUI on the first virtual terminal; `none`: button and indicator alone [none]
  --usb               the USB port is a network adapter to the workstation
  --power-latch       the supply latches and switches off when GPIO 26 goes high (board/bill-of-materials.md)
  --read-only         from the next boot on the root file system is read only, under an overlay in memory, without a swap file
  --release FOLDER    wheel, requirements-device.lock and maybe wheels/ [the one that this script is in, else dist/release]
  --signers FILE      keys that may sign releases, from now on: what none of them signed is refused (`make release KEY=...`)
  --no-app            everything but the program
  --uninstall         take away what this script put in place; users, packages and what /data holds, networks with their passwords
                      too, stay: it says what
  --writable          from the next boot on the root file system is writable again, with its swap; nothing else is done
  --root DIR          work on the tree DIR instead of this machine (starts nothing, installs no package)
  --dry-run           say what would be done, and do nothing
END
    exit 2
}

here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
root='' board='' data='' screen=none release='' signers='' dry=no usb=no power_latch=no read_only=no writable=no with_app=yes uninstall=no changes=0

# shellcheck disable=SC2034 # what is set here is read in install/
while [ $# -gt 0 ]; do
    case $1 in
    --board | --data | --screen | --release | --signers | --root)
        [ -n "${2:-}" ] || usage
        printf -v "${1#--}" '%s' "$2"
        shift
        ;;
    --usb) usb=yes ;;
    --power-latch) power_latch=yes ;;
    --read-only) read_only=yes ;;
    --no-app) with_app=no ;;
    --uninstall) uninstall=yes ;;
    --writable) writable=yes ;;
    --dry-run) dry=yes ;;
    *) usage ;;
    esac
    shift
done

say() { printf '%s\n' "$*"; }
refuse() {
    printf 'install.sh: %s\n' "$1" >&2
    exit 2
}
live() { [ -z "$root" ]; }

# Before anything of this folder is read or installed: it is what its maker signed, by the program that is on this card already.
check_signature() {
    local known=$root/etc/retrograph/release-signers verifier=$here/board/retrograph-slot
    [ -z "$signers" ] || [ -r "$signers" ] || refuse "--signers $signers: cannot be read"
    if [ -e "$known" ] && [ -x "$root/usr/local/sbin/retrograph-slot" ]; then verifier=$root/usr/local/sbin/retrograph-slot; fi
    RETROGRAPH_ROOT="$root" bash "$verifier" verify "$here" >/dev/null || exit 2
    [ -z "$signers" ] || bash "$verifier" verify "$here" "$signers" >/dev/null || exit 2
}
[ "$uninstall" = yes ] || [ "$writable" = yes ] || check_signature

for part in actions steps firmware take-away; do
    # shellcheck source=/dev/null
    . "$here/board/install/$part.sh"
done

check_machine() {
    local os=$root/etc/os-release name
    if live && [ "$(id -u)" != 0 ] && [ "$dry" = no ]; then refuse "this needs root: sudo board/install.sh ..."; fi
    [ -z "$root" ] || [ -d "$root" ] || refuse "--root $root: is no folder"
    [ -r "$os" ] || refuse "$os: is not there, so this is no system to install on"
    # shellcheck disable=SC1090
    name=$(. "$os" && echo "${VERSION_CODENAME:-${ID:-unknown}}")
    case $name in
    bookworm | trixie) ;;
    *) refuse "this is '$name', but Raspberry Pi OS or Debian bookworm or trixie is needed" ;;
    esac
    live || return 0
    case $(uname -m) in
    aarch64 | x86_64) ;;
    *) refuse "this system is $(uname -m): flash the 64-bit Raspberry Pi OS Lite" ;;
    esac
    # Asked of the first process: in overlayroot-chroot neither the boot partition nor /data would be found.
    if grep -qs '^overlayroot / ' /proc/1/mounts && [ "$dry" = no ] && [ "$writable" = no ]; then
        refuse "the root file system is read only: run this with --writable, reboot, and run the same command again"
    fi
}

check_wishes() {
    [ -n "$board" ] || usage
    case $board in
    *.toml) [ -r "$board" ] || refuse "$board: cannot be read" ;;
    */*) refuse "--board $board: the name of a profile, or a .toml file" ;;
    *) [ -r "$here/board/$board.toml" ] ||
        refuse "there is no board profile '$board': $(cd "$here/board" && echo *.toml | sed 's/\.toml//g')" ;;
    esac
    case $screen in panel | none) ;; *) refuse "--screen $screen: panel or none" ;; esac
    if [ -z "$data" ]; then
        data=/dev/disk/by-label/retrograph-data
        if live && [ ! -e "$data" ] && [ "$dry" = no ]; then
            refuse "no partition is labelled retrograph-data: make one (docs/build.md), or name one with --data"
        fi
    fi
    case $data in
    folder) [ "$read_only" = no ] || refuse "--read-only needs a data partition: scans in a folder of an overlay would be lost" ;;
    *[!A-Za-z0-9/_.:+-]*) refuse "--data $data: such a name no device has" ;;
    /dev/*) ;;
    *) refuse "--data $data: a device such as /dev/sda1, or the word folder" ;;
    esac
    [ "$with_app" = no ] || check_release
    if [ "$read_only" = yes ]; then
        [ -f "$root$(boot_folder)/cmdline.txt" ] ||
            refuse "--read-only: neither /boot/firmware nor /boot holds config.txt and cmdline.txt: mount the boot partition"
        wait_for_cloud_init
    fi
}

check_release() {
    # In a release folder it stands in the middle of what it installs.
    if [ -z "$release" ]; then
        release=$here
        [ -n "$(find "$here" -maxdepth 1 -name 'retrograph-*.whl')" ] || release=$here/dist/release
    fi
    [ -d "$release" ] || [ "$dry" = yes ] || refuse "$release: is no folder: run \`make release\` first, or name one with --release"
}

is_twin() { grep -q '^driver = "twin"' "$(profile_file)"; }
profile_file() {
    case $board in *.toml) echo "$board" ;; *) echo "$here/board/$board.toml" ;; esac
}

finish() {
    [ "$changes" = 0 ] || [ "$dry" = yes ] || sync
    case $changes in
    0) say "Everything is in place." ;;
    *) if [ "$dry" = yes ]; then say "$changes things would be done."; else say "Done. Reboot."; fi ;;
    esac
}

check_machine
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

if [ "$uninstall" = yes ]; then
    say "Taking Retrograph away:"
    take_away
    if live && [ -d /run/systemd/system ] && [ "$dry" = no ]; then systemctl daemon-reload; fi
    exit
fi

if [ "$writable" = yes ]; then
    say "From the next boot on the root file system is writable:"
    make_writable
    finish
    exit
fi

check_wishes
say "Retrograph for board $board${root:+ in $root}:"
install_packages
make_users
mount_data
put_files
[ "$read_only" = no ] || end_swap_files
set_up_firmware
enable_units
tell_of_ssh
end_cloud_init
tell_the_system
install_program
[ "$read_only" = no ] || end_writing "$(boot_folder)"
works=yes
camera_is_loaded || works=no
finish
[ $works = yes ]
