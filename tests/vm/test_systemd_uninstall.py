"""install.sh and uninstall.sh on the machine of the other tests (this file comes last), and into an image."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.vm.installed_robot import CONFIG, INSTALL, SESSIONS, Commander, install, robot_text, run, show, systemctl
from tests.vm.launcher import CHECKOUT

pytestmark = [pytest.mark.systemd, pytest.mark.timeout(300)]

UNINSTALL = CHECKOUT / "deploy" / "uninstall.sh"
DROP_IN = Path("/etc/systemd/system/drivegate@moby.service.d/can.conf")
WANTED = Path("/etc/systemd/system/sys-subsystem-net-devices-vcan0.device.wants/drivegate@moby.service")


def test_the_doctor_is_content_with_a_running_robot(running: Commander) -> None:
    assert running.client.alive
    done = run("/opt/drivegate/bin/python", "-m", "gateway", "doctor", "moby")
    assert done.code == 0, done.output
    for line in ("CAN vcan0: up", "the service runs with SCHED_FIFO", "the service has locked its memory"):
        assert line in done.output
    assert "answered by moby" in done.output
    assert "drivegate@moby.service: active" in done.output


def test_an_upgrade_keeps_the_edited_robot_file_and_the_robot_running(running: Commander) -> None:
    running.await_state(lambda state: state.status.standing is True)
    done = install()
    assert done.code == 0, done.output
    assert done.output.splitlines() == [
        "stopped moby for the upgrade",
        "starting moby: systemctl status drivegate@moby",
    ]
    assert (CONFIG / "moby.toml").read_text(encoding="utf-8") == robot_text()
    assert (CONFIG / "moby.toml.new").read_bytes() == (CHECKOUT / "deploy" / "robots" / "moby.toml").read_bytes()
    assert "BindsTo=sys-subsystem-net-devices-vcan0.device" in DROP_IN.read_text(encoding="utf-8")
    assert WANTED.is_symlink()
    systemctl("stop", "drivegate@moby.service")


def test_uninstall_keeps_robot_files_and_recordings() -> None:
    sessions = sorted(SESSIONS.glob("moby-*/*.rrd"))
    assert sessions
    for _ in range(2):
        done = run("sh", UNINSTALL)
        assert done.code == 0, done.output
    assert done.output.startswith("kept "), "nothing was left to remove"
    assert show("LoadState", "drivegate@moby.service") == "not-found"
    assert not DROP_IN.exists()
    assert not WANTED.is_symlink()
    assert (CONFIG / "moby.toml").read_text(encoding="utf-8") == robot_text()
    assert sorted(SESSIONS.glob("moby-*/*.rrd")) == sessions
    assert Path("/opt/drivegate/bin/python").exists(), "an environment that install.sh did not build is not removed"


def test_an_image_gets_everything_under_its_root(tmp_path: Path) -> None:
    """With a CAN adapter of a real robot: its network files, its device; the other prefix is in the unit."""
    (tmp_path / "opt/other/bin").mkdir(parents=True)
    python = tmp_path / "opt/other/bin/python"
    python.write_text('#!/bin/sh\nexec /opt/drivegate/bin/python "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    environment = os.environ | {"DESTDIR": str(tmp_path)}
    command = ["sh", str(INSTALL), "--no-venv", "--prefix", "/opt/other", "--enable", "omni4"]
    subprocess.run(command, env=environment, check=True)
    units = tmp_path / "etc/systemd/system"
    assert "ExecStart=/opt/other/bin/python" in (units / "drivegate@.service").read_text(encoding="utf-8")
    assert (units / "sys-subsystem-net-devices-can0.device.wants/drivegate@omni4.service").is_symlink()
    assert (units / "multi-user.target.wants/drivegate@omni4.service").is_symlink()
    network = (tmp_path / "etc/systemd/network/80-drivegate-can0.network").read_text(encoding="utf-8")
    assert "BitRate=1000000" in network
    subprocess.run([*command, "--can", "ip"], env=environment, check=True)
    assert (tmp_path / "etc/drivegate/can/can0.conf").read_text(encoding="utf-8") == "BITRATE=1000000\n"
    subprocess.run(["sh", str(UNINSTALL), "--prefix", "/opt/other"], env=environment, check=True)
    assert not list(units.rglob("*drivegate*"))
    assert not list((tmp_path / "etc/systemd/network").iterdir())
    assert (tmp_path / "etc/drivegate/omni4.toml").exists()
