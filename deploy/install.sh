#!/bin/sh
# Installs or upgrades DriveGate on a robot computer; see deploy/README.md. Idempotent; prints what it changes.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
. "$here/common.sh"

usage() {
    cat <<END
usage: [DESTDIR=ROOT] $0 [options]
  --prefix DIR       own Python environment (default $PREFIX)
  --wheel FILE       install this wheel instead of the checkout this script lies in
  --no-venv          PREFIX is already an environment with DriveGate (images, offline computers): only use it
  --can KIND         who sets up the CAN interfaces: networkd (default), ip, none
  --enable ROBOT     start this robot (a file ROBOT.toml in $CONFIG) now and at every boot; may be repeated
END
}

source=$(dirname "$here")
build=yes
can=networkd
enable=
while [ $# -gt 0 ]; do
    case $1 in
        --no-venv) build=no ;;
        --help) usage && exit 0 ;;
        --prefix | --wheel | --can | --enable)
            [ $# -ge 2 ] || die "$1 needs a value"
            case $1 in
                --prefix) PREFIX=$2 ;;
                --wheel) source=$2 ;;
                --can) can=$2 ;;
                --enable) enable="$enable $2" ;;
            esac
            shift
            ;;
        *) usage >&2 && exit 2 ;;
    esac
    shift
done
case $PREFIX in /?*) ;; *) die "--prefix = $PREFIX: must be an absolute path" ;; esac
case $can in networkd | ip | none) ;; *) die "--can = $can: must be networkd, ip or none" ;; esac
root=$DESTDIR$PREFIX

# put SOURCE TARGET [MODE]: install if different, with our paths in it
put() {
    sed "s|/opt/drivegate|$PREFIX|g" "$1" >"$work/put"
    target=$DESTDIR$2
    if [ -f "$target" ] && cmp -s "$work/put" "$target"; then
        return 0
    fi
    if [ -e "$target" ]; then verb=updated; else verb=installed; fi
    install -D -m "${3:-644}" "$work/put" "$target"
    say "$verb $target"
}

VERSION='from importlib.metadata import version; print(version("drivegate"))'

