# shellcheck shell=bash disable=SC2154
# The boot partition: config.txt, the overlay, and the kernel's command line. Its file system knows neither owners nor modes.

include=$'\n[all]\ninclude retrograph.txt\n'

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
    put "$here/systemd/modules-retrograph.conf" /etc/modules-load.d/retrograph.conf
    put_text "$boot/retrograph.txt" 755 < <(
        sed "$(camera_overlay)" "$here/board/config.txt"
        [ "$usb" = no ] || echo "dtoverlay=dwc2,dr_mode=peripheral"
        [ "$power_latch" = no ] || echo "dtoverlay=gpio-poweroff,gpiopin=26"
    )
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
# The overlay of the profile's own sensor in place of a search: what is asked for is there, or named as missing. On a Pi 5 that
# is the connector CAM/DISP 1. Other drivers than picamera2 have no camera here.
camera_overlay() {
    ! grep -q '^driver = "picamera2"' "$(profile_file)" ||
        sed -n 's/^model = "\(IMX[0-9]*\)".*/s,^camera_auto_detect=1$,camera_auto_detect=0\\ndtoverlay=\L\1,/p' "$(profile_file)"
}
append() { { cat "$1" && printf '%s' "$2"; } >"$1.new" && swap_in "$1"; }

# The kernel's command line is one line; recurse=0 leaves the data partition as it is.
set_overlay() {
    [ -f "$1" ] || return 0
    local line
    line=$(sed 's/ *overlayroot=[^ ]*//g' "$1")
    line="$line${2:+ $2}"
    [ "$(cat "$1")" = "$line" ] || act "write ${1#"$root"}" rewrite "$1" "$line"
}
make_writable() {
    local boot
    boot=$(boot_folder)
    [ -n "$boot" ] || refuse "no config.txt: this is no Raspberry Pi, and --read-only did nothing here"
    set_overlay "$root$boot/cmdline.txt" ''
    [ ! -e "$root$swap_in_memory" ] || act "remove $swap_in_memory" remove_below_overlay "$swap_in_memory"
}
# What is removed from an overlay in memory is back at the next boot: it goes from the root below. The root comes first to be
# writable, whatever becomes of this.
remove_below_overlay() {
    if live && grep -qs '^overlayroot / ' /proc/1/mounts; then
        overlayroot-chroot rm -f "$1" >/dev/null 2>&1 || say "  (it could not be removed: do so after the reboot)"
    else
        rm -f "$root$1"
    fi
}
rewrite() { printf '%s\n' "$2" >"$1.new" && swap_in "$1"; }

# The exact undoing of `append`; where more was written after it, the one line goes.
drop_include() {
    local text
    text=$(cat "$1" && echo x)
    text=${text%x}
    case $text in
    *"$include") printf '%s' "${text%"$include"}" >"$1.new" ;;
    *) printf '%s' "$text" | sed '/^include retrograph\.txt$/d' >"$1.new" ;;
    esac
    swap_in "$1"
}
