"""The recorded commands once more, through the live service and the simulated robot on a bus: does it drive alike?

How this works
--------------
Service and simulated robot are processes of their own, as in real use; only the channels of the recorded robot file
are replaced, each bus by a virtual interface of its own. Kernel, service and robot keep real time: the clocks behind a
socket, a Zenoh session or a thread's timeout cannot be told to go faster (`redrive_virtual` has none of these). Once
every motor answers, each command, emergency stop, reset and sample of a sensor is given again at its recorded time
(`recorded_drive.asked`); the new session is then compared with the recorded one.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gateway.client import Client
from gateway.config import RobotConfig, parse
from gateway.edges.can_bus import interface_exists
from gateway.edges.messages import QUANTITIES, StateMessage
from gateway.types import Mode, RequestKind, SensorSample, TwistCommand
from replay.compare.likeness import Comparison, compare, moments
from replay.drive.recorded_drive import REST_S, Asked, RedriveError, asked, is_shutdown, plant_told
from replay.sessions.reader import Session, open_session

READY_S = 60.0
Process = subprocess.Popen[bytes]
END_S = 40.0


def redrive(session: Session, *, channels: Sequence[str], out: Path, tick_ms: int) -> Comparison:
    """Drive again on these virtual channels (see `channel_of_each`) and compare.

    Raises RedriveError, SessionError, ConfigError, LinkError.
    """
    config = parse(session.config_text, "robot file of the session")
    channel_of = channel_of_each([bus.name for bus in config.bus], channels)
    for channel in channel_of.values():
        _check_channel(channel)
    given, plant = asked(session), plant_told(session)
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="drivegate-")))
        file = folder / f"{config.robot.name}.toml"
        file.write_text(as_toml(_on_channels(config, channel_of)), encoding="utf-8")
        # Its own place for the latch: an emergency stop that a drive ends in must not meet the next one.
        places = ("--out", str(out), "--state", str(folder), "--endpoint", endpoint)
        service = stack.enter_context(_process("run", str(file), *places))
        client = stack.enter_context(Client(config.robot.name, connect=[endpoint]))
        _await(client, service, lambda state: _recorded(state) is not None, "the service does not record")
        # Only now: starting costs a slow computer much, and the recorder must not begin behind the drive.
        stack.enter_context(_process("sim", str(file), "--tick", str(tick_ms), "--plant", plant.value))
        _await(client, service, _waits, "the service does not get ready")
        _give(given, config, client, service)
        path = _finish(client, service, told=any(is_shutdown(one) for _, one in given))
    try:
        return compare(moments(session), moments(open_session(path)), config, str(path))
    except ValueError as error:
        raise RedriveError(f"{error} ({path}: {open_session(path).problem or 'complete'})") from None


def channel_of_each(buses: Sequence[str], given: Sequence[str]) -> dict[str, str]:
    """The channel of each bus, from BUS=CHANNEL of each, or from CHANNEL alone where there is one bus.

    Raises RedriveError for what is missing, unknown or given twice.
    """
    if len(buses) == len(given) == 1 and "=" not in given[0]:
        return {buses[0]: given[0]}
    found: dict[str, str] = {}
    wanted = " ".join(f"--channel {bus}=vcan{place}" for place, bus in enumerate(buses))
    for text in given:
        bus, equals, channel = text.partition("=")
        if not equals or not bus or not channel:
            raise RedriveError(f"--channel {text}: this robot has {_named(buses)}, each needs its own: {wanted}")
        if bus not in buses:
            raise RedriveError(f"--channel {text}: this robot has no bus {bus}, it has {_named(buses)}")
        if bus in found:
            raise RedriveError(f"--channel {text}: bus {bus} has {found[bus]} already")
        taken = next((other for other in found if found[other] == channel), None)
        if taken is not None:
            raise RedriveError(f"--channel {text}: {channel} is that of bus {taken}; each bus needs its own: {wanted}")
        found[bus] = channel
    missing = [bus for bus in buses if bus not in found]
    if missing:
        raise RedriveError(f"no channel for {_named(missing)}: {wanted}")
    return found


def _named(buses: Sequence[str]) -> str:
    return f"bus{'es' if len(buses) > 1 else ''} {', '.join(buses)}"


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


def _on_channels(config: RobotConfig, channel_of: Mapping[str, str]) -> RobotConfig:
    buses = [bus.model_copy(update={"interface": "socketcan", "channel": channel_of[bus.name]}) for bus in config.bus]
    recording = config.recording.model_copy(update={"enabled": True})  # what is not recorded cannot be compared
    return config.model_copy(update={"bus": buses, "recording": recording})


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


def _await(client: Client, service: Process, wanted: Callable[[StateMessage], bool], otherwise: str) -> None:
    """Until its state is as wanted. Raises RedriveError, with what else is said and why it waits, if that never is."""
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        if service.poll() is not None:
            raise RedriveError(f"the service ended with exit code {service.returncode}")
        if client.wait_for_state(wanted, 0.5):
            return
    state = client.state()
    raise RedriveError(f"{otherwise}: {state.status.reason if state else 'no state received'}")


def _waits(state: StateMessage) -> bool:
    """Every motor answers, and nothing is wrong."""
    return state.status.mode is Mode.IDLE and not state.status.faults


def _recorded(state: StateMessage) -> Path | None:
    """The session that it writes."""
    recording = state.extras.get("recording")
    session = recording.get("session") if isinstance(recording, dict) else None
    return Path(str(session)) if session else None


def _give(given: Sequence[tuple[int, Asked]], config: RobotConfig, client: Client, service: Process) -> None:
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
    session = _recorded(state) if state is not None else None
    if session is None:
        raise RedriveError("the service did not record")
    return session
