#!/bin/sh
# PID 1 of the virtual machine: an overlay over the host's files whose upper layer is memory, CAN modules, vcan0.
# DG_RUN (kernel command line) is the run directory on the host: the lane's command goes in, its results come out.
# DG_INIT says who takes over: "command" runs the command directly, "systemd" boots systemd, which runs it as a unit.
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
MODULES=/usr/lib/uml/modules/$(uname -r)
NEW=/run/root

die() {
    echo "tests.vm: $*"
    exit 1 # PID 1 gone: the kernel panics, and that ends its process
}

make_root() {
    insmod "$(echo "$MODULES"/kernel/fs/overlayfs/overlay.ko*)" || die "no overlay module"
    mount -t tmpfs -o mode=755,size=75% tmpfs /run
    mkdir /run/upper /run/work $NEW
    mount -t overlay overlay -o lowerdir=/,upperdir=/run/upper,workdir=/run/work $NEW || die "no overlay root"
    mount --move /proc $NEW/proc
    mount -t sysfs sys $NEW/sys
    mount -t devtmpfs dev $NEW/dev
    mkdir -p $NEW/dev/shm $NEW/dev/pts
    mount -t tmpfs -o mode=1777 tmpfs $NEW/dev/shm
    mount -t devpts -o gid=5,mode=620,ptmxmode=666 devpts $NEW/dev/pts
    mount -t tmpfs -o mode=755 tmpfs $NEW/run
    mount -t hostfs none "$NEW$DG_RUN" -o "$DG_RUN" || die "no way back for the results"
}

enter_root() {
    cd $NEW || die "no overlay root"
    pivot_root . . || die "cannot enter the overlay root"
    umount -l .
    cd / || die "no root"
    mount --make-rshared /
    rm -f /.dockerenv # this is no container, even if the host is one
}

make_vcan0() {
    mkdir -p /lib/modules
    ln -sfn "$MODULES" "/lib/modules/$(uname -r)" # more (tc qdiscs, vxcan, slcan, ...) is loaded on demand
    modprobe -a can-raw can-gw vcan || die "no CAN modules"
    ip link set lo up
    ip link add dev vcan0 type vcan || die "cannot create vcan0"
    ip link set vcan0 up
}

add_modules() { # those that the lane has built
    for module in "$DG_RUN"/*.ko; do
        [ ! -e "$module" ] || insmod "$module" || die "no $module"
    done
}

mount -t proc proc /proc
make_root
enter_root
make_vcan0
add_modules
[ "$DG_INIT" = systemd ] && . "$DG_RUN/systemd.sh"
sh "$DG_RUN/command" # writes the status, powers off
die "the command did not power off"
