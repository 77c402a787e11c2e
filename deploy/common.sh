# Sourced by install.sh and uninstall.sh: the places of an installation, and whether a robot moves.
# DESTDIR (environment) stands before every path that is written; with it nothing of the running system is touched.
# shellcheck shell=sh disable=SC2034 # used by those two
: "${DESTDIR:=}"
DESTDIR=${DESTDIR%/}
PREFIX=/opt/drivegate
UNITS=/etc/systemd/system
NETWORKS=/etc/systemd/network
CONFIG=/etc/drivegate
MARK="written by install.sh from the robot file"

say() { echo "$*"; }
die() {
    echo "$0: $*" >&2
    exit 1
}

# Live: systemd runs here and we install for it. In an image that is being built (DESTDIR, chroot) it does not.
live() { [ -z "$DESTDIR" ] && [ -d /run/systemd/system ]; }

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
