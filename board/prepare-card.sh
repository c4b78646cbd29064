#!/bin/bash
# Gives a freshly flashed Raspberry Pi OS card (or image file) its data partition, before its first boot. That boot enlarges root to
# the card's end, so this must come first. With a partition behind root it leaves root as it is: bookworm's script looks at the table,
# trixie's resize_early asks parted, which refuses partitions that overlap. The word ` resize` of cmdline.txt stays: it also gives the
# card an identifier of its own.
#
# usage: sudo board/prepare-card.sh [--root-gib 8] DEVICE-or-IMAGE
#
# Root grows to that size; what is left becomes an ext4 partition labelled retrograph-data. Nothing but a card with exactly
# Raspberry Pi OS's two partitions is touched; one that has its data partition already is left as it is. After an interruption
# the same command goes on: the third partition is entered into the table last, when everything else is done.
set -euo pipefail

sector=512
root_gib=8

refuse() {
    printf 'prepare-card.sh: %s\n' "$1" >&2
    exit 2
}
usage() { refuse "usage: board/prepare-card.sh [--root-gib 8] DEVICE-or-IMAGE"; }

# One number or word of a partition (1 is the first) as sfdisk tells it.
of_partition() {
    sfdisk --dump "$card" 2>/dev/null | grep -E 'start=' | sed -n "$1p" | sed -n "s/.*$2= *\([^, ]*\).*/\1/p"
}
count_partitions() { sfdisk --dump "$card" 2>/dev/null | grep -c 'start=' || true; }
# A file system is named by its place on the card: no partition node is needed, and image files work as cards do.
label_at() { blkid --probe --offset "$(($1 * sector))" --match-tag LABEL --output value "$card" 2>/dev/null || true; }
# Nothing known begins there; 2 is blkid's word for that, and only for that.
is_blank_at() {
    local code=0
    blkid --probe --offset "$(($1 * sector))" "$card" >/dev/null 2>&1 || code=$?
    [ "$code" = 2 ]
}

case ${1:-} in
--root-gib)
    [[ ${2:-} =~ ^[0-9]+$ ]] || usage
    root_gib=$2
    shift 2
    ;;
esac
[ $# = 1 ] || usage
card=$1

[ -b "$card" ] || [ -f "$card" ] || refuse "$card: is neither a device nor an image file"
[ -w "$card" ] || refuse "$card: cannot be written; use sudo"
if [ -b "$card" ] && lsblk --noheadings --output MOUNTPOINTS "$card" | grep -q /; then
    refuse "$card: is mounted: unmount its partitions, and make sure that it is the card you mean"
fi

if [ "$(count_partitions)" = 3 ] && [ "$(label_at "$(of_partition 3 start)")" = retrograph-data ]; then
    echo "Everything is in place."
    exit
fi
count=$(count_partitions)
case $count in 2 | 3) ;; *) refuse "$card: holds $count partitions, not Raspberry Pi OS's two" ;; esac
root_start=$(of_partition 2 start)
[ "$(label_at "$root_start")" = rootfs ] || refuse "$card: its second partition is not Raspberry Pi OS's rootfs"

if [ -b "$card" ]; then size=$(blockdev --getsz "$card"); else size=$(($(stat -c %s "$card") / sector)); fi
root_end=$(((root_gib << 30) / sector + root_start))
data_start=$(((root_end + 8191) / 8192 * 8192))
if [ "$count" = 3 ] && ! { [ "$(of_partition 3 start)" = "$data_start" ] && is_blank_at "$data_start"; }; then
    refuse "$card: holds 3 partitions, not Raspberry Pi OS's two"
fi
[ $((size - data_start)) -gt $(((1 << 30) / sector)) ] ||
    refuse "$card: $((size * sector >> 30)) GiB are too small for a root of $root_gib GiB and a gigabyte of scans"
[ "$data_start" -ge $((root_start + $(of_partition 2 size))) ] || refuse "$card: root is larger than $root_gib GiB already"

echo "Root grows to $root_gib GiB, $(((size - data_start) * sector >> 30)) GiB become the data partition."
root_size=$((data_start - root_start))
echo ", $root_size" | sfdisk --quiet --no-reread --partno 2 "$card"
e2fsck -f -p "$card?offset=$((root_start * sector))" >/dev/null || [ $? -le 1 ]
resize2fs "$card?offset=$((root_start * sector))" "${root_size}s" >/dev/null 2>&1
# resize2fs takes an image file for root's alone and cuts it off there.
[ -b "$card" ] || truncate --size $((size * sector)) "$card"
mkfs.ext4 -q -F -L retrograph-data -E "offset=$((data_start * sector))" "$card" $(((size - data_start) * sector / 1024))k
sync
# Its file system is meant to be there: sfdisk need neither warn of it nor wipe it, as it would on a terminal.
if [ "$count" = 2 ]; then
    said=$(echo "$data_start, $((size - data_start)), L" |
        sfdisk --quiet --no-reread --wipe never --wipe-partitions never --append "$card" 2>&1) ||
        refuse "$card: its third partition could not be entered: ${said:-sfdisk says nothing}"
fi
sync
echo "Done: boot it, then sudo board/install.sh --board NAME"
