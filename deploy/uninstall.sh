#!/bin/sh
# Removes what install.sh installed. Robot files and keys (/etc/drivegate), recordings (/var/lib/drivegate) and the user
# that owns them stay. Idempotent; prints what it removes.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
. "$here/common.sh"

while [ $# -gt 0 ]; do
    case $1 in
        --prefix)
            [ $# -ge 2 ] || die "--prefix needs a value"
            PREFIX=$2
            shift
            ;;
        *) echo "usage: [DESTDIR=ROOT] $0 [--prefix DIR]" >&2 && exit 2 ;;
    esac
    shift
done

remove() {
    for path in "$@"; do
        [ -e "$path" ] || [ -L "$path" ] || continue
        rm -rf "$path"
        say "removed $path"
    done
}

need_root
refuse_while_moving
units=$DESTDIR$UNITS
if live; then
    systemctl --quiet stop 'drivegate@*.service' 'drivegate-can@*.service'
    systemctl --quiet reset-failed 'drivegate@*.service' 'drivegate-can@*.service' || true # none is loaded
fi
remove "$units"/*.wants/drivegate@*.service "$units"/*.wants/drivegate-can@*.service "$units"/drivegate@*.service.d
find "$units" -maxdepth 1 -name '*.device.wants' -empty -delete 2>/dev/null || true # there may be no such directory
remove "$units/drivegate@.service" "$units/drivegate-can@.service" "$DESTDIR/etc/sysusers.d/drivegate.conf"
for file in "$DESTDIR$NETWORKS"/80-drivegate-*; do
    if [ -f "$file" ] && grep -q "$MARK" "$file"; then remove "$file"; fi
done
remove "$DESTDIR$PREFIX/libexec/restart-backoff.sh"
if [ -e "$DESTDIR$PREFIX/.drivegate" ]; then
    remove "$DESTDIR$PREFIX" "$DESTDIR/usr/local/bin/drivegate"
fi
if live; then systemctl daemon-reload; fi
say "kept $DESTDIR$CONFIG, $DESTDIR/var/lib/drivegate and the user drivegate"
