"""What a bug report is made of, each part read where it lies and within bounds; nothing is changed or commanded."""

import json
import os
import platform
import pwd
import shutil
import socket
import subprocess
import sys
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import zenoh

from gateway.build import ROOT, version
from gateway.cli.doctor import SESSIONS
from gateway.client import DEFAULT_ENDPOINT, Client
from gateway.config import ConfigError, RobotConfig, parse
from gateway.edges.messages import state_document
from gateway.edges.zenoh_session import LinkError
from gateway.recording.disk import INCIDENTS, incidents
from gateway.recording.header import git_commit, versions

DOCTOR_S = 40.0
LOG_S = 10.0
ANSWER_S = 3.0
LOG_LINES = 3000
MOST_TEXT = 2_000_000  # bytes of one part; of what is longer the end is taken
FIRST_PERSON = 1000  # user ids below are those of services
_NOBODY = 65534


class MissingError(Exception):
    """A part that is not there; the text says why."""


class Source(NamedTuple):
    """Where a robot is looked for: its file (None: machine only), the text of it, and what that says if it is right."""

    file: Path | None
    text: str | None
    config: RobotConfig | None
    ours: bool  # it is installed: its service's folders are the service manager's

    @property
    def unit(self) -> str | None:
        """Name of its service."""
        return None if self.file is None else f"drivegate@{self.file.stem}.service"

    @property
    def robot(self) -> str:
        """Name of the robot, or of its file where that is wrong."""
        if self.config is not None:
            return self.config.robot.name
        return "machine" if self.file is None else self.file.stem


def source(file: Path | None, *, ours: bool) -> Source:
    """A robot file that is wrong is one worth reporting. Raises MissingError where there is no text."""
    if file is None:
        return Source(None, None, None, ours)
    try:
        text = bounded(file.read_bytes()).decode("utf-8", errors="replace")
    except OSError as error:
        raise MissingError(f"{file}: {error.strerror}") from None
    try:
        return Source(file, text, parse(text, str(file)), ours)
    except ConfigError:
        return Source(file, text, None, ours)


def robot_file(found: Source) -> str:
    """As it is."""
    if found.text is None:
        raise MissingError("no robot file is given or installed")
    return found.text


def software(_: Source) -> str:
    """DriveGate, its packages, Python, kernel and system."""
    kernel = os.uname()
    told = {
        "drivegate": version(),
        "commit": git_commit(),
        "recorded": versions(),
        "python": sys.version,
        "kernel": f"{kernel.sysname} {kernel.release} {kernel.version} {kernel.machine}",
        "system": _system(),
        "processors": os.cpu_count(),
        "packages": dict(sorted((one.name, one.version) for one in metadata.distributions() if one.name)),
    }
    return json.dumps(told, indent=1)


def doctor(found: Source) -> str:
    """The answer of `drivegate doctor`, from a process of its own that may take its time."""
    file = [] if found.file is None else [str(found.file)]
    return _output([sys.executable, "-m", "gateway", "doctor", *file, "--json"], DOCTOR_S, codes=(0, 1))


def log(found: Source) -> str:
    """The end of what the service has logged."""
    if found.unit is None:
        raise MissingError("no robot file, so no service")
    if shutil.which("journalctl") is None:
        raise MissingError("there is no journalctl here: what the service logs goes where it was started")
    shown = ("--no-hostname", "--no-pager", "--quiet", "--output=short-iso-precise", f"--lines={LOG_LINES}")
    told = _output(["journalctl", f"--unit={found.unit}", *shown], LOG_S, codes=(0, 1))
    if not told.strip():
        raise MissingError(
            f"journalctl has nothing of {found.unit}, or this user may not read it (group systemd-journal)"
        )
    return told


class Running(NamedTuple):
    """What the running robot tells: its state, and the robot file in use."""

    state: dict[str, object]
    robot_file: str | None


