# shellcheck shell=bash disable=SC2154
# How install.sh changes anything: every change is said, done unless this is a dry run, and done by rename, so that a file is
# there whole or as it was. install.sh sets root, dry, changes and scratch.

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
    swap_in "$2"
}
# FILE.new, wholly on the disk, takes the place of FILE.
swap_in() {
    ! live || sync "$1.new"
    mv -T "$1.new" "$1"
    ! live || sync "$(dirname "$1")"
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
