#!/bin/sh
# Installs or upgrades DriveGate on a robot computer; see deploy/README.md. Idempotent; prints what it changes.
# Everything is checked before anything is changed; what fails after that is taken back.
# shellcheck disable=SC2034 # variables of environment.sh
set -eu
here=$(cd "$(dirname "$0")" && pwd)
. "$here/common.sh"

usage() {
    cat <<END
usage: [DESTDIR=ROOT] $0 [options]
  --for KIND         robot: drives and records, without Rerun's viewer (default: as it is, else robot);
                     client: commands and looks on from another computer, without Rerun; desk: everything
  --enable ROBOT     start this robot (a file ROBOT.toml in $CONFIG) now and at every boot; may be repeated
  --disable ROBOT    start it no more, and take what was set up for it away; may be repeated
  --can KIND         who sets up the CAN interfaces: networkd, ip, none (default: as it is, else networkd)
  --rollback         back to the environment before the last one, and to its units
  --prefix DIR       own Python environment (default $PREFIX)
  --wheel FILE       install this wheel instead of the checkout this script lies in
  --wheelhouse DIR   take every package from here, made by wheelhouse.py, and ask no network for anything
  --no-venv          PREFIX is already an environment with DriveGate (images): only use it
END
}

source=$(dirname "$here")
build=yes
rollback=no
can=
kind=
wheels=
enable=
disable=
while [ $# -gt 0 ]; do
    case $1 in
        --no-venv) build=no ;;
        --rollback) rollback=yes ;;
        --help) usage && exit 0 ;;
        --for | --prefix | --wheel | --wheelhouse | --can | --enable | --disable)
            [ $# -ge 2 ] || die "$1 needs a value"
            case $1 in
                --for) kind=$2 ;;
                --prefix) PREFIX=$2 ;;
                --wheel) source=$(realpath "$2") ;;
                --wheelhouse) wheels=$(realpath "$2") ;;
                --can) can=$2 ;;
                --enable) enable="$enable $2" ;;
                --disable) disable="$disable $2" ;;
            esac
            shift
            ;;
        *) usage >&2 && exit 2 ;;
    esac
    shift
done
check_prefix
root=$DESTDIR$PREFIX
. "$here/environment.sh"

# --- What is there, and what is wanted ---

kind_before() { if [ -f "$root/.drivegate" ]; then sed -n 's/^for //p' "$root/.drivegate"; fi; }

# Who set the interfaces up until now: as it is written down, or else as it looks.
can_before() {
    if [ -f "$DESTDIR$CONFIG/can/kind" ]; then
        cat "$DESTDIR$CONFIG/can/kind"
        return
    fi
    case $(written) in
        *"$CONFIG/can/"*) echo ip ;;
        *"$NETWORKS/"*) echo networkd ;;
        *) if bound_to_real; then echo none; else echo networkd; fi ;;
    esac
}

bound_to_real() { written | xargs -r -d '\n' grep -h '^BindsTo=' | tr ' =' '\n' | grep '\.device$' | grep -qv 'devices-vx\{0,1\}can'; }

# Robots that this computer is set up for: those that are bound to CAN interfaces, or started at boot.
robots_before() {
    ours | sed -n 's|.*/drivegate@\([^/]*\)\.service\.d/can\.conf$|\1|p; s|.*\.wants/drivegate@\(.*\)\.service$|\1|p' | sort -u
}

is_in() { # WORD WORDS...
    word=$1
    shift
    for one in "$@"; do [ "$one" != "$word" ] || return 0; done
    return 1
}

# Where the file of a robot will be read from; it may be one that only comes with this installation.
robot_file() { if [ -f "$DESTDIR$CONFIG/$1.toml" ]; then echo "$DESTDIR$CONFIG/$1.toml"; else echo "$here/robots/$1.toml"; fi; }

