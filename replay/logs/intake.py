"""A log of frames becomes a session of a robot: what its core would have made of them, had it only listened.

How this works
--------------
The cycles are those of the robot file's loop, and a frame belongs to the first one that is not before it. What a driver
of the robot takes as the word of a controller, or nobody knows, was received; what it knows but does not take is a
command, and stands where a session has the frames that were sent, with the time at which it was seen. What led to it
(commands, requests, samples) no log tells, so there is none. Mode, events and odometry are what the core says to such
inputs; nobody knows those of then. A log that says nothing for longer than `PAUSE_NS` makes no cycles meanwhile.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from drivers.contract import CanFrame
from gateway.config import RobotConfig
from gateway.core.assembly import build
from gateway.core.engine import Engine
from gateway.types import Inputs
from replay.drive.closed_loop import FIRST_NS
from replay.drive.recording import SessionRecording
from replay.logs.formats import opened
from replay.logs.logged import Account, Clock, LogError, Logged

PAUSE_NS = 10_000_000_000
LATEST_NS = 1 << 62  # of a time; later ones are none
UNLIMITED = 1 << 62  # bytes: sessions that lie there are not deleted for one that is imported
NO_TIME = "frame without a time"


class Imported(NamedTuple):
    """What became of a log. `began_ns`: wall time of its first frame; None where it does not tell.

    `pauses`: longer than PAUSE_NS, for which there are no cycles. `backwards`: frames with a time before that of the
    frame in front of them, which are kept.
    """

    session: Path
    began_ns: int | None
    cycles: int
    received: int
    sent: int
    pauses: int
    backwards: int
    account: Account


class _Seen(NamedTuple):
    time_ns: int
    frame: CanFrame
    sent: bool


class _Ears:
    """Drivers of a robot that only listen: whether a frame is the word of a controller or one to it."""

    def __init__(self, config: RobotConfig) -> None:
        robot = build(config)
        self._drivers = [(group.bus, group.driver) for group in robot.groups]
        self._sensors = [(port.bus, port.driver) for port in robot.ports]

    def is_command(self, frame: CanFrame, *, told: bool) -> bool:
        """`told`: what the log says, which counts where no driver knows the frame."""
        for bus, driver in self._drivers:
            if bus == frame.bus and driver.receive(frame):
                return False
        if any(bus == frame.bus and sensor.receive(frame) is not None for bus, sensor in self._sensors):
            return False
        return told or any(bus == frame.bus and driver.decode(frame) is not None for bus, driver in self._drivers)


class _Intake:
    """Frames one after the other, with times since the first and on the buses of the robot."""

    def __init__(self, config: RobotConfig, buses: Mapping[str, str], interval_ns: int | None) -> None:
        self._buses = buses
        self._interval_ns = interval_ns
        self._ears = _Ears(config)
        self._last_ns: int | None = None
        self.first_ns: int | None = None
        self.unmapped: dict[str, int] = {}
        self.received = self.sent = self.backwards = 0

    def seen(self, frames: Iterable[Logged], account: Account) -> Iterator[_Seen]:
        """Raises LogError."""
        for logged in frames:
            frame = logged.frame
            bus = self._buses.get(frame.bus)
            if bus is None:
                self.unmapped[frame.bus] = self.unmapped.get(frame.bus, 0) + 1
                continue
            time_ns = self._time_ns(logged)
            if time_ns is None:
                account.leave_out(NO_TIME, f"line {account.lines}")
                continue
            yield self._heard(time_ns, frame._replace(bus=bus), told=bool(logged.sent))

    def _time_ns(self, logged: Logged) -> int | None:
        """By the clock of the log, or so much after the frame before."""
        if self._interval_ns is None:
            return logged.time_ns if logged.time_ns is not None and logged.time_ns <= LATEST_NS else None
        return 0 if self._last_ns is None else self._last_ns + self._interval_ns

    def _heard(self, time_ns: int, frame: CanFrame, *, told: bool) -> _Seen:
        if self.first_ns is None:
            self.first_ns = time_ns
        if self._last_ns is not None and time_ns < self._last_ns:
            self.backwards += 1
        self._last_ns = time_ns
        since_ns = FIRST_NS + max(time_ns - self.first_ns, 1 - FIRST_NS)
        sent = self._ears.is_command(frame._replace(received_ns=since_ns), told=told)
        self.sent += sent
        self.received += not sent
        return _Seen(since_ns, frame._replace(received_ns=since_ns), sent)


def channels_of(path: Path) -> dict[str, int]:
    """The channels of a log and how many frames each has. Raises LogError, also if there are none."""
    found: dict[str, int] = {}
    with opened(path) as (frames, account):
        for logged in frames:
            found[logged.frame.bus] = found.get(logged.frame.bus, 0) + 1
    if not found:
        raise LogError(f"{path}: no frame in it: {_in_words(account)}")
    return found


def _in_words(account: Account) -> str:
    left_out = [f"{what} ({one.times}, first at {one.place})" for what, one in account.left_out.items()]
    return f"{account.style}; {', '.join(left_out) or 'nothing else either'}"


def import_log(  # a command line
    path: Path,
    config: RobotConfig,
    text: str,
    origin: str,
    *,
    directory: Path,
    buses: Mapping[str, str],
    interval_ns: int | None = None,
) -> Imported:
    """Make a session of a log. `buses`: by the names of its channels. `interval_ns`: for one that tells no times.

    Raises LogError, ConfigError, RecorderError, WriterDeadError, OSError.
    """
    _check(path, config, buses)
    with opened(path) as (frames, account):
        intake = _Intake(config, buses, interval_ns)
        seen = intake.seen(frames, account)
        first = next(seen, None)
        if account.clock is Clock.NONE and interval_ns is None:
            raise LogError(f"{path}: {account.style} tells no times: say with --interval how far apart its frames are")
        if first is None or intake.first_ns is None:
            raise LogError(f"{path}: no frame of {', '.join(buses)} in it: {_in_words(account)}")
        told = account.clock in {Clock.EPOCH, Clock.WALL} and interval_ns is None
        settings = config.recording.model_copy(update={"disk_budget": UNLIMITED, "min_free": 0})
        recording = SessionRecording(
            config.model_copy(update={"recording": settings}),
            text,
            origin,
            directory=directory,
            started_wall_ns=max(intake.first_ns, 0) if told else 0,
            imported=f"{path.name} ({account.style}, times {account.clock.value})",
        )
        try:
            cycles, pauses = _record(recording, config, first, seen)
            recording.close()
        except BaseException as why:
            recording.discard(why)  # it would say that it is complete
            raise
        for channel, number in intake.unmapped.items():
            account.leave_out(f"frames of channel {channel}, which --map does not tell of: {number}", "all of it")
    began_ns = intake.first_ns if told else None
    return Imported(
        recording.session, began_ns, cycles, intake.received, intake.sent, pauses, intake.backwards, account
    )


def _check(path: Path, config: RobotConfig, buses: Mapping[str, str]) -> None:
    """Whether every channel goes to a bus of the robot, and something goes there at all. Raises LogError."""
    known = [bus.name for bus in config.bus]
    for channel, bus in buses.items():
        if bus not in known:
            raise LogError(f"--map {channel}={bus}: this robot has no bus {bus}, but {', '.join(known)}")
    if not buses:
        found = ", ".join(f"{name} ({number} frames)" for name, number in channels_of(path).items())
        raise LogError(f"{path}: say with --map CHANNEL=BUS which is which: it has {found}; buses: {', '.join(known)}")


def _record(recording: SessionRecording, config: RobotConfig, first: _Seen, rest: Iterator[_Seen]) -> tuple[int, int]:
    """How many cycles there are, and how many pauses between them."""
    engine = Engine(config)
    period_ns = round(1e9 / config.loop.rate)
    number, now_ns, pauses = 0, FIRST_NS, 0
    waiting: _Seen | None = first
    while waiting is not None:
        if waiting.time_ns - now_ns > PAUSE_NS:
            pauses += 1
            now_ns += (waiting.time_ns - now_ns) // period_ns * period_ns
        received: list[CanFrame] = []
        sent: list[CanFrame] = []
        while waiting is not None and waiting.time_ns <= now_ns:
            (sent if waiting.sent else received).append(waiting.frame)
            waiting = next(rest, None)
        inputs = Inputs(number, now_ns, tuple(received))
        outputs = engine.step(inputs)._replace(frames=tuple(sent))
        recording.put(inputs, outputs, engine.snapshot)
        number, now_ns = number + 1, now_ns + period_ns
    return number, pauses
