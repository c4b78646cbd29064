# shellcheck shell=bash disable=SC2154
# The steps of an installation, each doing only what is missing. install.sh sets here, root, board, data and the other wishes.

install_packages() {
    local wanted=(python3-venv openssh-server avahi-daemon systemd-timesyncd) missing=() package
    [ -z "$(boot_folder)" ] || wanted+=(device-tree-compiler)
    ! grep -q '^driver = "picamera2"' "$(profile_file)" || wanted+=(python3-picamera2)
    [ "$read_only" = no ] || wanted+=(overlayroot)
    [ "$screen" = none ] || wanted+=(kbd console-setup-linux polkitd)
    if ! live; then
        say "  (packages are not installed into --root: ${wanted[*]})"
        return
    fi
    for package in "${wanted[@]}"; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
    done
    [ ${#missing[@]} = 0 ] || act "install ${missing[*]}" apt_install "${missing[@]}"
}
# What a power cut left half installed is finished first: apt-get would refuse to begin.
apt_install() {
    export DEBIAN_FRONTEND=noninteractive
    if ! { dpkg --configure -a && apt-get update -qq && apt-get install -y -qq --no-install-recommends "$@"; } >/dev/null; then
        refuse "the packages $* could not be installed: is there a network? Run the same command again; what is done stays"
    fi
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
        put_text /etc/systemd/system/data.mount < <(
            sed "s|^What=.*|What=$data|; s|dev-disk-by.x2dlabel-retrograph.x2ddata|$(escaped "$data")|g" \
                "$here/systemd/data.mount"
        )
        folder /data 755
        if live && [ "$dry" = no ] && ! mountpoint -q /data; then
            mount -t ext4 -o noatime,nosuid,nodev "$data" /data ||
                refuse "$data cannot be mounted: is it ext4? (mkfs.ext4 -L retrograph-data $data)"
        fi
    fi
    local part
    folder /data/store 750 retroscan
    folder /data/pairing 750 retroscan
    # The host key itself is 0600; its public half is read by the instrument's user when a workstation pairs.
    for part in journal timesync app ssh; do folder "/data/$part" 755; done
    folder /data/network 700
    ! has_netplan || folder /data/netplan 755
    keep_what_was_there
    for part in "$here"/systemd/{var,etc,srv}-*.mount; do put "$part" "/etc/systemd/system/$(basename "$part")"; done
}
has_netplan() { [ -x "$root/usr/libexec/netplan/generate" ]; }
# The unit name of a path, as systemd writes it, without needing systemd: the few characters that a device's path has.
escaped() { printf '%s' "${1#/}" | sed 's/-/\\\\x2d/g; s|/|-|g'; }

# Scans of a card that was used before, networks, and the host key that workstations may know: copied once, never moved.
keep_what_was_there() {
    take_over /var/lib/retroscan store
    take_over /var/lib/retroscan-pairing pairing
    add_networks /etc/NetworkManager/system-connections network
    ! has_netplan || add_networks /etc/netplan netplan
    if [ -f "$root/etc/ssh/ssh_host_ed25519_key" ] && [ ! -L "$root/etc/ssh/ssh_host_ed25519_key" ] &&
        [ ! -e "$root/data/ssh/ssh_host_ed25519_key" ]; then
        act "keep the host key" keep_host_key
    fi
    local name
    name=$(cat "$root/etc/hostname" 2>/dev/null || true)
    case $name in '' | raspberrypi | localhost | debian) ;; *)
        [ -e "$root/data/hostname" ] || put_text /data/hostname <<<"$name"
        ;;
    esac
}
# The key last: where it is, its public half is too.
keep_host_key() {
    local part
    for part in .pub ''; do
        cp -a "$root/etc/ssh/ssh_host_ed25519_key$part" "$root/data/ssh/ssh_host_ed25519_key$part.new"
        swap_in "$root/data/ssh/ssh_host_ed25519_key$part"
    done
}
take_over() {
    local from=$root$1 to=$root/data/$2
    if [ -d "$from" ] && ! { live && mountpoint -q "$from"; } && [ -n "$(ls -A "$from")" ] && [ -z "$(ls -A "$to" 2>/dev/null)" ]; then
        act "copy $1 to /data/$2" copy_folder "$from" "$to"
    fi
}
# Each network of this card that the data partition, maybe of an earlier card, does not know; what is there stays as it is.
# Imager gives its network the same name on every card: where two differ, that of this card gets a name of its own, which
# sorts after the other, so that of netplan's two passwords for one network the newer counts.
add_networks() { # PLACE FOLDER-OF-DATA
    local file name own to=$root/data/$2
    if live && mountpoint -q "$1"; then return; fi
    for file in "$root$1"/*.*; do
        name=$(basename "$file")
        case $name in *.new | retrograph-usb.nmconnection) continue ;; esac
        if [ ! -s "$file" ] || cmp -s "$file" "$to/$name"; then continue; fi
        if [ ! -e "$to/$name" ]; then
            act "copy the network $name to /data/$2" copy_network "$file" "$to/$name"
        else
            own="${name%.*}_$(sha256sum <"$file" | cut -c 1-8).${name##*.}"
            [ -e "$to/$own" ] ||
                act "copy the network $name to /data/$2/$own, beside another one of its name" copy_network "$file" "$to/$own"
        fi
    done
}
copy_network() { cp -a "$1" "$2.new" && swap_in "$2"; }
# An empty folder becomes a copy, at once: half a copy would be taken for all of it by the next run.
copy_folder() {
    rm -rf "$2.new"
    cp -a "$1" "$2.new"
    sync -f "$2.new"
    [ ! -d "$2" ] || rmdir "$2"
    mv -T "$2.new" "$2"
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
    [ ! -d "$root/etc/NetworkManager" ] ||
        put "$here/systemd/networkmanager-retrograph.conf" /etc/NetworkManager/conf.d/retrograph.conf
    [ "$screen" = none ] || put "$here/systemd/polkit-retrograph.rules" /etc/polkit-1/rules.d/50-retrograph.rules
    put "$here/systemd/avahi-retrograph.xml" /etc/avahi/services/retrograph.service
    put "$here/systemd/first-boot" /usr/local/lib/retrograph/first-boot 755
    put "$here/systemd/usb-gadget" /usr/local/lib/retrograph/usb-gadget 755
    put "$here/board/retrograph-slot" /usr/local/sbin/retrograph-slot 755
    put "$here/board/99-retrograph.rules" /etc/udev/rules.d/99-retrograph.rules
    [ -z "$signers" ] || put "$signers" /etc/retrograph/release-signers
    [ "$usb" = no ] || put "$here/systemd/usb-network.nmconnection" /data/network/retrograph-usb.nmconnection 600
    local name=$board
    case $board in *.toml)
        put "$board" /etc/retrograph/board.toml
        name=/etc/retrograph/board.toml
        ;;
    esac
    put_text /etc/default/retroscan <<<"RETROSCAN_BOARD=$name"
    for unit in retroscan retroscan-tui retrograph-trial; do
        is_twin || put "$here/systemd/wait-for-i2c.conf" "/etc/systemd/system/$unit.service.d/i2c.conf"
    done
    link /data/app/current/bin/retroscan /usr/local/bin/retroscan
    link /data/ssh/ssh_host_ed25519_key /etc/ssh/ssh_host_ed25519_key
    link /data/ssh/ssh_host_ed25519_key.pub /etc/ssh/ssh_host_ed25519_key.pub
}

# What cloud-init (Raspberry Pi OS trixie) had to do, it has done at the first boot; later it would only look, while
# everything else waits. Whoever switched it off themselves keeps their own file.
cloud_init_off=/etc/cloud/cloud-init.disabled
end_cloud_init() {
    [ -d "$root/etc/cloud" ] && [ ! -e "$root$cloud_init_off" ] || return 0
    if cloud_init_finished; then
        put_text $cloud_init_off <<<"by board/install.sh of Retrograph: this card is set up"
    else
        say "  (cloud-init has not finished its first boot: the next run switches it off)"
    fi
}

cloud_init_finished() { [ -n "$(find "$root/var/lib/cloud/instances" -name boot-finished -print -quit 2>/dev/null)" ]; }
# Below a read-only root it would find a card that was never set up, at every boot: no user, key or network would be kept.
cloud_init_s=600
wait_for_cloud_init() {
    cloud_init_is_at_work || return 0
    if [ "$dry" = yes ]; then
        say "  (cloud-init has not finished its first boot: --read-only waits for it)"
        return
    fi
    if live; then
        say "Waiting for cloud-init to set this card up, $((cloud_init_s / 60)) minutes at most."
        timeout "$cloud_init_s" cloud-init status --wait >/dev/null 2>&1 || true
    fi
    ! cloud_init_is_at_work ||
        refuse "cloud-init has not set this card up yet: let it boot to the end, then run the same command again, or leave --read-only away"
}
cloud_init_is_at_work() {
    [ -x "$root/usr/bin/cloud-init" ] && [ ! -e "$root$cloud_init_off" ] && [ ! -e "$root/run/cloud-init/disabled" ] &&
        ! cloud_init_finished
}

# Under an overlay in memory a swap file would take the memory that it is to give. Bookworm's is not made at a boot with an
# overlay, by a condition. Trixie's rpi-swap is told to use compressed memory alone, unless somebody chose no swap at all.
no_swap_file=/etc/systemd/system/dphys-swapfile.service.d/retrograph.conf
swap_in_memory=/etc/rpi/swap.conf.d/90-retrograph.conf
end_swap_files() {
    [ ! -e "$root/usr/sbin/dphys-swapfile" ] || put "$here/systemd/dphys-swapfile-retrograph.conf" $no_swap_file
    [ ! -e "$root/usr/lib/systemd/system-generators/rpi-swap-generator" ] ||
        grep -qsx 'Mechanism *= *none' "$root"/etc/rpi/swap.conf "$root"/etc/rpi/swap.conf.d/*.conf ||
        put "$here/systemd/rpi-swap-retrograph.conf" $swap_in_memory
}

# The same version number may stand on another wheel: what is installed is known by its hash.
install_program() {
    if [ "$with_app" = no ]; then return; fi
    local wheel version
    wheel=$(find "$release" -maxdepth 1 -name 'retrograph-*.whl' 2>/dev/null | head -n 1)
    version=$(basename "${wheel:-none-none}" | cut -d - -f 2)
    if [ -n "$wheel" ] && [ -s "$root/data/app/current/ready" ] &&
        [ "$(cat "$root/data/app/current/wheel" 2>/dev/null)" = "$(sha256sum <"$wheel" | cut -d ' ' -f 1)" ]; then
        return
    fi
    act "install version $version from $release" \
        env RETROGRAPH_ROOT="$root" bash "$here/board/retrograph-slot" install "$release"
}

# apt's camera libraries and the program's own numpy meet here for the first time: what does not fit is told now, not at the
# first press. A version that comes later is held to its self-test.
camera_is_loaded() {
    grep -q '^driver = "picamera2"' "$(profile_file)" && live && [ "$with_app" = yes ] && [ "$dry" = no ] || return 0
    "$root/data/app/current/bin/python" -c 'from hal.drivers.picamera_stack import load_picamera2; load_picamera2()' \
        >"$scratch/said" 2>&1 && return
    say "The camera cannot be used: $(tail -n 1 "$scratch/said" | sed 's/^[A-Za-z_.]*: //')"
    return 1
}

units() {
    echo data.mount srv-retrograph-store.mount retrograph-first-boot.service retrograph-trial.service
    echo retrograph-power.service retrograph-poweroff.path retrograph-rescue-key.service
    (cd "$here/systemd" && ls var-*.mount etc-NetworkManager-*.mount)
    ! has_netplan || echo etc-netplan.mount retrograph-networks.service
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
tell_of_ssh() {
    is_enabled ssh.service || is_enabled ssh.socket ||
        say "  (SSH is switched off: no workstation can fetch a scan before sudo systemctl enable --now ssh)"
}
is_enabled() { find "$root/etc/systemd/system" -path '*.wants/*' -name "${1//\\/\\\\}" 2>/dev/null | grep -q .; }

# Before the program, whose self-test and start want the mounts, folders, devices and units as they are now.
tell_the_system() {
    live && [ -d "$root/run/systemd/system" ] && [ "$dry" = no ] || return 0
    local unit
    systemctl daemon-reload
    (cd "$here/systemd" && echo ./*.mount) | tr ' ' '\n' | sed 's|^./||' | while read -r unit; do
        ! is_enabled "$unit" || systemctl start "$unit"
    done
    systemd-tmpfiles --create /etc/tmpfiles.d/retrograph.conf
    systemctl try-reload-or-restart systemd-journald ssh avahi-daemon 2>/dev/null || true
    # Bus and lines that are there already get the groups that the rules name.
    udevadm control --reload 2>/dev/null || true
    udevadm trigger --action=add --subsystem-match=backlight 2>/dev/null || true
    udevadm trigger --subsystem-match=i2c-dev --subsystem-match=gpio 2>/dev/null || true
}
