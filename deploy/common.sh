# Sourced by install.sh and uninstall.sh: the places of an installation, what lies there, and whether a robot moves.
# DESTDIR (environment) stands before every path that is written; with it nothing of the running system is touched.
# shellcheck shell=sh disable=SC2034 # used by those two
: "${DESTDIR:=}"
DESTDIR=${DESTDIR%/}
PREFIX=/opt/drivegate
UNITS=/etc/systemd/system
NETWORKS=/etc/systemd/network
MANAGER=/etc/NetworkManager
CONFIG=/etc/drivegate
MARK="written by install.sh from the robot file"

say() { echo "$*"; }
die() {
    echo "$0: $*" >&2
    exit 1
}

# PREFIX as one path with what lies beside it (PREFIX.old), which units, scripts and sed take as it is.
check_prefix() {
    while [ "${PREFIX%/}" != "$PREFIX" ]; do PREFIX=${PREFIX%/}; done
    case $PREFIX in /?*) ;; *) die "--prefix = $PREFIX: must be an absolute path" ;; esac
    case $PREFIX in
        *[!A-Za-z0-9/._+-]*) die "--prefix = $PREFIX: must be of letters, digits and / . _ + -" ;;
    esac
}

# Live: systemd runs here and we install for it. In an image that is being built (DESTDIR, chroot) it does not.
live() { [ -z "$DESTDIR" ] && [ -d /run/systemd/system ]; }

reload() {
    systemctl daemon-reload
    if systemctl --quiet is-active systemd-networkd.service; then networkctl reload; fi
    if systemctl --quiet is-active NetworkManager.service; then nmcli general reload conf; fi
}

need_root() { [ -n "$DESTDIR" ] || [ "$(id -u)" = 0 ] || die "must run as root (or with DESTDIR)"; }

running_robots() {
    live || return 0
    systemctl list-units --plain --no-legend --state=active,activating,deactivating,reloading 'drivegate@*.service' |
        while read -r unit _; do
            robot=${unit#drivegate@}
            echo "${robot%.service}"
        done
}

# The service keeps mode and motion at the beginning of its status text, at most a second old. A robot that waits for
# its bus or its motors ("waiting: ...") is not driven by us; any other text is from an unknown version.
refuse_while_moving() {
    for robot in $(running_robots); do
        text=$(systemctl show -P StatusText "drivegate@$robot.service")
        case $text in
            "idle, moving"* | "estop, moving"* | "fault, moving"*) ;;
            idle,* | estop,* | fault,* | waiting:*) continue ;;
            "") [ "$(systemctl show -P SubState "drivegate@$robot.service")" = start ] && continue ;;
        esac
        die "$robot is not at rest ($text): bring it to rest, or stop it: systemctl stop drivegate@$robot"
    done
}

# What was written from robot files, a path a line: what sets up CAN interfaces, and what binds robots to them. Somebody's
# own file of such a name is none of ours.
written() {
    find "$DESTDIR$NETWORKS" "$DESTDIR$MANAGER/conf.d" -maxdepth 1 -type f \( -name '80-drivegate-*' -o -name 80-drivegate.conf \) \
        -exec grep -lF "$MARK" {} + 2>/dev/null || true # there may be no such directory
    find "$DESTDIR$CONFIG/can" -maxdepth 1 -type f -name '*.conf' ! -exec grep -qvE '^(BITRATE|FD)=' {} \; -print 2>/dev/null || true
    find "$DESTDIR$UNITS" -maxdepth 2 -type f -path '*/drivegate@*.service.d/can.conf' 2>/dev/null || true
}

# All that is ours besides the environment and the robot files: the above, the units, and where they are enabled.
ours() {
    written
    find "$DESTDIR$UNITS" -maxdepth 2 \( -name 'drivegate@*.service' -o -name 'drivegate-can@*.service' \) ! -type d 2>/dev/null || true
    for path in /etc/sysusers.d/drivegate.conf /usr/local/bin/drivegate "$CONFIG/can/kind" "$PREFIX/libexec/restart-backoff.sh"; do
        if [ -e "$DESTDIR$path" ] || [ -L "$DESTDIR$path" ]; then echo "$DESTDIR$path"; fi
    done
}

remove() {
    for path in "$@"; do
        [ -e "$path" ] || [ -L "$path" ] || continue
        rm -rf "$path"
        say "removed $path"
    done
}

# Directories of ours in which nothing is left.
remove_empty() {
    find "$DESTDIR$UNITS" -maxdepth 1 \( -name 'drivegate@*.service.d' -o -name '*.device.wants' \) -empty -delete 2>/dev/null || true
    rmdir "$DESTDIR$CONFIG/can" 2>/dev/null || true
}