check_words() {
    case $can in networkd | ip | none) ;; *) die "--can = $can: must be networkd, ip or none" ;; esac
    case $kind in client | robot | desk) ;; *) die "--for = $kind: must be client, robot or desk" ;; esac
    known=$(for file in "$DESTDIR$CONFIG"/*.toml "$here"/robots/*.toml; do basename "$file" .toml; done |
        grep -vxF '*' | sort -u | paste -sd ' ')
    for robot in $enable; do
        [ -f "$(robot_file "$robot")" ] ||
            die "--enable $robot: there is no robot file $CONFIG/$robot.toml; there is: $known. Nothing was changed"
    done
    for robot in $disable; do
        # shellcheck disable=SC2046 # words
        is_in "$robot" $(robots_before) || die "--disable $robot: it is not set up here. Nothing was changed"
    done
    if [ "$kind" = client ]; then
        [ -z "$enable" ] || die "--for client --enable: a client drives no robot of its own"
        [ ! -e "$DESTDIR$UNITS/drivegate@.service" ] || die "this computer is set up as a robot: first sh $here/uninstall.sh"
    fi
}

# make_plan PYTHON: the buses of all robots in $work/plan, or an end where two do not go together
make_plan() {
    set -- "$1" -I "$here/can_plan.py"
    for robot in $robots; do
        [ -f "$(robot_file "$robot")" ] ||
            die "$robot is set up here, and there is no $CONFIG/$robot.toml: put it back, or --disable $robot. Nothing was changed"
        set -- "$@" "$(robot_file "$robot")"
    done
    [ -n "$robots" ] || { : >"$work/plan" && return 0; }
    "$@" >"$work/plan" || die "change the robot files, or --disable one of them. Nothing was changed"
}

# --- Files ---

# put SOURCE TARGET [MODE]: install if different, with our paths in it
put() {
    sed "s|/opt/drivegate|$PREFIX|g" "$1" >"$work/put"
    target=$DESTDIR$2
    echo "$target" >>"$work/wanted"
    if [ -f "$target" ] && cmp -s "$work/put" "$target"; then
        return 0
    fi
    if [ -e "$target" ]; then verb=updated; else verb=installed; fi
    [ "$verb" = updated ] || echo "$target" >>"$work/new_files"
    install -D -m "${3:-644}" "$work/put" "$target"
    echo "$target" >>"$work/changed"
    say "$verb $target"
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
    if [ "$can" != "$(can_before)" ] && [ -n "$(written)" ]; then say "CAN interfaces: $(can_before) before, $can now"; fi
    echo "$can" >"$work/kind"
    [ -z "$robots" ] || put "$work/kind" "$CONFIG/can/kind"
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

can_unit() { echo "drivegate-can@$(systemd-escape "$1").service"; }

device() { systemd-escape --path --suffix=device "/sys/subsystem/net/devices/$1"; }

# set_up ROBOT: its unit follows its CAN interfaces, which get their bit rates
set_up() {
    devices=
    while read -r robot channel bitrate data; do
        [ "$robot" = "$1" ] || continue
        devices="$devices $(device "$channel")"
        case $channel in vcan* | vxcan*) ;; *) set_up_can "$channel" "$bitrate" "$data" ;; esac
    done <"$work/plan"
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
            for part in network link; do
                sed -e "s|@CHANNEL@|$1|g" -e "s|@BITRATE@|$2|g" -e "s|@DATA_BITRATE@|$3|g" "$here/80-can.$part" |
                    if [ -n "$3" ]; then cat; else sed '/^FDMode=/d; /^DataBitRate=/d'; fi >"$work/80-can.$part"
                put "$work/80-can.$part" "$NETWORKS/80-drivegate-$1.$part"
            done
            ;;
        ip)
            echo "BITRATE=$2" >"$work/can"
            [ -z "$3" ] || echo "FD=fd on dbitrate $3" >>"$work/can"
            put "$work/can" "$CONFIG/can/$1.conf"
            ;;
    esac
    [ "$can" = none ] || echo "$1" >>"$work/channels"
}

# NetworkManager, where there is one, must leave to others what they set up.
release_from_manager() {
    [ -s "$work/channels" ] && [ -d "$DESTDIR$MANAGER" ] || return 0
    {
        echo "# CAN interfaces of DriveGate robots; $MARK, do not edit."
        # "+=" appends to what other files say; of two such lines in one file only the last would count
        printf '[keyfile]\nunmanaged-devices+=%s\n' "$(sort -u "$work/channels" | sed 's/^/interface-name:/' | paste -sd ';')"
    } >"$work/manager"
    put "$work/manager" "$MANAGER/conf.d/80-drivegate.conf"
}

# What robot files asked for before, or another --can, and none does now: two ways to set up one interface would fight.
remove_old() {
    written | grep -vxF -f "$work/wanted" | while read -r path; do
        case $path in
            "$DESTDIR$CONFIG"/can/*) switch disable "$(can_unit "$(basename "$path" .conf)")" ;;
        esac
        remove "$path"
        echo "$path" >>"$work/changed"
    done
    remove_empty
}

# switch enable|disable UNIT: at boot; with `disable` it ends now, too
switch() {
    if [ -n "$DESTDIR" ]; then
        systemctl --root="$DESTDIR" --quiet "$1" "$2"
    elif [ "$1" = disable ] && live; then
        systemctl --quiet disable --now "$2"
    else
        systemctl --quiet "$1" "$2"
    fi
    say "${1}d $2"
}

# The places where a unit is enabled are those of the devices that it was bound to then.
switch_on() {
    for robot in $robots; do
        # shellcheck disable=SC2086 # words
        is_in "$robot" $enable ||
            { is_enabled "$robot" && grep -qF "/drivegate@$robot.service.d/" "$work/changed"; } || continue
        ours | grep "\.wants/drivegate@$robot\.service\$" | xargs -r -d '\n' rm -f
        switch enable "drivegate@$robot.service"
    done
    [ "$can" = ip ] || return 0
    sort -u "$work/channels" | while read -r channel; do
        ours | grep -qF "/$(can_unit "$channel")" || switch enable "$(can_unit "$channel")"
    done
}

is_enabled() { ours | grep -q "\.wants/drivegate@$1\.service\$"; }

# --- The running system ---

activate() {
    systemd-sysusers drivegate.conf
    reload
    start_can
}

# The interfaces that --can ip sets up, with the bit rates that are wanted now; robots are stopped at this moment.
start_can() {
    for conf in "$CONFIG"/can/*.conf; do
        [ ! -f "$conf" ] || systemctl --quiet restart --no-block "$(can_unit "$(basename "$conf" .conf)")"
    done
}

stop_robots() {
    for robot in $running; do
        stopped="$stopped $robot"
        systemctl stop "drivegate@$robot.service"
        say "stopped $robot for the upgrade"
    done
}

start_robots() {
    live || return 0
    for robot in "$@"; do
        systemctl start --no-block "drivegate@$robot.service"
        say "starting $robot: systemctl status drivegate@$robot"
    done
}

# --- Back ---

save_files() { ours | sed "s|^$DESTDIR/||" | tar -C "$DESTDIR/" -cf "$1" --no-recursion -T -; }

# restore_files TAR: what is in it is there again, and nothing else of ours
restore_files() {
    if live; then systemctl --quiet stop 'drivegate-can@*.service'; fi
    tar -C "$DESTDIR/" -xf "$1"
    tar -tf "$1" | sed "s|^|$DESTDIR/|" >"$work/restored"
    ours | grep -vxF -f "$work/restored" | xargs -r -d '\n' rm -f
    remove_empty
    if live; then reload && start_can; fi
}

take_back() {
    say "taking back what was changed" >&2
    swap_back
    restore_files "$work/before.tar"
    xargs -r -d '\n' rm -f <"$work/new_files"
}

# A signal ends it by way of `finish`. None does between a swap and its being noted, which would not be taken back then.
heed_signals() {
    trap 'exit 130' INT
    trap 'exit 143' TERM HUP
}

ignore_signals() { trap '' INT TERM HUP; }

finish() {
    code=$?
    trap - EXIT
    ignore_signals # such as a second Ctrl-C
    set +e
    if [ "$code" != 0 ] && [ "$changing" = yes ]; then
        (set -e && take_back)
        # shellcheck disable=SC2181 # as a condition it would not end at what fails in it
        if [ $? = 0 ]; then
            echo "$0: failed; everything is as it was before" >&2
        else
            echo "$0: failed, and so did taking it back: the files that were there are in $work/before.tar," \
                "the environment in $root.old; mend what is said above and run it again" >&2
            work=
        fi
        # shellcheck disable=SC2086 # words
        start_robots $stopped
    fi
    rm -rf "$root.new" "$root.new.tmp" "$root.older" ${work:+"$work"}
    exit "$code"
}

roll_back() {
    [ -f "$root.old/files.tar" ] || die "there is no environment before this one in $root.old. Nothing was changed"
    robots=$(tar -tf "$root.old/files.tar" | sed 's|^|/|' |
        sed -n 's|.*/drivegate@\([^/]*\)\.service\.d/can\.conf$|\1|p; s|.*\.wants/drivegate@\(.*\)\.service$|\1|p' | sort -u)
    make_plan "$root.old/bin/python"
    running=$(running_robots)
    save_files "$work/before.tar"
    changing=yes
    stop_robots
    cp "$work/before.tar" "$root/files.tar"
    ignore_signals
    exchange "$root.old" "$root"
    swapped=yes
    heed_signals
    restore_files "$root/files.tar"
    changing=no
    say "back at $("$root/bin/python" -I -c "$VERSION"), with its units; once more --rollback goes forward again"
    for robot in $running; do
        # shellcheck disable=SC2086 # words
        if is_in "$robot" $robots; then start_robots "$robot"; else say "$robot was not set up then: it stays stopped"; fi
    done
}

