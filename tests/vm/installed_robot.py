"""The service as install.sh installs it, under the machine's own systemd, and the simulated robot on vcan0."""

import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from gateway.client import Client
from gateway.edges.messages import StateMessage
from gateway.recording.disk import INCIDENTS
from gateway.types import Mode
from tests.vm.launcher import CHECKOUT
from tests.vm.vcan_robot import Condition, in_mode, shell
from tests.world import ROBOTS

UNIT = "drivegate@moby.service"
CONFIG = Path("/etc/drivegate")
SESSIONS = Path("/var/lib/drivegate/moby")
INSTALL = CHECKOUT / "deploy" / "install.sh"
RATE_HZ = 50.0  # what the virtual machine holds at ease, with two real-time processes and tests on one slow CPU
STREAM_HZ = 20.0
HELD_UP_S = 0.4  # between two commands: less than the motors' watchdog and the timeout of the commands
DEVICE_WATCHDOG_S = 0.5
WAIT_S = 90.0
POLL_S = 0.3  # asking costs a process, and those are slow here
NODES = (1, 2, 3)
ORDINARY = (os.SCHED_OTHER, os.SCHED_BATCH)

# The simulated ODrives, asked directly: a remote frame of the heartbeat does not feed their watchdog.
_CAN_FRAME = struct.Struct("=IB3x8s")
_HEARTBEAT, _CLOSED_LOOP = 0x01, 8


def robot_text() -> str:
    """Moby at a pace for the virtual machine, on vcan0."""
    text = (ROBOTS / "moby.toml").read_text(encoding="utf-8")
    for before, after in (
        ("feedback_rate = 250.0", "feedback_rate = 10.0"),  # silent only after half a second
        ("rate = 250.0", f"rate = {RATE_HZ}"),
        ('channel = "can0"', 'channel = "vcan0"'),
        ("watchdog = { timeout = 0.1 }", f"watchdog = {{ timeout = {DEVICE_WATCHDOG_S} }}"),
        ("timeout = 0.3 ", "timeout = 1.0 "),  # of teleop
    ):
        assert before in text
        text = text.replace(before, after)
    return text + "\n[recording]\nmin_free = 1_000_000\n"


class Done(NamedTuple):
    """A finished command."""

    code: int
    output: str


def run(*command: str | Path) -> Done:
    """A command with both of its outputs."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return Done(done.returncode, done.stdout.strip())


def systemctl(*arguments: str) -> str:
    """Output of a systemctl that must succeed."""
    done = run("systemctl", *arguments)
    assert done.code == 0, done.output
    return done.output


def show(name: str, unit: str = UNIT) -> str:
    """One property of a unit."""
    return systemctl("show", "-P", name, unit)


def wait_for(condition: Callable[[], bool], what: str, *, timeout: float = WAIT_S) -> None:
    """Until it holds; what the service says if it does not."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not within {timeout:g} s\n{journal()[-6000:]}"
        time.sleep(POLL_S)


def wait_active(*, restarts: int | None = None) -> None:
    """Until the service is ready (after so many restarts)."""
    if restarts is not None:
        wait_for(lambda: int(show("NRestarts")) >= restarts, f"restart {restarts}")
    wait_for(lambda: show("ActiveState") == "active", "active")


def journal(unit: str = UNIT) -> str:
    """Everything the unit and systemd about it have said since boot."""
    return run("journalctl", "--no-pager", "-o", "cat", "-u", unit).output


def install(*arguments: str) -> Done:
    """install.sh, using the machine's own environment of this checkout."""
    return run("sh", INSTALL, "--no-venv", *arguments)


def newest_session() -> Path:
    """Folder of the session started last."""
    folders = (path for path in SESSIONS.iterdir() if path.is_dir() and path.name != INCIDENTS)
    return max(folders, key=lambda path: path.stat().st_ctime_ns)


def main_pid() -> int:
    """Process id of the service."""
    return int(show("MainPID"))


def recorder_pid() -> int:
    """Process id of the only child of its only child, which starts recorders."""
    return _only_child(_only_child(main_pid()))


