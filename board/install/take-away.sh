# shellcheck shell=bash disable=SC2154
# The way back: what the steps put in place is taken away; scans, calibrations, keys and users stay.

installed_files() {
    local unit
    for unit in "$here"/systemd/*.service "$here"/systemd/*.path "$here"/systemd/*.mount; do
        echo "/etc/systemd/system/$(basename "$unit")"
    done
    for unit in retroscan retroscan-tui retrograph-trial; do echo "/etc/systemd/system/$unit.service.d/i2c.conf"; done
    for unit in tmpfiles.d sysusers.d modules-load.d systemd/journald.conf.d systemd/system.conf.d systemd/logind.conf.d \
        systemd/timesyncd.conf.d ssh/sshd_config.d NetworkManager/conf.d; do echo "/etc/$unit/retrograph.conf"; done
    echo /etc/avahi/services/retrograph.service /etc/udev/rules.d/99-retrograph.rules /etc/polkit-1/rules.d/50-retrograph.rules /etc/default/retroscan \
        /etc/retrograph/board.toml /etc/retrograph/release-signers /usr/local/lib/retrograph/first-boot /usr/local/lib/retrograph/usb-gadget \
        /usr/local/sbin/retrograph-slot /usr/local/bin/retroscan /data/network/retrograph-usb.nmconnection \
        /boot/firmware/retrograph.txt /boot/firmware/overlays/retrograph.dtbo /boot/retrograph.txt \
        /boot/overlays/retrograph.dtbo "$no_swap_file" "$swap_in_memory" \
        "$initramfs_modules" "$initramfs_check" "$(boot_drop_in /boot/firmware)" "$(boot_drop_in /boot)" | tr ' ' '\n'
}

# Outermost last. Whatever of them holds something stays.
installed_folders() {
    local part
    for part in retroscan retroscan-tui retrograph-trial; do echo "/etc/systemd/system/$part.service.d"; done
    for part in journald system logind timesyncd; do echo "/etc/systemd/$part.conf.d"; done
    dirname "$no_swap_file" "$swap_in_memory" "$(boot_drop_in /boot/firmware)" "$(boot_drop_in /boot)"
    echo /etc/polkit-1/rules.d /etc/polkit-1 | tr ' ' '\n'
    echo /etc/retrograph /usr/local/lib/retrograph /srv/retrograph/store /srv/retrograph /var/lib/retroscan \
        /var/lib/retroscan-pairing /data/{store,pairing,ssh,network,netplan,journal,timesync} /data | tr ' ' '\n'
}
is_empty() { [ -d "$root$1" ] && [ -z "$(ls -A "$root$1")" ] && ! { live && mountpoint -q "$1"; }; }

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
    give_back_networks
    while read -r path; do
        for path in "$path" "$path.new"; do
            if [ -e "$root$path" ] || [ -L "$root$path" ]; then act "remove $path" rm -f "$root$path"; fi
        done
    done < <(installed_files)
    boot=$(boot_folder)
    if [ -n "$boot" ]; then
        ! grep -qx 'include retrograph.txt' "$root$boot/config.txt" ||
            act "restore $boot/config.txt" drop_include "$root$boot/config.txt"
        set_overlay "$root$boot/cmdline.txt" ''
    fi
    if [ -f "$root$cloud_init_off" ] && grep -q Retrograph "$root$cloud_init_off"; then
        act "remove $cloud_init_off" rm -f "$root$cloud_init_off"
    fi
    [ ! -d "$root/data/app" ] || act "remove the program" rm -rf "$root/data/app"
    while read -r path; do
        ! is_empty "$path" || rmdir "$root$path"
    done < <([ "$dry" = yes ] || installed_folders)
    say_what_stays
}
say_what_stays() {
    local part place what stays=''
    while read -r part what; do
        place=$root/data/$part
        if [ -s "$place" ] && { [ ! -d "$place" ] || [ -n "$(ls -A "$place")" ]; }; then stays+=", $part ($what)"; fi
    done <<'END'
store scans and calibrations
pairing keys of workstations
ssh host key
network networks with their passwords
netplan networks with their passwords
hostname name
board number of the board
journal journal
timesync last known time
END
    say "The users retroscan and retrosync and every package stay${stays:+, and in /data: ${stays#, }}."
    case $stays in *passwords*) say "Before the data partition is given away, erase it." ;; esac
}
give_back_host_key() {
    local file
    for file in ssh_host_ed25519_key ssh_host_ed25519_key.pub; do
        [ -L "$root/etc/ssh/$file" ] || continue
        act "give back /etc/ssh/$file" give_back "$root/data/ssh/$file" "$root/etc/ssh/$file"
    done
}
# The link becomes the file that it leads to, at once; one that leads nowhere goes.
give_back() {
    if [ -f "$1" ]; then cp -a "$1" "$2.new" && swap_in "$2"; else rm -f "$2"; fi
}

# Networks that were set up since, or the device could not be reached any more.
give_back_networks() {
    give_back_files network nmconnection /etc/NetworkManager/system-connections
    give_back_files netplan yaml /etc/netplan
}
give_back_files() { # FOLDER-OF-DATA SUFFIX PLACE
    local file name place=$3
    # As long as ours is mounted there, what is copied would only come to where it is.
    if live && [ "$dry" = no ] && mountpoint -q "$place"; then refuse "$place is still mounted: reboot and run this again"; fi
    for file in "$root/data/$1"/*."$2"; do
        name=$(basename "$file")
        if [ -e "$file" ] && [ "$name" != retrograph-usb.nmconnection ] && ! cmp -s "$file" "$root$place/$name"; then
            act "give back the network $name" copy "$file" "$root$place/$name" 600
        fi
    done
}
