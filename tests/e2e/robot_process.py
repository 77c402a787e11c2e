"""A gateway as a user runs it: a process of its own, here with the simulated robot, and a client beside it."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from gateway.client import Client
from gateway.edges.messages import StateMessage
from gateway.recording.disk import INCIDENTS
from gateway.types import Mode
from replay.compare.verify import Verdict, verify
from replay.sessions.reader import open_session
from tests.world import ROBOTS

START_S = 40.0
STREAM_HZ = 50.0


class RobotProcess:
    """`drivegate run` on loopback. Ends with SIGTERM unless the test ended it."""

    def __init__(
        self,
        name: str,
        directory: Path,
        port: int,
        *arguments: str,
        stderr: int | None = None,
        wait: bool = True,
        module: str = "gateway",
        file: Path | None = None,
    ) -> None:
        self.name = name
        self.directory = directory
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self.log = directory / "service.log"
        # Tests started with nohup ignore SIGHUP, and so would every process of theirs.
        command = ["env", "--default-signal=HUP", sys.executable, "-m", module]
        command += ["run", str(file or ROBOTS / f"{name}.toml")]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [*command, *(arguments or ("--simulate",)), "--out", str(directory), "--endpoint", self.endpoint],
                stderr=log if stderr is None else stderr,
                stdin=subprocess.DEVNULL,
            )
        self.client = Client(name, connect=[self.endpoint])
        assert not wait or self.client.wait_alive(START_S), self.log.read_text()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.client.close()
        if self.process.poll() is None:
            self.end()

    def end(self, number: int = signal.SIGTERM) -> int:
        self.process.send_signal(number)
        try:
            return self.process.wait(60.0)
        finally:
            self.process.kill()  # in case it has not ended

    def listens_to(self, number: int) -> bool:
        """Whether the process has a handler for this signal."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        (caught,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigCgt"))
        return bool(int(caught, 16) >> (number - 1) & 1)

    def stream(
        self,
        vx: float,
        vy: float,
        wz: float,
        *,
        until: Callable[[StateMessage], bool],
        source: str = "teleop",
        timeout: float = 15.0,
    ) -> StateMessage:
        """Sends this twist until a state satisfies the condition."""
        deadline = time.monotonic() + timeout
        seen = self.client.state()
        while time.monotonic() < deadline:
            self.client.send_twist(vx, vy, wz, source=source)
            found = self.client.wait_for_state(lambda state: state is not seen and until(state), 1.0 / STREAM_HZ)
            if found is not None:
                return found
        raise AssertionError(f"not reached in {timeout} s: {self.client.state()}\n{self.log.read_text()}")

    def await_state(self, condition: Callable[[StateMessage], bool], timeout: float = 15.0) -> StateMessage:
        """Waits in silence until a state satisfies the condition."""
        found = self.client.wait_for_state(condition, timeout)
        assert found is not None, f"not reached in {timeout} s: {self.client.state()}\n{self.log.read_text()}"
        return found

    def start(self) -> StateMessage:
        return self.stream(0.0, 0.0, 0.0, until=in_mode(Mode.DRIVE))

    def verify(self) -> Verdict:
        sessions = sorted(path for path in self.directory.iterdir() if path.is_dir() and path.name != INCIDENTS)
        return verify(open_session(sessions[-1]))


def in_mode(*modes: Mode) -> Callable[[StateMessage], bool]:
    return lambda state: state.status.mode in modes


def kept_out(source: str, reason: str) -> Callable[[StateMessage], bool]:
    """Whether a source does not drive for this reason."""
    return lambda state: any(one.name == source and one.reason == reason for one in state.status.sources)


def faster_than(speed: float) -> Callable[[StateMessage], bool]:
    return lambda state: state.status.twist is not None and abs(state.status.twist.vx) > speed


def standing(state: StateMessage) -> bool:
    return state.status.standing is True and not state.status.limits_active
