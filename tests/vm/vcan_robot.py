"""Service, simulated robot and client as three processes on a real kernel bus, and a listener beside them."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from gateway.client import Client
from gateway.messages import StateMessage
from gateway.types import Mode
from replay.session import Session, open_session
from tests.world import ROBOTS

START_S = 60.0
WAIT_S = 20.0
STREAM_HZ = 50.0
RATE_HZ = 100.0  # what the virtual machine holds at ease; 250 Hz only on an idle host
TICK_MS = 4

Condition = Callable[[StateMessage], bool]


class Heard(NamedTuple):
    """One line of candump; `wall_ns` is the kernel's stamp."""

    wall_ns: int
    id: int
    data: bytes


def shell(command: str) -> str:
    """Output of a shell command that must succeed."""
    return subprocess.run(command, shell=True, check=True, capture_output=True, text=True).stdout


def fresh_vcan0() -> None:
    shell("ip link del vcan0 2>/dev/null; ip link add dev vcan0 type vcan; ip link set vcan0 up")


def robot_file(name: str, directory: Path, channel: str) -> Path:
    """The bundled robot at a pace for the virtual machine."""
    text = (ROBOTS / f"{name}.toml").read_text(encoding="utf-8")
    for before, after in (
        ("rate = 250.0", f"rate = {RATE_HZ}"),
        ("feedback_rate = 1000.0", "feedback_rate = 200.0"),
        ('channel = "can0"', f'channel = "{channel}"'),
    ):
        text = text.replace(before, after)
    path = directory / f"{name}-{channel}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def drivegate(*arguments: str, log: Path) -> subprocess.Popen[bytes]:
    """A process of ours."""
    with log.open("ab") as output:
        command = [sys.executable, "-m", "gateway", *arguments]
        return subprocess.Popen(command, stdout=output, stderr=output, stdin=subprocess.DEVNULL)


def end(process: subprocess.Popen[bytes], number: int = signal.SIGTERM) -> int:
    """Ends a process if it still runs; its exit code."""
    if process.poll() is None:
        process.send_signal(number)
    return process.wait(60.0)


@contextmanager
def candump(log: Path, channel: str = "vcan0") -> Iterator[None]:
    """Listens on the bus into a file."""
    with log.open("wb") as output, subprocess.Popen(["candump", "-L", channel], stdout=output) as process:
        try:
            yield
        finally:
            process.terminate()


def heard(log: Path) -> list[Heard]:
    """The data frames of a candump log; a line that is not finished yet is left out."""
    frames = []
    for line in log.read_text(encoding="ascii").splitlines(keepends=True):
        if not line.endswith("\n"):
            break
        stamp, _, frame = line.split()
        identifier, _, data = frame.partition("#")
        if len(identifier) == 3 and not data.startswith("R"):
            frames.append(Heard(round(float(stamp[1:-1]) * 1e9), int(identifier, 16), bytes.fromhex(data)))
    return frames


class VcanRobot:
    """The three of them. The service must never need a restart; the simulated robot can be killed and started."""

    def __init__(
        self, name: str, directory: Path, port: int, *, channel: str = "vcan0", motors: str | None = None
    ) -> None:
        self.name = name
        self.directory = directory
        self.file = robot_file(name, directory, channel)
        self.log = directory / "log"
        self.sessions = directory / "sessions"
        self.sessions.mkdir()
        self.endpoint, self.truth_endpoint = (f"tcp/127.0.0.1:{number}" for number in (port, port + 1))
        self._motors_channel = motors or channel
        self.start_motors()
        self.service = drivegate(
            "run", str(self.file), "--out", str(self.sessions), "--endpoint", self.endpoint, log=self.log
        )
        self.client = Client(name, connect=[self.endpoint, self.truth_endpoint])
        assert self.client.wait_alive(START_S), self.words()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.client.close()
        end(self.service)
        end(self.motors)

    def start_motors(self) -> None:
        """Power on: the simulated controllers and robot, at the origin."""
        arguments = ("--channel", self._motors_channel, "--tick", str(TICK_MS), "--endpoint", self.truth_endpoint)
        self.motors = drivegate("sim", str(self.file), *arguments, log=self.log)

    def words(self) -> str:
        """For a failed assertion."""
        return f"{self.client.state()}\n{self.log.read_text(encoding='utf-8')}"

    def stream(
        self,
        twist: tuple[float, float, float],
        until: Condition,
        *,
        source: str = "teleop",
        timeout: float = WAIT_S,
    ) -> StateMessage:
        """Sends this twist until a fresh state satisfies the condition."""
        deadline = time.monotonic() + timeout
        seen = self.client.state()
        while time.monotonic() < deadline:
            self.client.send_twist(*twist, source=source)
            found = self.client.wait_for_state(lambda state: state is not seen and until(state), 1.0 / STREAM_HZ)
            if found is not None:
                return found
        raise AssertionError(f"not reached in {timeout} s: {self.words()}")

    def watch(self, until: Condition, timeout: float = WAIT_S) -> StateMessage:
        """Waits in silence until a fresh state satisfies the condition."""
        seen = self.client.state()
        found = self.client.wait_for_state(lambda state: state is not seen and until(state), timeout)
        assert found is not None, f"not reached in {timeout} s: {self.words()}"
        return found

    def start(self) -> StateMessage:
        return self.stream((0.0, 0.0, 0.0), in_mode(Mode.DRIVE))

    def drive(self, vx: float = 0.3) -> StateMessage:
        """Starts and drives forward at speed."""
        self.start()
        return self.stream((vx, 0.0, 0.0), faster_than(0.8 * vx))

    def finish(self) -> Session:
        """Ends the service as systemd would; its session."""
        assert end(self.service) == 0, self.words()
        (folder,) = self.sessions.iterdir()
        return open_session(folder)


def in_mode(*modes: Mode) -> Condition:
    return lambda state: state.status.mode in modes


def faster_than(speed: float) -> Condition:
    return lambda state: state.status.twist is not None and abs(state.status.twist.vx) > speed


def standing(state: StateMessage) -> bool:
    return state.status.standing is True and not state.status.limits_active


def sent(session: Session) -> Iterable[tuple[int, int, bytes]]:
    """Every frame that the session says was sent: time of its cycle, id, data."""
    for inputs, outputs in session.cycles():
        for frame in outputs.frames:
            if not frame.remote:
                yield inputs.now_ns, frame.id, frame.data
