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
}

# A read-only root. Its command line is the last thing that install.sh writes: whatever was interrupted before leaves the root writable.
initramfs_modules=/usr/share/initramfs-tools/modules.d/retrograph
initramfs_check=/etc/initramfs/post-update.d/zz-retrograph
end_writing() { # BOOT-FOLDER
    local drop_in
    put "$here/board/initramfs/modules" $initramfs_modules
    put "$here/board/initramfs/check" $initramfs_check 755
    ! live || make_initramfs "$1"
    drop_in=$(boot_drop_in "$1")
    put_text "$drop_in" <<<$'[Mount]\nOptions=ro'
    set_overlay "$root$1/cmdline.txt" overlayroot=tmpfs:recurse=0
}
boot_drop_in() { echo "/etc/systemd/system/$(escaped "$1").mount.d/retrograph.conf"; }

# Every kernel that is installed gets an initramfs with the overlay, and every initramfs that the firmware may load is looked at. On
# bookworm `update-initramfs -u` alone leaves out that of a Pi 5 (raspberrypi/bookworm-feedback, issue 326).
make_initramfs() { # BOOT-FOLDER
    local version image images=()
    for version in "$root"/lib/modules/*/; do
        version=$(basename "$version")
        image=$root/boot/initrd.img-$version
        [ -e "$root/boot/vmlinuz-$version" ] || continue
        images+=("$image")
        if [ ! -e "$image" ] || ! bash "$here/board/initramfs/check" - "$image" 2>/dev/null; then
            act "make the initramfs of kernel $version" update_initramfs "$version" "$image"
        fi
    done
    for image in "$root$1"/initramfs* "$root$1"/initrd.img*; do
        [ ! -e "$image" ] || images+=("$image")
    done
    [ "$dry" = no ] || return 0
    [ ${#images[@]} != 0 ] || not_read_only "there is no initramfs in $1 or /boot, which an overlay needs"
    bash "$here/board/initramfs/check" - "${images[@]}" || not_read_only "an initramfs cannot mount an overlay"
}
update_initramfs() { # VERSION IMAGE
    local how=-c
    [ ! -e "$2" ] || how=-u
    quietly update-initramfs $how -k "$1" || not_read_only "update-initramfs $how -k $1 failed"
}
not_read_only() {
    printf 'install.sh: %s: the root file system stays writable\n' "$1" >&2
    exit 1
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
    local ours
    ! live || [ "$dry" = yes ] || ! mountpoint -q "$boot" || mount -o remount,rw "$boot"
    set_overlay "$root$boot/cmdline.txt" ''
    for ours in "$swap_in_memory" "$(boot_drop_in "$boot")"; do
        [ ! -e "$root$ours" ] || act "remove $ours" remove_below_overlay "$ours"
    done
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