tell_size() {
    case $kind in
        client) words=", for a client: without Rerun and what drives a robot" ;;
        robot) words=", for a robot: without Rerun's viewer and the tools of a desk (--for desk has them)" ;;
        desk) words=", for a desk" ;;
    esac
    say "$(du -sm "$root" | cut -f1) MB in $root$words"
    [ ! -d "$root.old" ] || say "$(du -sm "$root.old" | cut -f1) MB in $root.old, the environment before it, for --rollback"
}

need_root
exec 9<"$DESTDIR/"
flock -n 9 || die "another install.sh is at work here"
[ -n "$kind" ] || kind=$(kind_before)
: "${kind:=robot}" "${can:=$(can_before)}"
work=$(mktemp -d)
changing=no
swapped=no
stopped=
trap finish EXIT
heed_signals
touch "$work/wanted" "$work/new_files" "$work/changed" "$work/channels"
refuse_while_moving
check_words
if [ "$rollback" = yes ]; then
    roll_back
    exit
fi

new=$root
if [ "$build" = yes ]; then
    check_environment
    fingerprint=$(fingerprint)
    if up_to_date; then
        build=kept
    else
        check_room
        build_environment
        new=$root.new
    fi
fi
[ -x "$new/bin/python" ] || die "there is no environment in $new. Nothing was changed"
"$new/bin/python" -I -c 'import gateway.config' || die "$new/bin/python has no DriveGate. Nothing was changed"
robots=$(for robot in $(robots_before) $enable; do
    # shellcheck disable=SC2086 # words
    is_in "$robot" $disable || echo "$robot"
done | sort -u)
make_plan "$new/bin/python"
refuse_while_moving # building took its time

running=$(running_robots)
save_files "$work/before.tar"
changing=yes
stop_robots
if [ "$build" = yes ]; then
    swap_environment
    say "installed the environment $root: DriveGate $("$root/bin/python" -I -c "$VERSION")"
    mkdir -p "$DESTDIR/usr/local/bin"
    ln -sfn "$PREFIX/bin/drivegate" "$DESTDIR/usr/local/bin/drivegate"
fi
if [ "$kind" != client ]; then
    for robot in $disable; do switch disable "drivegate@$robot.service"; done
    install_files
    for robot in $robots; do set_up "$robot"; done
    release_from_manager
    remove_old
    if live; then activate; fi
    switch_on
fi
changing=no
# shellcheck disable=SC2046,SC2086 # words
start_robots $(for robot in $running $enable; do is_in "$robot" $disable || echo "$robot"; done | awk '!seen[$0]++')
if [ "$build" != no ]; then tell_size; fi
