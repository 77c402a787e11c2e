"""`drivegate doctor`: what is wrong with this machine for this robot, line by line, with a cure."""

import ctypes
import os
import re
import resource
import shutil
import socket
import statistics
import subprocess
import time
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from gateway import robot_files
from gateway.build import version
from gateway.cli.explain import tell_code
from gateway.cli.output import console, print_json
from gateway.client import Client
from gateway.config import RobotConfig, load
from gateway.core.assembly import build
from gateway.edges import host_checks as judge
from gateway.edges.can_link import CanLink, parse_link
from gateway.edges.host_checks import Finding, Grade, RealTime, Unit
from gateway.edges.messages import StateMessage
from gateway.edges.zenoh_session import LinkError
from gateway.setup.prepare_odrive import unproven
from gateway.types import Status

SESSIONS = Path("/var/lib/drivegate")
ANSWER_S = 3.0
SLEEPS = 50
_PACKAGES = ("eclipse-zenoh", "python-can", "rerun-sdk", "numpy", "pydantic")
_UNIT_KEYS = ("LoadState", "ActiveState", "UnitFileState", "StatusText", "Result", "ExecMainStatus", "NRestarts", "Job")
_ENDPOINT = re.compile(r"(?:tcp|tls|quic)/\[?(?P<host>[^/\]]+)\]?:(?P<port>\d+)")
_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised
_STYLES = {Grade.OK: "green", Grade.NOTE: "yellow", Grade.PROBLEM: "red"}


class Answer(NamedTuple):
    """Of a Zenoh endpoint: nobody listens, the robot is there, and what it says of itself."""

    free: bool
    alive: bool
    state: StateMessage | None


