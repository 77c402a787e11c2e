# shellcheck shell=sh disable=SC2154,SC2034 # variables of install.sh, which sources this
# The Python environment: built beside the one that is there, put in its place at once, and taken back.
. "$here/venv.sh"

VERSION='from gateway.build import version; print(version())'
EXCHANGE='
import ctypes, os, sys
one, other = map(os.fsencode, sys.argv[1:])
sys.exit(ctypes.CDLL(None, use_errno=True).renameat2(-100, one, -100, other, 2) != 0)' # AT_FDCWD, RENAME_EXCHANGE

# Is what is there built of the very same, for the same?
up_to_date() {
    [ -f "$root/.drivegate" ] && grep -qxF "of $fingerprint" "$root/.drivegate" &&
        "$root/bin/python" -I -c 'import gateway.config' 2>/dev/null
}

fingerprint() {
    {
        echo "$kind $PREFIX $(python3 -V) $(command -v "$(compiler)" || true)"
        if [ -f "$source" ]; then
            cat "$source"
        else
            cat "$source/pyproject.toml" "$here/constraints.txt" "$here/compile_core.py"
            for directory in "$source/drivers" "$source/gateway" "$source/replay" "$here/robots"; do
                find "$directory" -type f ! -name '*.pyc' | sort | xargs -r -d '\n' cat
            done
        fi
    } | sha256sum | cut -d' ' -f1
}

compiler() { echo "${CC:-cc}" | cut -d' ' -f1; }

check_environment() {
    python_is_new || die "nothing was changed"
    case $(python3 -c 'import sys; print(sys.base_prefix)') in
        /root/* | /home/*) die "python3 is in a home directory, which others cannot see: use Debian's" ;;
    esac
    if [ -e "$root" ] && [ ! -e "$root/.drivegate" ]; then
        die "$root exists and was not built by this script: choose another --prefix"
    fi
    [ -e "$source" ] || die "--wheel = $source: there is no such file"
    [ -z "$wheels" ] || [ -d "$wheels" ] || die "--wheelhouse = $wheels: there is no such directory"
}

check_room() {
    mkdir -p "$(dirname "$root")"
    case $kind in client) wanted=200 ;; robot) wanted=1200 ;; desk) wanted=1500 ;; esac
    room=$(df -Pm "$(dirname "$root")" | awk 'NR == 2 { print $4 }')
    [ "$room" -ge "$wanted" ] ||
        die "$(dirname "$root") has room for $room MB, and building takes $wanted MB for a moment; nothing was changed"
}

build_environment() {
    say "building the environment, which takes some minutes"
    rm -rf "$root.new"
    mkdir -p "$root.new.tmp" # beside it: what /tmp has room for, nobody knows
    make_venv "$root.new" "$wheels" || die "no environment could be made in $root.new; nothing was changed"
    pip_install || explain_pip
    rm -rf "$root.new.tmp"
    if [ "$kind" = robot ]; then "$root.new/bin/python" -I "$here/drop_viewer.py"; fi
    # Scripts and configuration name the place where the environment will be, not the one where it was built.
    grep -lIr --exclude-dir=lib --exclude-dir=lib64 "$root.new" "$root.new" | xargs -r sed -i "s|$root.new|$PREFIX|g"
    # Some packages carry old syntax.
    "$root.new/bin/python" -m compileall -q -s "$root.new" -p "$PREFIX" "$root.new/lib" >/dev/null || true
    {
        echo "built by install.sh; uninstall.sh removes this directory"
        printf '%s\n' "for $kind" "of $fingerprint"
    } >"$root.new/.drivegate"
}

pip_install() {
    set -- --disable-pip-version-check --no-compile -c "$here/constraints.txt"
    [ -z "$wheels" ] || set -- "$@" --no-index --find-links "$wheels"
    case $kind in
        client) CC=none && export CC && set -- "$@" "$source" ;; # it has no use for a core that is fast
        *) set -- "$@" "${source}[$kind]" ;;
    esac
    TMPDIR="$root.new.tmp" "$root.new/bin/pip" install "$@" >"$work/pip.out" 2>"$work/pip"
}

# What of pip's words a person needs, and what to do. Which package is missing of those that have a fixed version, it only
# tells at length.
explain_pip() {
    sed -n '/^The conflict is caused by/,/^$/p' "$work/pip.out" >&2
    grep -v "^WARNING: " "$work/pip" | tail -5 >&2
    room=$(df -Pm "$(dirname "$root")" | awk 'NR == 2 { print $4 }')
    case $(cat "$work/pip") in
        *"No space left"*) why="the disk is full ($room MB are left of it)" ;;
        *"No matching distribution"* | *"ResolutionImpossible"* | *"NewConnectionError"* | *"NameResolution"* | *"timed out"*)
            why="a package could not be had: is there a network? Without one, see \"Without a network\" in deploy/README.md"
            [ -z "$wheels" ] || why="$wheels lacks a package: make it again with deploy/wheelhouse.py --for $kind, for this computer"
            ;;
        *) why="pip failed" ;;
    esac
    die "$why; nothing was changed"
}

# exchange ONE OTHER: each gets the other's place, at no moment is there none (or in two steps, where that is not to be had)
exchange() {
    python3 -I -c "$EXCHANGE" "$1" "$2" 2>/dev/null && return 0
    mv "$1" "$1.other"
    mv "$2" "$1"
    mv "$1.other" "$2"
}

# The environment that was there is kept, with the files that belong to it.
swap_environment() {
    if [ -e "$root" ]; then
        # Of one that was killed there may be such a directory, into which this one would be moved.
        [ ! -e "$root.old" ] || { rm -rf "$root.older" && mv "$root.old" "$root.older"; }
        cp "$work/before.tar" "$root/files.tar"
        ignore_signals
        mv "$root.new" "$root.old"
        exchange "$root.old" "$root"
    else
        ignore_signals
        mv "$root.new" "$root"
    fi
    swapped=yes
    heed_signals
}

# As it was before the swap, however far that came, or before a --rollback.
swap_back() {
    if [ "$swapped" = yes ]; then
        if [ -e "$root.old" ]; then exchange "$root.old" "$root"; else rm -rf "$root"; fi
    fi
    [ "$rollback" = no ] || return 0
    if [ "$swapped" = yes ] || [ -e "$root.older" ]; then rm -rf "$root.old"; fi
    [ ! -e "$root.older" ] || mv "$root.older" "$root.old"
}