build_environment() {
    . "$here/venv.sh"
    case $(python3 -c 'import sys; print(sys.base_prefix)') in
        /root/* | /home/*) die "python3 is in a home directory, which the service cannot see: use Debian's" ;;
    esac
    rm -rf "$root.new"
    mkdir -p "$(dirname "$root")"
    make_venv "$root.new"
    "$root.new/bin/pip" install --quiet --disable-pip-version-check --no-compile -c "$here/constraints.txt" "$source"
    # Scripts and configuration name the place where the environment will be, not the one where it was built.
    grep -lIr --exclude-dir=lib --exclude-dir=lib64 "$root.new" "$root.new" | xargs -r sed -i "s|$root.new|$PREFIX|g"
    echo "built by install.sh; uninstall.sh removes this directory" >"$root.new/.drivegate"
}

swap_environment() {
    rm -rf "$root.old"
    if [ -e "$root" ]; then
        [ -e "$root/.drivegate" ] || die "$root exists and was not built by this script: choose another --prefix"
        mv "$root" "$root.old"
    fi
    mv "$root.new" "$root"
    rm -rf "$root.old"
    "$root/bin/python" -m compileall -q -s "$DESTDIR" "$root/lib" >/dev/null || true # some packages carry old syntax
    say "installed the environment $root: DriveGate $("$root/bin/python" -I -c "$VERSION")"
    mkdir -p "$DESTDIR/usr/local/bin"
    ln -sfn "$PREFIX/bin/drivegate" "$DESTDIR/usr/local/bin/drivegate"
}

install_files() {
    put "$here/drivegate@.service" "$UNITS/drivegate@.service"
    put "$here/drivegate-can@.service" "$UNITS/drivegate-can@.service"
    put "$here/restart-backoff.sh" "$PREFIX/libexec/restart-backoff.sh" 755
    put "$here/drivegate.sysusers" /etc/sysusers.d/drivegate.conf
    install -d -m 755 "$DESTDIR$CONFIG"
    install -d -m 700 "$DESTDIR$CONFIG/tls"
    for file in "$here"/robots/*.toml; do
        put_robot "$file" "$CONFIG/$(basename "$file")"
    done
}

# A robot file that differs from ours was edited: it stays, ours is put beside it.
put_robot() {
    if [ ! -e "$DESTDIR$2" ]; then
        put "$1" "$2"
    elif ! cmp -s "$1" "$DESTDIR$2"; then
        cmp -s "$1" "$DESTDIR$2.new" || say "kept $DESTDIR$2, which was edited; the new one is $2.new"
        put "$1" "$2.new"
    fi
}

# "channel bitrate", and on a bus of CAN FD "data bitrate", of every SocketCAN bus of a robot file; fails with the reason if it is no valid one.
buses() {
    "$root/bin/python" -I - "$DESTDIR$CONFIG/$1.toml" <<'END'
import sys
from pathlib import Path
from gateway.config import ConfigError, load
try:
    config, _ = load(Path(sys.argv[1]))
except ConfigError as error:
    sys.exit(str(error))
for bus in config.bus:
    if bus.interface == "socketcan":
        print(bus.channel, bus.bitrate, *([bus.fd_bitrate] if bus.fd else []))
END
}

device() { systemd-escape --path --suffix=device "/sys/subsystem/net/devices/$1"; }

# bind ROBOT: its unit follows its CAN interfaces, which get their bit rates
bind() {
    [ -f "$DESTDIR$CONFIG/$1.toml" ] || die "there is no robot file $CONFIG/$1.toml"
    buses "$1" >"$work/buses" || die "$CONFIG/$1.toml is no valid robot file"
    devices=
    while read -r channel bitrate data; do
        devices="$devices $(device "$channel")"
        case $channel in vcan* | vxcan*) ;; *) set_up_can "$channel" "$bitrate" "$data" ;; esac
    done <"$work/buses"
    [ -n "$devices" ] || return 0
    {
        echo "# The CAN interfaces of $1; $MARK, do not edit."
        printf '[Unit]\nBindsTo=%s\nAfter=%s\n\n' "${devices# }" "${devices# }"
        printf '[Install]\nWantedBy=%s\n' "${devices# }"
    } >"$work/can.conf"
    put "$work/can.conf" "$UNITS/drivegate@$1.service.d/can.conf"
}

# set_up_can CHANNEL BITRATE DATA_BITRATE: the last is empty on a classic bus
set_up_can() {
    case $can in
        networkd)
            for kind in network link; do
                sed -e "s|@CHANNEL@|$1|g" -e "s|@BITRATE@|$2|g" -e "s|@DATA_BITRATE@|$3|g" "$here/80-can.$kind" |
                    if [ -n "$3" ]; then cat; else sed '/^FDMode=/d; /^DataBitRate=/d'; fi >"$work/80-can.$kind"
                put "$work/80-can.$kind" "$NETWORKS/80-drivegate-$1.$kind"
            done
            ;;
        ip)
            echo "BITRATE=$2" >"$work/can"
            [ -z "$3" ] || echo "FD=fd on dbitrate $3" >>"$work/can"
            put "$work/can" "$CONFIG/can/$1.conf"
            enable_unit "drivegate-can@$(systemd-escape "$1").service"
            ;;
    esac
}

enable_unit() {
    if [ -n "$DESTDIR" ]; then
        systemctl --root="$DESTDIR" --quiet enable "$1"
    else
        systemctl --quiet enable "$1"
    fi
    say "enabled $1"
}

activate() {
    systemd-sysusers drivegate.conf
    systemctl daemon-reload
    if systemctl --quiet is-active systemd-networkd.service; then networkctl reload; fi
}

need_root
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
refuse_while_moving
[ "$build" = no ] || build_environment
running=$(running_robots)
refuse_while_moving # building took its time
for robot in $running; do
    systemctl stop "drivegate@$robot.service"
    say "stopped $robot for the upgrade"
done
[ "$build" = no ] || swap_environment
[ -x "$root/bin/python" ] || die "there is no environment in $root"
"$root/bin/python" -I -c 'import gateway.config' || die "$root/bin/python has no DriveGate"
install_files
for directory in "$DESTDIR$UNITS"/drivegate@*.service.d; do
    name=${directory##*/drivegate@}
    [ ! -f "$directory/can.conf" ] || bind "${name%.service.d}"
done
for robot in $enable; do
    bind "$robot"
done
if live; then activate; fi
for robot in $enable; do
    enable_unit "drivegate@$robot.service"
done
if live; then
    for robot in $running $enable; do
        systemctl start --no-block "drivegate@$robot.service"
        say "starting $robot: systemctl status drivegate@$robot"
    done
fi
