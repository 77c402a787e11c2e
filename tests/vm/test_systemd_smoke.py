"""What the virtual machine's systemd really does: the facts the service's unit relies on."""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep

import pytest

pytestmark = pytest.mark.systemd

UNITS = Path("/run/systemd/system")
PYTHON = "/opt/drivegate/bin/python"  # an environment with this checkout, visible inside a sandbox; see systemd.sh

PINGING = """
import os, socket, time
with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
    notify.connect(os.environ["NOTIFY_SOCKET"])
    notify.send(b"READY=1\\nSTATUS=pinging")
    while True:
        notify.send(b"WATCHDOG=1")
        time.sleep(0.2)
"""
REPORTING = """
import os, pathlib, can, gateway
with can.Bus(interface="socketcan", channel="vcan0") as bus:
    bus.send(can.Message(arbitration_id=1))
secret = (pathlib.Path(os.environ["CREDENTIALS_DIRECTORY"]) / "robot.toml").read_text()
print(f"uid {os.getuid() > 60000} secret {secret} code {pathlib.Path(gateway.__file__).parent}")
"""
SANDBOX = """
DynamicUser=yes
ProtectSystem=strict
ProtectHome=yes
PrivateUsers=yes
PrivateDevices=yes
NoNewPrivileges=yes
CapabilityBoundingSet=
RestrictAddressFamilies=AF_CAN AF_UNIX
StateDirectory=smoke
LoadCredential=robot.toml:/run/smoke.toml
"""


def systemctl(*arguments: str, check: bool = True) -> str:
    """Its output."""
    return subprocess.run(["systemctl", *arguments], check=check, capture_output=True, text=True).stdout.strip()


def write_unit(script: str, settings: str) -> None:
    """smoke.service runs this script."""
    code = Path("/run/smoke.py")
    code.write_text(script, encoding="utf-8")
    unit = f"[Service]\nExecStart={PYTHON} {code}\n{settings}\n"
    UNITS.mkdir(exist_ok=True)
    (UNITS / "smoke.service").write_text(unit, encoding="utf-8")
    systemctl("daemon-reload")


def wait_for(show: str, expected: str, *, seconds: float = 15.0) -> None:
    """Until this property of smoke.service has this value."""
    end = monotonic() + seconds
    while (value := systemctl("show", "-P", show, "smoke.service")) != expected:
        assert monotonic() < end, f"{show} is {value}, not {expected}"
        sleep(0.1)


@pytest.fixture(autouse=True)
def _smoke_service_gone() -> Iterator[None]:
    yield
    systemctl("stop", "smoke.service", check=False)
    systemctl("reset-failed", "smoke.service", check=False)


def test_the_boot_ends() -> None:
    assert systemctl("is-system-running", "--wait", check=False) in {"running", "degraded"}


def test_nothing_failed_to_start() -> None:
    assert systemctl("--failed", "--no-legend", "--plain") == ""


def test_vcan0_is_a_device_unit() -> None:
    assert systemctl("is-active", "sys-subsystem-net-devices-vcan0.device") == "active"


def test_a_device_unit_follows_its_interface() -> None:
    subprocess.run("ip link add dev vcan7 type vcan", shell=True, check=True)
    device = "sys-subsystem-net-devices-vcan7.device"
    subprocess.run(["udevadm", "settle"], check=True)
    assert systemctl("is-active", device) == "active"
    subprocess.run("ip link del vcan7", shell=True, check=True)
    subprocess.run(["udevadm", "settle"], check=True)
    assert systemctl("is-active", device, check=False) == "inactive"


def test_the_watchdog_restarts_a_stopped_process() -> None:
    write_unit(PINGING, "Type=notify\nWatchdogSec=2s\nRestart=always\nRestartSec=100ms")
    systemctl("start", "smoke.service")
    assert systemctl("show", "-P", "StatusText", "smoke.service") == "pinging"
    systemctl("kill", "--signal=SIGSTOP", "smoke.service")
    wait_for("NRestarts", "1")
    wait_for("ActiveState", "active")


def test_a_sandboxed_unit_reaches_the_bus_its_credentials_and_the_code() -> None:
    Path("/run/smoke.toml").write_text("hidden", encoding="utf-8")
    write_unit(REPORTING, f"Type=oneshot\n{SANDBOX}")
    systemctl("start", "smoke.service")
    journal = subprocess.run(["journalctl", "-u", "smoke.service", "-o", "cat"], capture_output=True, check=True)
    assert b"uid True secret hidden code /opt/checkout/gateway" in journal.stdout
