# Sourced by init.sh inside the overlay root: the smallest systemd that still has udev, journald and device units.
UNITS=/etc/systemd/system

# The host's own services have no business here; what the distribution starts statically is masked where it costs time.
rm -rf $UNITS /etc/tmpfiles.d
mkdir -p $UNITS/multi-user.target.wants /etc/tmpfiles.d /etc/systemd/system-generators /etc/systemd/journald.conf.d
for unit in getty.target dbus.service dbus.socket systemd-logind.service systemd-user-sessions.service \
    systemd-networkd.service systemd-networkd.socket systemd-timesyncd.service systemd-resolved.service \
    systemd-update-utmp.service systemd-update-utmp-runlevel.service systemd-random-seed.service \
    systemd-journal-flush.service systemd-journal-catalog-update.service systemd-hwdb-update.service \
    systemd-modules-load.service systemd-sysctl.service systemd-sysusers.service systemd-binfmt.service \
    systemd-machine-id-commit.service systemd-firstboot.service systemd-remount-fs.service systemd-update-done.service \
    systemd-udev-settle.service systemd-pstore.service systemd-boot-random-seed.service \
    systemd-ask-password-console.path systemd-ask-password-wall.path systemd-tmpfiles-clean.timer \
    proc-sys-fs-binfmt_misc.automount dev-hugepages.mount dev-mqueue.mount sys-kernel-debug.mount \
    sys-kernel-tracing.mount sys-kernel-config.mount sys-fs-fuse-connections.mount tmp.mount \
    kmod-static-nodes.service modprobe@.service timers.target remote-fs.target; do
    ln -s /dev/null $UNITS/$unit
done
for generator in /lib/systemd/system-generators/*; do
    ln -sf /dev/null "/etc/systemd/system-generators/${generator##*/}"
done
ln -s /dev/null /etc/tmpfiles.d/tmp.conf # it empties /tmp, where the checkout or the results may lie
: >/etc/fstab

# What DynamicUser= needs, where the files of a host are for its root only and this machine may run as anybody.
rm -f /etc/.pwd.lock
for state in lib log cache; do
    mkdir -p /var/$state/private
    mount -t tmpfs -o mode=700 tmpfs /var/$state/private
done

printf '[Journal]\nStorage=volatile\nRateLimitBurst=0\n' >/etc/systemd/journald.conf.d/vm.conf
[ -s /etc/machine-id ] || echo 0123456789abcdef0123456789abcdef >/etc/machine-id

# Sandboxed units see neither /home nor /root nor /tmp: /opt/drivegate is an environment like an installed one, with this
# interpreter and its packages, and /opt/checkout the code under test.
. "$DG_RUN/facts"
rm -rf /opt/drivegate
mkdir -p /opt/drivegate/bin "/opt/drivegate/lib/$PYTHON_NAME/site-packages" /opt/python /opt/checkout
mount --bind "$PYTHON_BASE" /opt/python
mount --bind "$PYTHON_PACKAGES" "/opt/drivegate/lib/$PYTHON_NAME/site-packages"
mount --bind "$CHECKOUT" /opt/checkout
echo /opt/checkout >"$PYTHON_PACKAGES/tests-vm.pth"
echo "home = /opt/python/bin" >/opt/drivegate/pyvenv.cfg
ln -s "/opt/python/bin/$PYTHON_NAME" /opt/drivegate/bin/python
ln -s "/opt/python/lib/lib$PYTHON_NAME.so.1.0" /usr/lib/ 2>/dev/null # its run path may lie in a home directory

cat >$UNITS/tests-vm.service <<EOF
[Unit]
Description=The tests of this lane
After=multi-user.target

[Service]
Type=exec
ExecStart=/bin/sh $DG_RUN/command
StandardOutput=file:/dev/console
StandardError=inherit
Environment=HOME=/root
EOF
ln -s ../tests-vm.service $UNITS/multi-user.target.wants/
ln -s /lib/systemd/system/multi-user.target $UNITS/default.target

exec env -i PATH="$PATH" /lib/systemd/systemd --show-status=no --log-level=notice
