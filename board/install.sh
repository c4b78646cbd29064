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

  --board NAME        board profile, such as pi5-imx296, or a .toml file
  --data DEVICE       the data partition (ext4); `folder`: a folder of the root file system, for trying out
                      [the partition labelled retrograph-data]
  --screen panel      the TUI on the first virtual terminal; `none`: button and indicator alone [none]
  --usb               the USB port is a network adapter to the workstation
  --read-only         from the next boot on the root file system is read only, under an overlay in memory
  --release FOLDER    wheel, requirements-device.lock and maybe wheels/ [the one that this script is in, else dist/release]
  --no-app            everything but the program
  --uninstall         take away what this script put in place; scans, calibrations, keys and users stay
  --root DIR          work on the tree DIR instead of this machine (starts nothing, installs no package)
  --dry-run           say what would be done, and do nothing
END
    exit 2
}

here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
root='' board='' data='' screen=none release='' dry=no usb=no read_only=no with_app=yes uninstall=no changes=0

while [ $# -gt 0 ]; do
    case $1 in
    --board | --data | --screen | --release | --root)
        [ -n "${2:-}" ] || usage
        printf -v "${1#--}" '%s' "$2"
        shift
        ;;
    --usb) usb=yes ;;
    --read-only) read_only=yes ;;
    --no-app) with_app=no ;;
    --uninstall) uninstall=yes ;;
    --dry-run) dry=yes ;;
    *) usage ;;
    esac
    shift
done

include=$'\n[all]\ninclude retrograph.txt\n'

say() { printf '%s\n' "$*"; }
refuse() {
    printf 'install.sh: %s\n' "$1" >&2
    exit 2
}
live() { [ -z "$root" ]; }

# Says what is done, and does it unless this is a dry run.
act() {
    changes=$((changes + 1))
    say "  $1"
    shift
    [ "$dry" = yes ] || "$@"
}

# put SOURCE TARGET [MODE]: the target is a copy of the source, whole or as it was.
put() {
    local target=$root$2 mode=${3:-644}
    if cmp -s "$1" "$target" && [ "$(stat -c %a "$target")" = "$mode" ]; then return; fi
    act "write $2" copy "$1" "$target" "$mode"
}
# Runs a talkative command; what it said is shown when it fails.
quietly() {
    "$@" >"$scratch/said" 2>&1 || {
        cat "$scratch/said" >&2
        return 1
    }
}
copy() {
    install -d -m 755 "$(dirname "$2")"
    install -m "$3" "$1" "$2.new"
    mv "$2.new" "$2"
}
# put_text TARGET MODE: the same, from standard input.
put_text() {
    cat >"$scratch/text"
    put "$scratch/text" "$1" "${2:-644}"
}
folder() { # TARGET MODE [OWNER]
    local target=$root$1
    [ -d "$target" ] || act "make $1" install -d -m "$2" "$target"
    [ -z "${3:-}" ] || [ "$(id -u)" != 0 ] || [ "$dry" = yes ] || ! live || chown "$3:$3" "$target"
}
link() { # TO TARGET
    [ "$(readlink "$root$2" 2>/dev/null)" = "$1" ] || act "link $2" make_link "$1" "$root$2"
}
make_link() {
    install -d -m 755 "$(dirname "$2")"
    ln -sfn "$1" "$2.new"
    mv -T "$2.new" "$2"
}

# --- what it looks at before it does anything ---------------------------------------------------------------------------

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
    if [ "$(findmnt -n -o FSTYPE / 2>/dev/null)" = overlay ] && [ "$dry" = no ]; then
        refuse "the root file system is read only: run this inside \`sudo overlayroot-chroot\`, then reboot"
    fi
}

