"""The recorded commands once more in virtual time: engine, simulated robot and all its buses in one process.

How this works
--------------
Nothing here waits: a cycle is over when it is computed, so a drive takes as long as the computer needs. That is only
honest because everything that has a clock gets this one: core, drivers, controllers, sensors, wires and commanders. A
live service has others besides (the kernel's, the network's, those of its threads), and none of it is in here: neither
Zenoh nor sockets, neither lateness nor the recorder's process. That is what `redrive`, on a kernel bus, is for.

As there, the motors are first waited for; then every command, request and sample of a sensor is given at its recorded
time (`recorded_drive.asked`); the end is asked for at rest, and the new session is compared with the recorded one.
"""

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from gateway.config import parse
from gateway.service import ending_ns
from gateway.types import Mode, Outputs, Request, RequestKind, SensorSample, Status, TwistCommand
from replay.compare.likeness import Comparison, compare, moments
from replay.drive.closed_loop import ClosedLoop
from replay.drive.commanders import Commanders
from replay.drive.recorded_drive import REST_S, Asked, RedriveError, asked, is_shutdown, plant_told
from replay.drive.recording import SessionRecording
from replay.sessions.reader import Session, open_session
from replay.sim.robot import chosen_plant

READY_S = 60.0  # virtual, as everything here
_SECOND_NS = 1_000_000_000


class Redriven(NamedTuple):
    """How it compares, and how long the drive was, virtual s from the first cycle to the last."""

    comparison: Comparison
    seconds: float


def redrive_virtually(session: Session, *, out: Path, started_wall_ns: int) -> Redriven:
    """Drive again and compare; the new session goes into `out` and begins at that wall time.

    Raises RedriveError, SessionError, ConfigError, RecorderError, OSError.
    """
    origin = "robot file of the session"
    config = parse(session.config_text, origin)
    told, plant = asked(session), plant_told(session)
    loop = ClosedLoop(config, plant=chosen_plant(config, plant, origin))
    recording = SessionRecording(
        config, session.config_text, origin, directory=out, started_wall_ns=started_wall_ns, plant=plant
    )
    try:
        begin_ns = loop.next_ns
        _Drive(loop, recording).run(told)
    finally:
        recording.close()
    path = recording.session
    try:
        found = compare(moments(session), moments(open_session(path)), config, str(path))
    except ValueError as error:
        raise RedriveError(str(error)) from None
    return Redriven(found, (loop.now_ns - begin_ns) / _SECOND_NS)


class _Drive:
    """State of one run."""

    def __init__(self, loop: ClosedLoop, recording: SessionRecording) -> None:
        self._loop = loop
        self._recording = recording
        self._commanders = Commanders()
        self._waiting: deque[Request | SensorSample] = deque()
        self._status: Status | None = None

    def run(self, told: Sequence[tuple[int, Asked]]) -> None:
        """Wait for the motors, give everything, come to rest, end. Raises RedriveError."""
        self._await_ready()
        start_ns = self._loop.next_ns
        due = [one._replace(received_ns=start_ns + due_ns) for due_ns, one in told]
        self._commanders = Commanders([one for one in due if isinstance(one, TwistCommand)])
        self._waiting.extend(one for one in due if not isinstance(one, TwistCommand))
        last_ns = due[-1].received_ns
        if not any(is_shutdown(one) for one in due):
            self._go_on(last_ns)
            self._go_on(last_ns + round(REST_S * _SECOND_NS), rest=True)
            last_ns = self._loop.next_ns
            self._waiting.append(Request(RequestKind.SHUTDOWN, 0, last_ns))
        self._go_on(last_ns + ending_ns(self._loop.config))  # as long as the service waits for it

    def _await_ready(self) -> None:
        end_ns = self._loop.next_ns + round(READY_S * _SECOND_NS)
        while self._loop.next_ns < end_ns:
            self._cycle()
            if self._status is not None and self._status.mode is Mode.IDLE and not self._status.faults:
                return
        reason = "it tells nothing" if self._status is None else self._status.reason
        raise RedriveError(f"the robot does not get ready: {reason}")

    def _go_on(self, until_ns: int, *, rest: bool = False) -> None:
        """Until then or its orderly end; with `rest` until it stands and nobody commands it."""
        while self._loop.next_ns <= until_ns and not (rest and self._rests()):
            if self._cycle().finished:
                return

    def _rests(self) -> bool:
        status = self._status
        return status is not None and status.standing is True and status.winner is None

    def _cycle(self) -> Outputs:
        now_ns = self._loop.next_ns
        requests: list[Request] = []
        samples: dict[str, SensorSample] = {}  # the newest of each, as a mailbox keeps them
        while self._waiting and self._waiting[0].received_ns <= now_ns:
            one = self._waiting.popleft()
            if isinstance(one, SensorSample):
                samples[one.source] = one
            else:
                requests.append(one)
        inputs, outputs = self._loop.cycle(
            commands=self._commanders.drain(now_ns), requests=requests, samples=samples.values()
        )
        self._recording.put(inputs, outputs, self._loop.engine.snapshot)
        self._status = outputs.status or self._status
        return outputs