def doctor(
    file: Annotated[
        str | None, typer.Argument(help="Robot file, or the name of an installed or bundled one.", show_default="all")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable report.")] = False,
    explain: Annotated[
        str | None,
        typer.Option(
            metavar="CODE", help="Say what a fault, an event or a vendor's word means instead; `fault` or `all`: each."
        ),
    ] = None,
) -> None:
    """Check this machine for a robot: CAN, real time, clock, disk, Zenoh, joints, service. Exit 1 on a problem."""
    if explain is not None:
        tell_code(explain, json=json)
        return
    findings = [*_machine()]
    for path in _robot_files(file):
        findings += _robot(path)
    if json:
        lines = [finding._asdict() | {"grade": finding.grade.value} for finding in findings]
        print_json({"well": judge.exit_code(findings) == 0, "findings": lines})
    else:
        _show(findings)
    raise typer.Exit(judge.exit_code(findings))


def _robot_files(file: str | None) -> list[Path]:
    """The one asked for, the installed one first; or every installed one."""
    return list(robot_files.installed().values()) if file is None else [robot_files.find(file)]


def _show(findings: list[Finding]) -> None:
    for subject, grade, text, cure in findings:
        console.print(f"[{_STYLES[grade]}]{grade.value:8}[/]{subject}: ", end="")
        console.print(text, markup=False, highlight=False, soft_wrap=True)
        if cure is not None:
            console.print(f"        cure: {cure}", markup=False, highlight=False, soft_wrap=True)


def _machine() -> Iterator[Finding]:
    yield Finding("versions", Grade.OK, ", ".join(_versions()))
    yield from judge.clock(
        wall_s=time.clock_gettime(time.CLOCK_REALTIME),
        synchronised=_synchronised(),
        resolution_s=time.clock_getres(time.CLOCK_MONOTONIC),
        source=_text(Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")) or "unknown source",
        late_s=_lateness_s(),
    )


def _robot(path: Path) -> Iterator[Finding]:
    """Raises ConfigError."""
    config, _ = load(path)
    ours = path.parent == robot_files.INSTALLED
    yield Finding("robot file", Grade.OK, f"{path}{' (installed)' if ours else ''}: {config.robot.name}")
    name = f"drivegate@{path.stem}.service"
    unit = _unit(name)
    active = unit is not None and unit.active == "active"
    for bus in config.bus:
        if bus.interface == "socketcan":
            yield from judge.interface(bus, link_of(bus.channel))
    for words in unproven(config):
        yield Finding("endpoints of ODrives", Grade.NOTE, words)
    yield from judge.real_time(_real_time(name, active=active, installed=unit is not None and unit.loaded == "loaded"))
    directory = SESSIONS / path.stem if ours else Path(config.recording.directory)
    if config.recording.enabled or config.recording.incidents.enabled:
        limits = config.recording
        room = _room(directory, ours=ours)
        yield judge.disk(
            str(directory),
            free=room.free,
            min_free=limits.min_free,
            budget=limits.disk_budget,
            obstacle=room.obstacle,
        )
    answers = {text: _ask(config.robot.name, text) for text in config.zenoh.listen}
    yield from _endpoints(config, answers, active=active)
    states = [answer.state.status for answer in answers.values() if answer and answer.state]
    yield from _joints(config, states[0] if states else None)
    for sensor in config.sensor:
        by = "Zenoh" if sensor.bus is None else sensor.bus
        yield judge.sensor(sensor.name, by=by, status=states[0] if states else None)
    yield judge.service(name, unit)


def _versions() -> Iterator[str]:
    system = os.uname()
    yield f"{system.sysname} {system.release} {system.machine}"
    yield f"drivegate {version()}"
    for package in _PACKAGES:
        try:
            yield f"{package} {metadata.version(package)}"
        except metadata.PackageNotFoundError:
            yield f"{package} not installed"


def _output(*command: str) -> str | None:
    """Standard output of a program; None if it is not there or does not answer."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return None


def link_of(channel: str) -> CanLink | None:
    """A network interface as `ip` sees it."""
    return parse_link(_output("ip", "-details", "-statistics", "-json", "link", "show", "dev", channel) or "")


def _synchronised() -> bool:
    """As the kernel sees it, whoever keeps the time."""
    timex = ctypes.create_string_buffer(512)  # struct timex is smaller; modes 0: only read
    return int(ctypes.CDLL(None).adjtimex(timex)) != _TIME_ERROR


def _lateness_s() -> float:
    """Median lateness of a sleep of one millisecond."""
    late = []
    for _ in range(SLEEPS):
        begin = time.monotonic()
        time.sleep(1e-3)
        late.append(time.monotonic() - begin - 1e-3)
    return statistics.median(late)


def _unit(name: str) -> Unit | None:
    if not Path("/run/systemd/system").is_dir():
        return None
    shown = _output("systemctl", "show", "-p", ",".join(_UNIT_KEYS), name)
    if shown is None:
        return None
    values = dict(line.partition("=")[::2] for line in shown.splitlines())
    return Unit(*(values.get(key, "") for key in _UNIT_KEYS))


def _real_time(name: str, *, active: bool, installed: bool) -> RealTime:
    pid = (_output("systemctl", "show", "-P", "MainPID", name) or "").strip() if active else "0"
    if pid not in ("", "0"):
        policy = os.sched_getscheduler(int(pid)) & ~os.SCHED_RESET_ON_FORK
        locked = re.search(r"VmLck:\s+(\d+)", _text(Path(f"/proc/{pid}/status")) or "")
        running, has_locked = policy == os.SCHED_FIFO, locked is not None and locked[1] != "0"
        return RealTime(running, has_locked, may_run=True, may_lock=True)
    unlimited = os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    return RealTime(None, None, may_run=installed or _may_run_real_time(), may_lock=installed or unlimited)


def _may_run_real_time() -> bool:
    """Tried, because a container may refuse it to root and a limit may grant it to a user."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


class Room(NamedTuple):
    """Of the file system where a directory is or will be: bytes free, or why there will be no directory."""

    free: int | None
    obstacle: str | None = None


def _room(directory: Path, *, ours: bool) -> Room:
    """`ours`: the service manager makes it for the service's own user, who may more than this one."""
    try:
        existing = next(path for path in (directory.absolute(), *directory.absolute().parents) if path.exists())
        usage = shutil.disk_usage(existing)
    except OSError:
        return Room(None)
    if not existing.is_dir():
        return Room(None, f"{existing} is no directory")
    if usage.total == 0:
        return Room(None, f"{existing} is no file system that keeps files")
    if not ours and not os.access(existing, os.W_OK | os.X_OK):
        return Room(None, f"this user may not write into {existing}")
    return Room(usage.free)


def _joints(config: RobotConfig, status: Status | None) -> Iterator[Finding]:
    robot = build(config)
    for index in robot.kinematics.steered:
        yield judge.joint(robot.names[index], robot=config.robot.name, absolute=robot.absolute[index], status=status)


def _endpoints(config: RobotConfig, answers: Mapping[str, Answer | None], *, active: bool) -> Iterator[Finding]:
    for text, answer in answers.items():
        if answer is None:
            yield Finding(f"Zenoh {text}", Grade.NOTE, "this kind of endpoint is not checked")
        else:
            robot, (free, alive, _) = config.robot.name, answer
            yield judge.endpoint(text, robot=robot, free=free, answered=alive, active=active)


def _ask(robot: str, endpoint: str) -> Answer | None:
    """What an endpoint answers; None for a kind that is not checked."""
    address = _ENDPOINT.fullmatch(endpoint)
    if address is None:
        return None
    if _bindable(address["host"], int(address["port"])):
        return Answer(free=True, alive=False, state=None)
    try:
        with Client(robot, connect=[re.sub(r"/(\[::\]|0\.0\.0\.0):", "/127.0.0.1:", endpoint)]) as client:
            alive = client.wait_alive(ANSWER_S)
            return Answer(free=False, alive=alive, state=client.status(ANSWER_S) if alive else None)
    except LinkError:
        return Answer(free=False, alive=False, state=None)


def _bindable(host: str, port: int) -> bool:
    try:
        with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
            return True
    except OSError:
        return False