check_wishes() {
    [ -n "$board" ] || usage
    case $board in
    *.toml) [ -r "$board" ] || refuse "$board: cannot be read" ;;
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
    /dev/*) ;;
    *) refuse "--data $data: a device such as /dev/sda1, or the word folder" ;;
    esac
    [ "$with_app" = no ] || check_release
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

# --- the steps ----------------------------------------------------------------------------------------------------------

install_packages() {
    local wanted=(python3-venv openssh-server avahi-daemon systemd-timesyncd device-tree-compiler) missing=() package
    ! grep -q '^driver = "picamera2"' "$(profile_file)" || wanted+=(python3-picamera2)
    [ "$read_only" = no ] || wanted+=(overlayroot)
    if ! live; then
        say "  (packages are not installed into --root: ${wanted[*]})"
        return
    fi
    for package in "${wanted[@]}"; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
    done
    [ ${#missing[@]} = 0 ] || act "install ${missing[*]}" apt_install "${missing[@]}"
}
apt_install() {
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

make_users() {
    put "$here/systemd/sysusers-retrograph.conf" /etc/sysusers.d/retrograph.conf
    if ! grep -qs '^retrosync:' "$root/etc/passwd"; then
        act "make the users retroscan and retrosync" quietly systemd-sysusers ${root:+--root="$root"}
    fi
    # Where sshd goes without PAM, an account with a '!' is refused even by key; '*' is no password either.
    if live && [ "$dry" = no ] && grep -q '^retrosync:!' /etc/shadow; then usermod -p '*' retrosync; fi
}

mount_data() {
    if [ "$data" = folder ]; then
        folder /data 755
    else
        sed "s|^What=.*|What=$data|; s|dev-disk-by.x2dlabel-retrograph.x2ddata|$(escaped "$data")|g" \
            "$here/systemd/data.mount" | put_text /etc/systemd/system/data.mount
        folder /data 755
        if live && [ "$dry" = no ] && ! mountpoint -q /data; then
            systemctl daemon-reload
            systemctl start data.mount || refuse "$data cannot be mounted: is it ext4? (mkfs.ext4 -L retrograph-data $data)"
        fi
    fi
    local part
    folder /data/store 750 retroscan
    folder /data/pairing 750 retroscan
    # The host key itself is 0600; its public half is read by the instrument's user when a workstation pairs.
    for part in journal timesync app ssh; do folder "/data/$part" 755; done
    folder /data/network 700
    keep_what_was_there
    for part in "$here"/systemd/{var,etc,srv}-*.mount; do put "$part" "/etc/systemd/system/$(basename "$part")"; done
}
# The unit name of a path, as systemd writes it, without needing systemd: the few characters that a device's path has.
escaped() { printf '%s' "${1#/}" | sed 's/-/\\\\x2d/g; s|/|-|g'; }

# Scans of a card that was used before, networks, and the host key that workstations may know: copied once, never moved.
keep_what_was_there() {
    take_over /var/lib/retroscan store
    take_over /var/lib/retroscan-pairing pairing
    take_over /etc/NetworkManager/system-connections network
    if [ -f "$root/etc/ssh/ssh_host_ed25519_key" ] && [ ! -L "$root/etc/ssh/ssh_host_ed25519_key" ] &&
        [ ! -e "$root/data/ssh/ssh_host_ed25519_key" ]; then
        act "keep the host key" cp -a "$root/etc/ssh/ssh_host_ed25519_key" "$root/etc/ssh/ssh_host_ed25519_key.pub" "$root/data/ssh/"
    fi
    local name
    name=$(cat "$root/etc/hostname" 2>/dev/null || true)
    case $name in '' | raspberrypi | localhost | debian) ;; *)
        [ -e "$root/data/hostname" ] || put_text /data/hostname <<<"$name"
        ;;
    esac
}
take_over() {
    local from=$root$1 to=$root/data/$2
    if [ -d "$from" ] && ! { live && mountpoint -q "$from"; } && [ -n "$(ls -A "$from")" ] && [ -z "$(ls -A "$to" 2>/dev/null)" ]; then
        act "copy $1 to /data/$2" cp -a "$from/." "$to/"
    fi
}

put_files() {
    local unit
    for unit in "$here"/systemd/*.service "$here"/systemd/*.path; do put "$unit" "/etc/systemd/system/$(basename "$unit")"; done
    put "$here/systemd/tmpfiles-retrograph.conf" /etc/tmpfiles.d/retrograph.conf
    put "$here/systemd/journald-retrograph.conf" /etc/systemd/journald.conf.d/retrograph.conf
    put "$here/systemd/system-retrograph.conf" /etc/systemd/system.conf.d/retrograph.conf
    put "$here/systemd/logind-retrograph.conf" /etc/systemd/logind.conf.d/retrograph.conf
    put "$here/systemd/timesyncd-retrograph.conf" /etc/systemd/timesyncd.conf.d/retrograph.conf
    put "$here/systemd/sshd-retrograph.conf" /etc/ssh/sshd_config.d/retrograph.conf
    put "$here/systemd/avahi-retrograph.xml" /etc/avahi/services/retrograph.service
    put "$here/systemd/first-boot" /usr/local/lib/retrograph/first-boot 755
    put "$here/systemd/usb-gadget" /usr/local/lib/retrograph/usb-gadget 755
    put "$here/board/retrograph-slot" /usr/local/sbin/retrograph-slot 755
    put "$here/board/99-retrograph.rules" /etc/udev/rules.d/99-retrograph.rules
    [ "$usb" = no ] || put "$here/systemd/usb-network.nmconnection" /data/network/retrograph-usb.nmconnection 600
    local name=$board
    case $board in *.toml)
        put "$board" /etc/retrograph/board.toml
        name=/etc/retrograph/board.toml
        ;;
    esac
    put_text /etc/default/retroscan <<<"RETROSCAN_BOARD=$name"
    is_twin || put "$here/systemd/wait-for-i2c.conf" /etc/systemd/system/retroscan.service.d/i2c.conf
    is_twin || put "$here/systemd/wait-for-i2c.conf" /etc/systemd/system/retroscan-tui.service.d/i2c.conf
    link /data/app/current/bin/retroscan /usr/local/bin/retroscan
    link /data/ssh/ssh_host_ed25519_key /etc/ssh/ssh_host_ed25519_key
    link /data/ssh/ssh_host_ed25519_key.pub /etc/ssh/ssh_host_ed25519_key.pub
}

boot_folder() {
    local folder
    for folder in /boot/firmware /boot; do
        if [ -f "$root$folder/config.txt" ]; then
            echo "$folder"
            return
        fi
    done
}

set_up_firmware() {
    local boot
    boot=$(boot_folder)
    if [ -z "$boot" ]; then
        say "  (no config.txt: this is no Raspberry Pi, its firmware is left alone)"
        return
    fi
    { cat "$here/board/config.txt" && { [ "$usb" = no ] || echo "dtoverlay=dwc2,dr_mode=peripheral"; }; } | put_text "$boot/retrograph.txt" 755
    if command -v dtc >/dev/null; then
        dtc -@ -q -I dts -O dtb -o "$scratch/overlay" "$here/board/overlay/retrograph.dts"
        put "$scratch/overlay" "$boot/overlays/retrograph.dtbo" 755
    else
        say "  (dtc is not there yet: retrograph.dtbo is compiled by the next run)"
    fi
    grep -qx 'include retrograph.txt' "$root$boot/config.txt" ||
        act "include retrograph.txt in $boot/config.txt" append "$root$boot/config.txt" "$include"
    [ "$read_only" = no ] || set_overlay "$root$boot/cmdline.txt" overlayroot=tmpfs:recurse=0
}
append() { { cat "$1" && printf '%s' "$2"; } >"$1.new" && mv "$1.new" "$1"; }

# The kernel's command line is one line; recurse=0 leaves the data partition as it is.
set_overlay() {
    [ -f "$1" ] || return 0
    local line
    line=$(sed 's/ *overlayroot=[^ ]*//g' "$1")
    line="$line${2:+ $2}"
    [ "$(cat "$1")" = "$line" ] || act "write ${1#"$root"}" rewrite "$1" "$line"
}
rewrite() { printf '%s\n' "$2" >"$1.new" && mv "$1.new" "$1"; }

