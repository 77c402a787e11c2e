"""The recorded commands once more, through the live service and the simulated robot on a bus: does it drive alike?

How this works
--------------
Service and simulated robot are processes of their own, as in real use; only the channels of the recorded robot file
are replaced. Every command, emergency stop and reset is given again at its recorded time, counted from the first of
them; the new session is then compared with the recorded one.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gateway.client import Client
from gateway.config import RobotConfig, parse
from gateway.edges.can_bus import interface_exists
from gateway.edges.messages import QUANTITIES
from gateway.types import Mode, Request, RequestKind, SensorSample, TwistCommand
from replay.compare.likeness import Comparison, compare, moments
from replay.sessions.reader import Session, open_session
from replay.sim.plants.contract import PlantName

READY_S = 60.0
Process = subprocess.Popen[bytes]
REST_S = 15.0
END_S = 40.0


class RedriveError(Exception):
    """The drive cannot be repeated; the text says why."""


def redrive(session: Session, *, channel: str, out: Path, tick_ms: int) -> Comparison:
    """Drive again on this virtual channel and compare. Raises RedriveError, SessionError, ConfigError, LinkError."""
    _check_channel(channel)
    config = parse(session.config_text, "robot file of the session")
    given, plant = _given(session), plant_told(session)
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="drivegate-")))
        file = folder / f"{config.robot.name}.toml"
        file.write_text(as_toml(_on_channel(config, channel)), encoding="utf-8")
        stack.enter_context(_process("sim", str(file), "--tick", str(tick_ms), "--plant", plant.value))
        service = stack.enter_context(_process("run", str(file), "--out", str(out), "--endpoint", endpoint))
        client = stack.enter_context(Client(config.robot.name, connect=[endpoint]))
        _await_ready(client, service)
        _give(given, config, client, service)
        path = _finish(client, service, told=any(_is_shutdown(one) for _, one in given))
    try:
        return compare(moments(session), moments(open_session(path)), config, str(path))
    except ValueError as error:
        raise RedriveError(str(error)) from None


def plant_told(session: Session) -> PlantName:
    """By what the robot of the session moved; of a real one, and where nothing is told, the simple plant.

    Raises RedriveError.
    """
    told = session.header.plant
    if told is None:
        return PlantName.SIMPLE
    try:
        return PlantName(told)
    except ValueError:
        raise RedriveError(f"its robot moved by plant {told!r}, which is not known here") from None


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


_Given = TwistCommand | Request | SensorSample


def _given(session: Session) -> list[tuple[int, _Given]]:
    """What was asked of the robot, in order of arrival, in time since the first command."""
    asked: list[_Given] = []
    for inputs, _ in session.cycles():
        asked += inputs.commands
        asked += inputs.requests
        asked += inputs.samples
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


def _await_ready(client: Client, service: Process) -> None:
    """The service listens, every motor answers, and it waits for a command."""
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        if service.poll() is not None:
            raise RedriveError(f"the service ended with exit code {service.returncode}")
        if client.wait_for_state(lambda state: state.status.mode is Mode.IDLE and not state.status.faults, 0.5):
            return
    state = client.state()
    raise RedriveError(f"the service does not get ready: {state.status.reason if state else 'no state received'}")


def _give(given: Sequence[tuple[int, _Given]], config: RobotConfig, client: Client, service: Process) -> None:
    """Everything at its time; a shutdown is the signal that asks for it."""
    kinds = {sensor.name: sensor.kind for sensor in config.sensor}
    begin_ns = time.monotonic_ns()
    for due_ns, one in given:
        time.sleep(max(0.0, (begin_ns + due_ns - time.monotonic_ns()) * 1e-9))
        if isinstance(one, TwistCommand):
            client.send_twist(
                *one.twist,
                source=one.source,
                frame=one.frame,
                width_rate=one.width_rate,
                width=one.width,
                path_rate=one.path_rate,
                region=one.region,
            )
        elif isinstance(one, SensorSample):
            client.sense(one.source, **dict(zip(QUANTITIES[kinds[one.source]], one.values, strict=True)))
        elif one.kind is RequestKind.ESTOP:
            client.stop(timeout=0.0)  # waiting for its confirmation would delay what follows
        elif one.kind is RequestKind.RESET:
            client.reset()
        elif one.kind is RequestKind.STAND_UP:
            client.stand_up()
        elif one.kind is RequestKind.LET_DOWN:
            client.let_down()
        elif one.kind is RequestKind.REFERENCE:
            client.reference(one.motor, one.angle or 0.0)
        elif one.kind is RequestKind.SET:
            client.set(str(one.setting), one.value or 0.0)
        elif one.kind is RequestKind.MARK:
            client.mark(str(one.text))
        else:
            service.send_signal(signal.SIGTERM)


def _finish(client: Client, service: Process, *, told: bool) -> Path:
    """The session of the service after its end, which it is told at rest if it has not been told yet."""
    state = client.state()
    if not told:
        client.wait_for_state(lambda now: now.status.standing is True and now.status.winner is None, REST_S)
        service.send_signal(signal.SIGTERM)
    service.wait(END_S)
    recording = state.extras.get("recording") if state else None
    if not isinstance(recording, dict) or not recording.get("session"):
        raise RedriveError("the service did not record")
    return Path(str(recording["session"]))


def _is_shutdown(one: _Given) -> bool:
    return isinstance(one, Request) and one.kind is RequestKind.SHUTDOWN
