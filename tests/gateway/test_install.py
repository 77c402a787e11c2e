"""What install.sh writes for the CAN interfaces of a robot file, into a directory of its own; nothing is brought up."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import gateway
from tests.world import ROBOTS

DEPLOY = ROBOTS.parent
PACKAGES = Path(gateway.__file__).parents[1]
CLASSIC = 'channel = "can0"\nbitrate = 1_000_000\n'
FD = f"{CLASSIC}fd = true\n"
FAST = f"{FD}data_bitrate = 5_000_000\n"


def installed(root: Path, bus: str, kind: str) -> Path:
    """A root directory with moby on this bus, set up by `kind`, and an environment that is this very one."""
    python = root / "opt/drivegate/bin/python"
    python.parent.mkdir(parents=True, exist_ok=True)
    # install.sh isolates Python (-I) from where it is called; here that is where DriveGate is.
    python.write_text(f'#!/bin/sh\nshift\nPYTHONPATH={PACKAGES} exec {sys.executable} "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    text = (ROBOTS / "moby.toml").read_text(encoding="utf-8")
    assert CLASSIC in text
    robot = root / "etc/drivegate/moby.toml"
    robot.parent.mkdir(parents=True, exist_ok=True)
    robot.write_text(text.replace(CLASSIC, bus), encoding="utf-8")
    subprocess.run(
        ["sh", DEPLOY / "install.sh", "--no-venv", "--can", kind, "--enable", "moby"],
        env=os.environ | {"DESTDIR": str(root)},
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return root


def can_section(root: Path) -> list[str]:
    text = (root / "etc/systemd/network/80-drivegate-can0.network").read_text(encoding="utf-8")
    return text.split("[CAN]\n")[1].splitlines()


@pytest.mark.parametrize(
    ("bus", "section"),
    [
        (CLASSIC, ["BitRate=1000000", "RestartSec=100ms"]),
        (FD, ["BitRate=1000000", "FDMode=yes", "DataBitRate=1000000", "RestartSec=100ms"]),
        (FAST, ["BitRate=1000000", "FDMode=yes", "DataBitRate=5000000", "RestartSec=100ms"]),
    ],
)
def test_networkd_gets_the_bit_rates_of_the_robot_file(tmp_path: Path, bus: str, section: list[str]) -> None:
    assert can_section(installed(tmp_path, bus, "networkd")) == section


def test_a_bus_that_is_can_fd_no_more_is_set_up_as_a_classic_one(tmp_path: Path) -> None:
    installed(tmp_path, FAST, "networkd")
    assert can_section(installed(tmp_path, CLASSIC, "networkd")) == ["BitRate=1000000", "RestartSec=100ms"]


@pytest.mark.parametrize(
    ("bus", "lines"),
    [
        (CLASSIC, ["BITRATE=1000000"]),
        (FAST, ["BITRATE=1000000", "FD=fd on dbitrate 5000000"]),
    ],
)
def test_the_unit_for_plain_ip_gets_the_bit_rates_of_the_robot_file(tmp_path: Path, bus: str, lines: list[str]) -> None:
    root = installed(tmp_path, bus, "ip")
    assert (root / "etc/drivegate/can/can0.conf").read_text(encoding="utf-8").splitlines() == lines
    unit = (root / "etc/systemd/system/drivegate-can@.service").read_text(encoding="utf-8")
    # Without braces a variable is split into words, none where it is empty (systemd.service, "Command lines").
    assert "type can bitrate ${BITRATE} $FD restart-ms 100" in unit
    assert "\nEnvironment=FD=\nEnvironmentFile=" in unit