def _only_child(process: int) -> int:
    children = run("ps", "-o", "pid=", "--ppid", str(process)).output.split()
    assert len(children) == 1, children
    return int(children[0])


def armed_nodes() -> set[int]:
    """Node ids of the simulated motors that are in closed loop right now."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind(("vcan0",))
        bus.settimeout(WAIT_S)
        for node in NODES:
            bus.send(_CAN_FRAME.pack((node << 5 | _HEARTBEAT) | socket.CAN_RTR_FLAG, 8, b""))
        states: dict[int, int] = {}
        while len(states) < len(NODES):
            identifier, length, data = _CAN_FRAME.unpack(bus.recv(_CAN_FRAME.size))
            if identifier & 0x1F == _HEARTBEAT and not identifier & socket.CAN_RTR_FLAG and length == 8:
                states[identifier >> 5] = data[4]
    return {node for node, state in states.items() if state == _CLOSED_LOOP}


class Motors:
    """The simulated robot; can be switched off and on."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None

    def on(self) -> None:
        """Start it unless it runs; returns when its motors answer."""
        if self._process is None:
            # A motor controller is real-time hardware: it does not wait for the service or the tests.
            python = ["chrt", "--fifo", "50", sys.executable]
            command = [*python, "-m", "gateway", "sim", str(CONFIG / "moby.toml"), "--tick", "10"]
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        armed_nodes()

    def off(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.send_signal(signal.SIGTERM)
            self._process.wait(WAIT_S)
            self._process = None


class Commander:
    """A commander that streams its twist all the time, whether the service lives or not."""

    def __init__(self) -> None:
        self.client = Client("moby")
        self._twist: tuple[float, float, float] | None = None
        self._longest_s = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._stream, daemon=True)
        self._thread.start()

    def say(self, vx: float, vy: float = 0.0, wz: float = 0.0) -> None:
        """Stream this from now on."""
        self._twist = (vx, vy, wz)

    def silence(self) -> None:
        """Stream nothing."""
        self._twist = None

    def await_state(self, condition: Condition, timeout: float = WAIT_S) -> StateMessage:
        """The next state that satisfies the condition."""
        seen = self.client.state()
        found = self.client.wait_for_state(lambda state: state is not seen and condition(state), timeout)
        assert found is not None, f"not within {timeout:g} s: {self.client.state()}\n{journal()[-6000:]}"
        return found

    def states(self, count: int) -> Iterator[StateMessage]:
        """The next so many states."""
        for _ in range(count):
            yield self.await_state(lambda _: True)

    def start(self) -> None:
        """Zero until the robot drives."""
        self.say(0.0)
        self.await_state(in_mode(Mode.DRIVE))

    def held_up(self) -> bool:
        """Whether this machine, commander included, has stood still so long that the robot may rightly have stopped."""
        return self._longest_s > HELD_UP_S

    def close(self) -> None:
        """Leave."""
        self._ended.set()
        self._thread.join()
        self.client.close()

    def _stream(self) -> None:
        last = time.monotonic()
        while not self._ended.wait(1.0 / STREAM_HZ):
            now = time.monotonic()
            self._longest_s, last = max(self._longest_s, now - last), now
            twist = self._twist
            if twist is not None:
                self.client.send_twist(*twist, source="teleop")


@contextmanager
def installation(log: Path) -> Iterator[Motors]:
    """Installed and bound to vcan0, recordings on a small disk of their own; starting, with vcan0 down."""
    SESSIONS.mkdir(parents=True)
    shell(f"mount -t tmpfs -o size=64m tmpfs {SESSIONS}")
    first = install()
    assert first.code == 0, first.output
    (CONFIG / "moby.toml").write_text(robot_text(), encoding="utf-8")
    (CONFIG / "tls" / "ca.pem").write_text("a certificate", encoding="utf-8")
    shell("ip link set vcan0 down")
    second = install("--enable", "moby")
    assert second.code == 0, second.output
    motors = Motors(log)
    try:
        yield motors
    finally:
        motors.off()