install_program() {
    if [ "$with_app" = no ]; then return; fi
    local wheel version current
    wheel=$(find "$release" -maxdepth 1 -name 'retrograph-*.whl' 2>/dev/null | head -n 1)
    version=$(basename "${wheel:-none-none}" | cut -d - -f 2)
    current=$(cat "$root/data/app/current/ready" 2>/dev/null || true)
    if [ -n "$current" ] && [ "$current" = "$version" ]; then return; fi
    act "install version $version from $release" \
        env RETROGRAPH_ROOT="$root" bash "$here/board/retrograph-slot" install "$release"
}

units() {
    echo data.mount srv-retrograph-store.mount retrograph-first-boot.service retrograph-trial.service
    echo retrograph-power.service retrograph-poweroff.path
    (cd "$here/systemd" && ls var-*.mount etc-*.mount)
    [ "$usb" = no ] || echo retrograph-usb.service
    if [ "$screen" = panel ]; then echo retroscan-tui.service; else echo retroscan.service; fi
}
other_instrument() { if [ "$screen" = panel ]; then echo retroscan.service; else echo retroscan-tui.service; fi; }

enable_units() {
    local unit wanted=()
    while read -r unit; do
        [ "$dry" = yes ] || [ -e "$root/etc/systemd/system/$unit" ] || continue
        is_enabled "$unit" || wanted+=("$unit")
    done < <(units | tr ' ' '\n')
    [ ${#wanted[@]} = 0 ] || act "enable ${wanted[*]}" systemctl ${root:+--root="$root"} --quiet enable "${wanted[@]}"
    ! is_enabled "$(other_instrument)" ||
        act "disable $(other_instrument)" systemctl ${root:+--root="$root"} --quiet disable "$(other_instrument)"
    # Nothing ever waits for a network or for the time.
    for unit in NetworkManager-wait-online.service systemd-networkd-wait-online.service systemd-time-wait-sync.service; do
        [ "$(readlink "$root/etc/systemd/system/$unit" 2>/dev/null)" = /dev/null ] ||
            act "mask $unit" systemctl ${root:+--root="$root"} --quiet mask "$unit"
    done
}
is_enabled() { find "$root/etc/systemd/system" -path '*.wants/*' -name "${1//\\/\\\\}" 2>/dev/null | grep -q .; }

start_now() {
    live && [ -d /run/systemd/system ] && [ "$dry" = no ] || return 0
    systemctl daemon-reload
    systemd-tmpfiles --create /etc/tmpfiles.d/retrograph.conf
    systemctl try-reload-or-restart systemd-journald ssh avahi-daemon 2>/dev/null || true
    # Bus and lines that are there already get the groups that the rules name.
    udevadm control --reload 2>/dev/null && udevadm trigger --subsystem-match=i2c-dev --subsystem-match=gpio || true
}

# --- and back -----------------------------------------------------------------------------------------------------------

installed_files() {
    local unit
    for unit in "$here"/systemd/*.service "$here"/systemd/*.path "$here"/systemd/*.mount; do
        echo "/etc/systemd/system/$(basename "$unit")"
    done
    for unit in retroscan retroscan-tui; do echo "/etc/systemd/system/$unit.service.d/i2c.conf"; done
    for unit in tmpfiles.d sysusers.d systemd/journald.conf.d systemd/system.conf.d systemd/logind.conf.d \
        systemd/timesyncd.conf.d ssh/sshd_config.d; do echo "/etc/$unit/retrograph.conf"; done
    echo /etc/avahi/services/retrograph.service /etc/udev/rules.d/99-retrograph.rules /etc/default/retroscan \
        /etc/retrograph/board.toml /usr/local/lib/retrograph/first-boot /usr/local/lib/retrograph/usb-gadget \
        /usr/local/sbin/retrograph-slot /usr/local/bin/retroscan /data/network/retrograph-usb.nmconnection \
        /boot/firmware/retrograph.txt /boot/firmware/overlays/retrograph.dtbo /boot/retrograph.txt \
        /boot/overlays/retrograph.dtbo | tr ' ' '\n'
}

take_away() {
    local unit path boot
    for unit in "$here"/systemd/*.service "$here"/systemd/*.path "$here"/systemd/*.mount; do
        unit=$(basename "$unit")
        if live && [ -d /run/systemd/system ] && [ "$dry" = no ]; then
            case $unit in data.mount) ;; *) systemctl stop "$unit" 2>/dev/null || true ;; esac
        fi
        ! is_enabled "$unit" || act "disable $unit" systemctl ${root:+--root="$root"} --quiet disable "$unit"
    done
    for unit in NetworkManager-wait-online.service systemd-networkd-wait-online.service systemd-time-wait-sync.service; do
        [ "$(readlink "$root/etc/systemd/system/$unit" 2>/dev/null)" != /dev/null ] ||
            act "unmask $unit" systemctl ${root:+--root="$root"} --quiet unmask "$unit"
    done
    give_back_host_key
    while read -r path; do
        if [ -e "$root$path" ] || [ -L "$root$path" ]; then act "remove $path" rm -f "$root$path"; fi
    done < <(installed_files)
    boot=$(boot_folder)
    if [ -n "$boot" ]; then
        ! grep -qx 'include retrograph.txt' "$root$boot/config.txt" ||
            act "restore $boot/config.txt" drop_include "$root$boot/config.txt"
        set_overlay "$root$boot/cmdline.txt" ''
    fi
    [ ! -d "$root/data/app" ] || act "remove the program" rm -rf "${root:?}/data/app"
    say "Scans, calibrations and keys stay in /data (store, pairing, ssh), as do the users retroscan and retrosync."
}
# The exact undoing of `append`; where more was written after it, the one line goes.
drop_include() {
    local text
    text=$(cat "$1" && echo x)
    text=${text%x}
    case $text in
    *"$include") printf '%s' "${text%"$include"}" >"$1.new" ;;
    *) printf '%s' "$text" | sed '/^include retrograph\.txt$/d' >"$1.new" ;;
    esac
    mv "$1.new" "$1"
}
give_back_host_key() {
    local file
    for file in ssh_host_ed25519_key ssh_host_ed25519_key.pub; do
        [ -L "$root/etc/ssh/$file" ] || continue
        act "give back /etc/ssh/$file" rm -f "$root/etc/ssh/$file"
        [ "$dry" = yes ] || [ ! -f "$root/data/ssh/$file" ] || cp -a "$root/data/ssh/$file" "$root/etc/ssh/$file"
    done
}

# --- the walk -----------------------------------------------------------------------------------------------------------

check_machine
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

if [ "$uninstall" = yes ]; then
    say "Taking Retrograph away:"
    take_away
    if live && [ -d /run/systemd/system ] && [ "$dry" = no ]; then systemctl daemon-reload; fi
    exit
fi

check_wishes
say "Retrograph for board $board${root:+ in $root}:"
install_packages
make_users
mount_data
put_files
set_up_firmware
enable_units
install_program
start_now
case $changes in
0) say "Everything is in place." ;;
*) if [ "$dry" = yes ]; then say "$changes things would be done."; else say "Done. Reboot, or: systemctl isolate multi-user.target"; fi ;;
esac
