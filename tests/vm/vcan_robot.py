"""Service, simulated robot and client as three processes on a real kernel bus, and a listener beside them."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from math import dist
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from gateway.client import Client
from gateway.edges.messages import StateMessage, TruthMessage
from gateway.recording.disk import INCIDENTS
from gateway.types import Mode
from replay.sessions.reader import Session, open_session
from tests.world import ROBOTS

START_S = 60.0
WAIT_S = 20.0
STREAM_HZ = 50.0
RATE_HZ = 100.0  # what the virtual machine holds at ease; 250 Hz only on an idle host
TICK_MS = 5
SENSOR_HZ = 50.0
ZERO, GO = (0.0, 0.0, 0.0), (0.3, 0.0, 0.0)
REST_S, STILL_M = 0.3, 0.001  # a robot that moved less than this in that time has come to rest

_SENSOR = re.compile(r"timeout = 0\.0[35](\nbus = .+\n(?:.+\n)+?)rate = [0-9.]+")  # one on a bus
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
    """The bundled robot at a pace for the virtual machine, on this channel."""
    text = paced((ROBOTS / f"{name}.toml").read_text(encoding="utf-8"))
    path = directory / f"{name}-{channel}.toml"
    path.write_text(text.replace('channel = "can0"', f'channel = "{channel}"'), encoding="utf-8")
    return path


def paced(text: str) -> str:
    """A robot file at a pace for the virtual machine, which stalls: silence of anybody counts later."""
    for before, after in (
        ("feedback_rate = 1000.0", "feedback_rate = 30.0"),
        ("speed_loop = { kp = 3.5, ki = 14.0 }", "speed_loop = { kp = 0.3, ki = 0.6 }"),
        ("feedback_rate = 250.0", "feedback_rate = 25.0"),
        ("priority = 100, timeout = 0.3", "priority = 100, timeout = 1.0"),
        ("priority = 10, timeout = 0.2", "priority = 10, timeout = 1.0"),
        ("[loop]\nrate = 250.0", f"[loop]\nrate = {RATE_HZ}"),
        ("watchdog = { timeout = 0.1", "watchdog = { timeout = 0.5"),
    ):
        text = text.replace(before, after)
    return _SENSOR.sub(rf"timeout = 0.5\1rate = {SENSOR_HZ}", text)


def drivegate(*arguments: str, log: Path, stderr: int | None = None) -> subprocess.Popen[bytes]:
    """A process of ours; its errors go to the log too, or to a descriptor given."""
    with log.open("ab") as output:
        command = ["env", "--default-signal=HUP", sys.executable, "-m", "gateway", *arguments]  # also under nohup
        errors = output if stderr is None else stderr
        return subprocess.Popen(command, stdout=output, stderr=errors, stdin=subprocess.DEVNULL)


def end(process: subprocess.Popen[bytes], number: int = signal.SIGTERM) -> int:
    """Ends a process if it still runs; its exit code."""
    if process.poll() is None:
        process.send_signal(number)
    return process.wait(60.0)


@contextmanager
def candump(log: Path, *channels: str) -> Iterator[None]:
    """Listens on the bus into a file."""
    with log.open("wb") as output, subprocess.Popen(["candump", "-L", *channels], stdout=output) as process:
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
        identifier, _, data = frame.partition("#")  # error frames have eight digits
        if len(identifier) == 3 and not data.startswith("R"):
            frames.append(Heard(round(float(stamp[1:-1]) * 1e9), int(identifier, 16), bytes.fromhex(data)))
    return frames


class VcanRobot:
    """The three of them. The service must never need a restart; the simulated robot can be killed and started."""

    def __init__(
        self,
        name: str,
        directory: Path,
        port: int,
        *,
        channel: str = "vcan0",
        motors: str | None = None,
        stderr: int | None = None,
    ) -> None:
        self.name = name
        self.directory = directory
        self.file = robot_file(name, directory, channel)
        self.log = directory / "log"
        self.sessions = directory / "sessions"
        self.sessions.mkdir()
        self.endpoint, self.truth_endpoint = (f"tcp/127.0.0.1:{number}" for number in (port, port + 1))
        self._motors_channel = motors or channel
        self.motors: subprocess.Popen[bytes] | None = None
        self.service = self.start_service(stderr)
        self.client = Client(name, connect=[self.endpoint, self.truth_endpoint])
        try:
            self._await_service()
            self.start_motors()
        except AssertionError:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Ends all of them."""
        self.client.close()
        end(self.service)
        if self.motors is not None:
            end(self.motors)

    def kill_motors(self) -> None:
        """Power off, without a word."""
        assert self.motors is not None
        end(self.motors, signal.SIGKILL)

    def start_service(self, stderr: int | None = None) -> subprocess.Popen[bytes]:
        """The service alone, its latch beside the sessions."""
        places = ("--out", str(self.sessions), "--state", str(self.directory), "--endpoint", self.endpoint)
        return drivegate("run", str(self.file), *places, log=self.log, stderr=stderr)

    def restart_service(self) -> None:
        """Another one, after the last has ended in whatever way."""
        self.service = self.start_service()

    def _await_service(self) -> None:
        deadline = time.monotonic() + START_S
        while not self.client.wait_alive(0.5):
            assert self.service.poll() is None, self.words()
            assert time.monotonic() < deadline, self.words()

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

    def start(self, source: str = "teleop") -> StateMessage:
        """Ready to drive; a latched fault is reset first."""
        reason = self.watch(lambda _: True).status.reason or ""
        if reason.endswith("needs a reset"):
            assert self.client.reset().ok, self.words()
        return self.stream(ZERO, in_mode(Mode.DRIVE), source=source)

    def drive(self, twist: tuple[float, float, float] = GO, source: str = "teleop") -> StateMessage:
        """Starts and drives at speed; once more if the machine stalled so long that the motors seemed silent."""
        deadline = time.monotonic() + 3.0 * WAIT_S
        reached = at_speed(twist)
        while time.monotonic() < deadline:
            self.start(source)
            state = self.stream(
                twist, lambda state: state.status.mode is not Mode.DRIVE or reached(state), source=source
            )
            if state.status.mode is Mode.DRIVE:
                return state
        raise AssertionError(f"does not drive: {self.words()}")

    def await_truth_at_rest(self, twist: tuple[float, float, float]) -> TruthMessage:
        """Sends this twist until the simulated robot stands."""
        seen: list[TruthMessage] = []

        def still(_: StateMessage) -> bool:
            truth = self.client.truth()
            if truth is not None and (not seen or truth.t > seen[-1].t + REST_S):
                seen.append(truth)
            return len(seen) > 1 and dist((seen[-1].x, seen[-1].y), (seen[-2].x, seen[-2].y)) < STILL_M

        self.stream(twist, still)
        return seen[-1]

    def finish(self) -> Session:
        """Ends the service as systemd would; its session."""
        assert end(self.service) == 0, self.words()
        return self.session()

    def session(self) -> Session:
        """The only one; incidents may lie beside it."""
        (folder,) = (folder for folder in self.sessions.iterdir() if folder.name != INCIDENTS)
        return open_session(folder)


def in_mode(*modes: Mode) -> Condition:
    return lambda state: state.status.mode in modes


def faster_than(speed: float) -> Condition:
    return lambda state: state.status.twist is not None and abs(state.status.twist.vx) > speed


def at_speed(twist: tuple[float, float, float]) -> Condition:
    """Within a fifth of the commanded speed."""

    def reached(state: StateMessage) -> bool:
        measured = state.status.twist
        return measured is not None and dist(measured, twist) < 0.2 * dist(ZERO, twist)

    return reached


def standing(state: StateMessage) -> bool:
    return state.status.standing is True and not state.status.limits_active


def sent(session: Session) -> Iterable[tuple[int, int, bytes]]:
    """Every frame that the session says was sent: time of its cycle, id, data."""
    for inputs, outputs in session.cycles():
        for frame in outputs.frames:
            if not frame.remote:
                yield inputs.now_ns, frame.id, frame.data
