# shellcheck shell=bash disable=SC2154
# The way back: what the steps put in place is taken away; scans, calibrations, keys and users stay.

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
    [ ! -d "$root/data/app" ] || act "remove the program" rm -rf "$root/data/app"
    say "Scans, calibrations and keys stay in /data (store, pairing, ssh), as do the users retroscan and retrosync."
}
give_back_host_key() {
    local file
    for file in ssh_host_ed25519_key ssh_host_ed25519_key.pub; do
        [ -L "$root/etc/ssh/$file" ] || continue
        act "give back /etc/ssh/$file" rm -f "$root/etc/ssh/$file"
        [ "$dry" = yes ] || [ ! -f "$root/data/ssh/$file" ] || cp -a "$root/data/ssh/$file" "$root/etc/ssh/$file"
    done
}