def running(found: Source) -> Running:
    """Asked for, as `drivegate watch` does."""
    config = found.config
    if config is None:
        raise MissingError("no robot file that tells on which endpoint it listens")
    endpoint = config.zenoh.listen[0] if config.zenoh.listen else DEFAULT_ENDPOINT
    try:
        with Client(config.robot.name, connect=[endpoint]) as client:
            state = client.status(ANSWER_S)
            if state is None:
                raise MissingError(f"{config.robot.name} does not answer on {endpoint}")
            return Running(state_document(state), client.config_text(ANSWER_S))
    except LinkError as error:
        raise MissingError(str(error)) from None


def zenoh_config(found: Source) -> object:
    """Zenoh's own configuration, as sections: comments are gone."""
    if found.config is None or found.config.zenoh.config_file is None:
        raise MissingError("the robot file names no zenoh.config_file")
    path = Path(found.config.zenoh.config_file)
    try:
        text = bounded(path.read_bytes()).decode("utf-8", errors="replace")
        return json.loads(str(zenoh.Config.from_json5(text)))
    except OSError as error:
        raise MissingError(f"{path}: {error.strerror}") from None
    except (ValueError, zenoh.ZError) as error:
        raise MissingError(f"{path}: cannot be read by Zenoh ({type(error).__name__})") from None


def newest_incidents(found: Source, state: Mapping[str, object] | None) -> list[Path]:
    """Newest first."""
    if found.config is None:
        raise MissingError("no robot file that tells where they are")
    listed = [one for folder in _folders(found, state) for one in _incidents(folder, found.config.robot.name)]
    if not listed:
        raise MissingError(f"none in {', '.join(map(str, _folders(found, state)))}, or this user may not look there")
    return [path for _, path in sorted(listed, reverse=True)]


def people() -> set[str]:
    """Names of those who may log in here, also as they are in full, and of who calls."""
    names = {os.environ.get(name, "") for name in ("USER", "LOGNAME", "SUDO_USER")}
    known = [one for one in pwd.getpwall() if _is_person(one)]
    return names | {one.pw_name for one in known} | {one.pw_gecos.partition(",")[0].strip() for one in known}


def homes() -> set[str]:
    """Their directories."""
    return {os.environ.get("HOME", "")} | {one.pw_dir for one in pwd.getpwall() if _is_person(one)}


def hosts() -> set[str]:
    """Names of this computer."""
    return {socket.gethostname(), socket.gethostname().partition(".")[0]}


def bounded(data: bytes) -> bytes:
    """The end of what is too long."""
    return data[-MOST_TEXT:]


def _is_person(one: pwd.struct_passwd) -> bool:
    return FIRST_PERSON <= one.pw_uid != _NOBODY


def _system() -> str:
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME", "not told")
    except OSError:
        return "not told"


def _folders(found: Source, state: Mapping[str, object] | None) -> list[Path]:
    """Where the running robot records; else where it would."""
    assert found.config is not None
    assert found.file is not None
    told = [SESSIONS / found.file.stem if found.ours else Path(found.config.recording.directory)]
    match state:
        case {"extras": {"recording": {"session": str(session)}}}:
            told.insert(0, Path(session).parent)
    return [folder / INCIDENTS for folder in dict.fromkeys(told)]


def _incidents(folder: Path, robot: str) -> list[tuple[int, Path]]:
    try:
        return incidents(folder, robot)
    except OSError:
        return []


def _output(command: list[str], seconds: float, *, codes: tuple[int, ...]) -> str:
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            timeout=seconds,
            check=False,
            stdin=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))},
        )
    except subprocess.TimeoutExpired:
        raise MissingError(f"{command[0]} did not answer within {seconds:g} s") from None
    except OSError as error:
        raise MissingError(f"{command[0]}: {error.strerror}") from None
    if done.returncode not in codes:
        raise MissingError(f"{Path(command[0]).name} ended with {done.returncode}")
    return bounded(done.stdout).decode("utf-8", errors="replace")
