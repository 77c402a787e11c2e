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
check_prefix

need_root
refuse_while_moving
if live; then
    systemctl --quiet stop 'drivegate@*.service' 'drivegate-can@*.service'
    systemctl --quiet reset-failed 'drivegate@*.service' 'drivegate-can@*.service' || true # none is loaded
fi
if [ ! -e "$DESTDIR$PREFIX/.drivegate" ]; then kept=/usr/local/bin/drivegate; else kept=; fi
ours | while read -r path; do
    [ "$path" = "$DESTDIR$kept" ] || remove "$path"
done
remove_empty
for directory in "$DESTDIR$PREFIX" "$DESTDIR$PREFIX.old"; do
    if [ -e "$directory/.drivegate" ]; then remove "$directory"; fi
done
if live; then reload; fi
say "kept $DESTDIR$CONFIG, $DESTDIR/var/lib/drivegate and the user drivegate"
