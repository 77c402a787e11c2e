"""What the shipped unit lets a process do: measured from within, by a probe that runs in place of the service."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.vm.installed_robot import CONFIG, Motors, run, show, systemctl

pytestmark = [pytest.mark.systemd, pytest.mark.timeout(120)]

MAX_EXPOSURE = 2.0
UNIT = "drivegate@probe.service"
STATE = Path("/var/lib/drivegate/probe")

PROBE = """
import ctypes, json, mmap, os, pathlib, socket

def attempt(action, *arguments, **named):
    try:
        action(*arguments, **named)
    except (OSError, ValueError) as error:
        return type(error).__name__
    return "ok"

places = ("/etc/x", "/usr/x", "/opt/drivegate/x", "/var/x", "/var/lib/x", "/var/lib/drivegate/moby/x", "/boot/x", "/x",
          "/root/x", "/home/x", "/sys/x", "/proc/sys/kernel/hostname", "/dev/x", "/run/x", "/etc/drivegate/moby.toml",
          "/tmp/x", "/var/lib/drivegate/probe/x", "/var/log/drivegate/probe/x", "/run/drivegate/probe/x")
families = ("AF_CAN", "AF_INET", "AF_INET6", "AF_UNIX", "AF_NETLINK", "AF_PACKET", "AF_ALG", "AF_VSOCK",
            "AF_BLUETOOTH", "AF_TIPC", "AF_QIPCRTR")
def can():
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind(("vcan0",))
        bus.send(bytes(16))
def other(name):
    kind = socket.SOCK_DGRAM if name in ("AF_UNIX", "AF_INET", "AF_INET6") else socket.SOCK_RAW
    socket.socket(getattr(socket, name), kind).close()
status = dict(line.split(":", 1) for line in pathlib.Path("/proc/self/status").read_text().splitlines())
credentials = pathlib.Path(os.environ["CREDENTIALS_DIRECTORY"])
print(os.getuid())
report = {
    "write": {place: attempt(pathlib.Path(place).write_text, "x") for place in places},
    "socket": {name: attempt(can) if name == "AF_CAN" else attempt(other, name) for name in families},
    "exec_memory": attempt(mmap.mmap, -1, 4096, prot=mmap.PROT_WRITE | mmap.PROT_EXEC),
    "real_time": attempt(os.sched_setscheduler, 0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(40)),
    "more_real_time": attempt(os.sched_setscheduler, 0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(41)),
    "lock": ctypes.CDLL(None).mlockall(7),
    "set_uid": attempt(os.setuid, 0),
    "namespace": ctypes.CDLL(None).unshare(0x10000000),
    "foreign_process": pathlib.Path("/proc/1/status").exists(),
    "capabilities": status["CapEff"].strip(),
    "no_new_privileges": status["NoNewPrivs"].strip(),
    "seccomp": status["Seccomp"].strip(),
    "credentials": {path.name: path.read_text() for path in credentials.iterdir()},
}
pathlib.Path("/var/lib/drivegate/probe/report.json").write_text(json.dumps(report))
"""
DROP_IN = """
[Service]
Type=oneshot
Restart=no
WatchdogSec=0
ExecStart=
ExecStart=/opt/drivegate/bin/python -I /etc/drivegate/probe.py
"""
OWN = ("/tmp/x", "/var/lib/drivegate/probe/x", "/var/log/drivegate/probe/x", "/run/drivegate/probe/x")
NEEDED = {"AF_CAN", "AF_INET", "AF_INET6", "AF_UNIX", "AF_NETLINK"}


@pytest.fixture(scope="module")
def report(motors: Motors) -> dict[str, object]:
    """What the probe found. The shipped unit with another program, everything else as it is."""
    assert motors is not None
    drop_in = Path(f"/run/systemd/system/{UNIT}.d/probe.conf")
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(DROP_IN, encoding="utf-8")
    (CONFIG / "probe.py").write_text(PROBE, encoding="utf-8")
    systemctl("daemon-reload")
    done = run("systemctl", "start", UNIT)
    assert done.code == 0, run("journalctl", "-u", UNIT, "-o", "cat").output
    found: dict[str, object] = json.loads((STATE / "report.json").read_text(encoding="utf-8"))
    return found


def test_exposure(motors: Motors, tell: Callable[[str], None]) -> None:
    assert motors is not None
    text = run("systemd-analyze", "security", "--no-pager", "drivegate@moby.service").output
    found = re.search(r"Overall exposure level for \S+: ([\d.]+)", text)
    assert found is not None, text
    tell(f"systemd-analyze security: {found[1]}")
    assert float(found[1]) <= MAX_EXPOSURE
    assert "drivegate@moby" in found[0]


def test_the_shipped_units_are_correct(motors: Motors) -> None:
    assert motors is not None
    verified = run("systemd-analyze", "verify", "--man=no", "drivegate@moby.service", "drivegate-can@can0.service")
    assert verified.code == 0, verified.output
    assert "drivegate" not in verified.output, verified.output


def test_it_writes_only_its_own_directories(report: dict[str, dict[str, str]]) -> None:
    assert {place for place, outcome in report["write"].items() if outcome == "ok"} == set(OWN)


def test_it_opens_only_the_address_families_it_needs(report: dict[str, dict[str, str]]) -> None:
    assert {name for name, outcome in report["socket"].items() if outcome == "ok"} >= NEEDED - {"AF_NETLINK"}
    assert {name for name, outcome in report["socket"].items() if outcome == "ok"} <= NEEDED


def test_it_has_real_time_and_locked_memory_and_nothing_else(report: dict[str, object]) -> None:
    assert report["real_time"] == "ok"
    assert report["more_real_time"] == "PermissionError"
    assert report["lock"] == 0
    assert report["exec_memory"] != "ok"
    assert report["set_uid"] == "PermissionError"
    assert report["namespace"] == -1
    assert report["foreign_process"] is False
    assert int(str(report["capabilities"]), 16) == 0
    assert (report["no_new_privileges"], report["seccomp"]) == ("1", "2")


def test_keys_arrive_as_credentials(report: dict[str, object]) -> None:
    assert report["credentials"] == {"tls_ca.pem": "a certificate"}


def test_the_probe_is_gone_from_the_unit(report: dict[str, object]) -> None:
    assert report
    Path(f"/run/systemd/system/{UNIT}.d/probe.conf").unlink()
    systemctl("daemon-reload")
    assert "gateway run /etc/drivegate/probe.toml" in show("ExecStart", UNIT)
