"""The recorded commands once more, through the live service and the simulated robot on a bus: does it drive alike?

How this works
--------------
Service and simulated robot are processes of their own, as in real use; only the channels of the recorded robot file
are replaced. Every command, emergency stop and reset is given again at its recorded time, counted from the first of
them. Then both sessions, the recorded and the new one, are run through the core, which yields pose, wheel speeds and
modes of every cycle, and compared over the same time. Equal they cannot be: times of arrival differ, and so did the
real robot, if it was one; the thresholds say what counts as alike.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import groupby, pairwise
from math import cos, dist, pi, sin, sqrt
from pathlib import Path
from typing import NamedTuple

from gateway.can_bus import interface_exists
from gateway.client import Client
from gateway.config import RobotConfig, parse
from gateway.engine import Engine
from gateway.types import Mode, Pose, Request, RequestKind, TwistCommand
from replay.session import Session, open_session

READY_S = 60.0
REST_S = 15.0
END_S = 40.0
GRID_NS = 20_000_000

END_M, END_RAD = 0.05, 0.05  # plus 2 % of the path: lateness of single commands, at speed
LARGEST_M = 0.10
PATH_SHARE = 0.02
WHEELS_SHARE = 0.05  # rms of the differences, of the top speed of each wheel


class RedriveError(Exception):
    """The drive cannot be repeated; the text says why."""


class Moment(NamedTuple):
    """One cycle of a drive, in time since its first command."""

    time_ns: int
    pose: Pose
    wheels: tuple[float | None, ...]
    mode: Mode


class Comparison(NamedTuple):
    """How the second drive differs from the first; `reasons` is empty if they are alike."""

    path_m: float
    end_m: float
    end_rad: float
    largest_m: float
    wheels_rms: float  # share of the top speed, worst wheel
    modes_recorded: tuple[str, ...]
    modes_redriven: tuple[str, ...]
    reasons: tuple[str, ...]
    session: str

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        return {"similar": not self.reasons, **self._asdict()}


def redrive(session: Session, *, channel: str, out: Path, tick_ms: int) -> Comparison:
    """Drive again on this virtual channel and compare. Raises RedriveError, SessionError, ConfigError, LinkError."""
    _check_channel(channel)
    config = parse(session.config_text, "robot file of the session")
    given = _given(session)
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="drivegate-")))
        file = folder / f"{config.robot.name}.toml"
        file.write_text(as_toml(_on_channel(config, channel)), encoding="utf-8")
        stack.enter_context(_process("sim", str(file), "--tick", str(tick_ms)))
        service = stack.enter_context(_process("run", str(file), "--out", str(out), "--endpoint", endpoint))
        client = stack.enter_context(Client(config.robot.name, connect=[endpoint]))
        _await_ready(client, service)
        _give(given, client)
        path = _finish(client, service)
    return compare(moments(session), moments(open_session(path)), config, str(path))


def moments(session: Session) -> list[Moment]:
    """Every cycle of a session from its first command on, as the core says it was."""
    engine = Engine(parse(session.config_text, "robot file of the session"))
    origin_ns = None
    found: list[Moment] = []
    for inputs, _ in session.cycles():
        if origin_ns is None and inputs.commands:
            origin_ns = inputs.commands[0].received_ns
        outputs = engine.step(inputs)
        if origin_ns is not None:
            trace = outputs.trace
            found.append(Moment(inputs.now_ns - origin_ns, trace.pose, trace.wheel_speeds, outputs.mode))
    return found


def compare(first: Sequence[Moment], second: Sequence[Moment], config: RobotConfig, session: str) -> Comparison:
    """Both drives over the time that both cover, each counted from where it began."""
    pairs = list(_pairs(first, second))
    if not pairs:
        raise RedriveError("one of the drives holds no commands")
    here = [(_since(one.pose, first[0].pose), _since(other.pose, second[0].pose)) for one, other in pairs]
    path = sum(dist(a[0][:2], b[0][:2]) for a, b in pairwise(here))
    end, other_end = here[-1]
    tops = [config.limits.motor_speed[motor.name] for motor in config.motors_in_order()]
    found = Comparison(
        path_m=round(path, 4),
        end_m=round(dist(end[:2], other_end[:2]), 4),
        end_rad=round(abs(_turn(end.theta - other_end.theta)), 4),
        largest_m=round(max(dist(a[:2], b[:2]) for a, b in here), 4),
        wheels_rms=round(max(_rms(pairs, index) / top for index, top in enumerate(tops)), 4),
        modes_recorded=_modes(one.mode for one, _ in pairs),
        modes_redriven=_modes(other.mode for _, other in pairs),
        reasons=(),
        session=session,
    )
    return found._replace(reasons=tuple(_reasons(found)))


def as_toml(config: RobotConfig) -> str:
    """A robot file with the same content; every table is written inline."""
    document = config.model_dump(mode="json", exclude_none=True)
    return "".join(f"{key} = {_toml(value)}\n" for key, value in document.items())


def _toml(value: object) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(key)} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def _check_channel(channel: str) -> None:
    if not channel.startswith(("vcan", "vxcan")):
        raise RedriveError(f"{channel} may lead to motors: a simulated robot belongs on vcan or vxcan")
    if not interface_exists(channel):
        raise RedriveError(f"there is no CAN interface {channel} on this machine")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _on_channel(config: RobotConfig, channel: str) -> RobotConfig:
    buses = [bus.model_copy(update={"interface": "socketcan", "channel": channel}) for bus in config.bus]
    return config.model_copy(update={"bus": buses})


def _given(session: Session) -> list[tuple[int, TwistCommand | Request]]:
    """What was asked of the robot, in order of arrival, in time since the first command."""
    asked: list[TwistCommand | Request] = []
    for inputs, _ in session.cycles():
        asked += inputs.commands
        asked += [request for request in inputs.requests if request.kind is not RequestKind.SHUTDOWN]
    first_ns = next((one.received_ns for one in asked if isinstance(one, TwistCommand)), None)
    if first_ns is None:
        raise RedriveError("nothing was commanded in this session")
    return sorted(((max(one.received_ns - first_ns, 0), one) for one in asked), key=lambda pair: pair[0])


@contextmanager
def _process(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """One of our commands as a process, ended with SIGTERM if it has not ended by itself."""
    command = [sys.executable, "-m", "gateway", *arguments]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, env=os.environ)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _await_ready(client: Client, service: subprocess.Popen[bytes]) -> None:
    """The service listens, every motor answers, and it waits for a command."""
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        if service.poll() is not None:
            raise RedriveError(f"the service ended with exit code {service.returncode}")
        if client.wait_for_state(lambda state: state.status.mode is Mode.IDLE and not state.status.faults, 0.5):
            return
    state = client.state()
    raise RedriveError(f"the service does not get ready: {state.status.reason if state else 'no state received'}")


def _give(given: Sequence[tuple[int, TwistCommand | Request]], client: Client) -> None:
    begin_ns = time.monotonic_ns()
    for due_ns, one in given:
        time.sleep(max(0.0, (begin_ns + due_ns - time.monotonic_ns()) * 1e-9))
        if isinstance(one, TwistCommand):
            client.send_twist(*one.twist, source=one.source, frame=one.frame)
        elif one.kind is RequestKind.ESTOP:
            client.stop()
        else:
            client.reset()


def _finish(client: Client, service: subprocess.Popen[bytes]) -> Path:
    """Wait for rest, end the service; its session."""
    client.wait_for_state(lambda state: state.status.standing is True and state.status.winner is None, REST_S)
    state = client.state()
    recording = state.extras.get("recording") if state else None
    service.send_signal(signal.SIGTERM)
    service.wait(END_S)
    if not isinstance(recording, dict) or not recording.get("session"):
        raise RedriveError("the service did not record")
    return Path(str(recording["session"]))


def _pairs(first: Sequence[Moment], second: Sequence[Moment]) -> Iterator[tuple[Moment, Moment]]:
    """Both drives at the same times."""
    if not first or not second:
        return
    times = [[moment.time_ns for moment in drive] for drive in (first, second)]
    for time_ns in range(max(times[0][0], times[1][0]), min(times[0][-1], times[1][-1]) + 1, GRID_NS):
        yield first[bisect_right(times[0], time_ns) - 1], second[bisect_right(times[1], time_ns) - 1]


def _since(pose: Pose, origin: Pose) -> Pose:
    """Where it is, seen from where the drive began."""
    c, s = cos(origin.theta), sin(origin.theta)
    x, y = pose.x - origin.x, pose.y - origin.y
    return Pose(c * x + s * y, c * y - s * x, _turn(pose.theta - origin.theta))


def _turn(angle: float) -> float:
    """The same angle between -pi and pi."""
    return (angle + pi) % (2.0 * pi) - pi


def _rms(pairs: Sequence[tuple[Moment, Moment]], index: int) -> float:
    differences = [
        (one.wheels[index] or 0.0) - (other.wheels[index] or 0.0)
        for one, other in pairs
        if one.wheels[index] is not None and other.wheels[index] is not None
    ]
    return sqrt(sum(difference**2 for difference in differences) / max(len(differences), 1))


def _modes(modes: Iterable[Mode]) -> tuple[str, ...]:
    """Each mode once for as long as it lasted."""
    return tuple(mode.value for mode, _ in groupby(modes))


def _reasons(found: Comparison) -> Iterator[str]:
    """Every threshold that is exceeded, in words."""
    limits = (
        ("the ends lie apart", found.end_m, END_M + PATH_SHARE * found.path_m, "m"),
        ("the headings at the end differ", found.end_rad, END_RAD, "rad"),
        ("the paths are apart", found.largest_m, LARGEST_M + PATH_SHARE * found.path_m, "m"),
        ("the wheel speeds differ by", found.wheels_rms, WHEELS_SHARE, "of the top speed (rms)"),
    )
    for words, value, limit, unit in limits:
        if value > limit:
            yield f"{words}: {value:.3f} {unit}, allowed {limit:.3f}"
    if found.modes_recorded != found.modes_redriven:
        yield f"modes: {' '.join(found.modes_recorded)}, then {' '.join(found.modes_redriven)}"
