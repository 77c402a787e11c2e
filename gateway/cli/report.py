"""`drivegate report`: one archive for a bug report, without secrets and names.

How this works
--------------
Everything is read first; then the redaction (`replay.sharing.redaction`) goes over all of it twice, the second time
with what it has found the first time, and what is still found in the bytes of a part leaves that part out. Parts that
are not there are named in README.txt. It steps back behind everything else that runs, and asks a robot no more than
`drivegate watch` does.
"""

import contextlib
import io
import json
import os
import tempfile
import time
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from gateway import robot_files
from gateway.cli import report_parts as parts
from gateway.cli.output import complain, console, in_words, print_json
from gateway.cli.report_parts import MissingError, Source
from gateway.recording.failures import RecordingOffError, WriterDeadError
from replay.sessions.reader import Session, SessionError, open_session
from replay.sharing.incident import share, texts
from replay.sharing.redaction import SOMEWHERE, Redaction

NICE = 19
FIRST_TO_GO = "1000"  # of oom_score_adj
MOST_INCIDENTS = 3
MOST_INCIDENT_BYTES = 100_000_000  # read; what is shared of them is smaller
INCIDENTS_S = 60.0  # no other one is begun after that
README = "README.txt"
EXIT_NOT_WRITTEN = 1
_TEXTS: dict[str, Callable[[Source], str]] = {
    "robot.toml": parts.robot_file,
    "software.json": parts.software,
    "doctor.json": parts.doctor,
    "service.log": parts.log,
}
_WHAT = {
    "robot.toml": "the robot file",
    "running-robot.toml": "the robot file of the running robot",
    "software.json": "versions of DriveGate, of its packages, of Python and of the kernel",
    "doctor.json": "the answer of `drivegate doctor`",
    "service.log": f"the last {parts.LOG_LINES} lines of the service's log",
    "state.json": "the state of the running robot, with its settings",
    "zenoh.json": "the configuration of Zenoh (zenoh.config_file)",
    "incidents": f"the newest {MOST_INCIDENTS} incidents; `drivegate replay info` and `verify` read them",
}
_FIRMWARE = (
    "versions of the controllers' firmware: nothing tells them while it drives; `drivegate setup scan --ask` does"
)


def report(
    robot: Annotated[
        str | None,
        typer.Argument(
            metavar="[FILE|NAME]", help="Robot file, or the name of one; none: the installed one.", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The archive, a new file.", show_default=False)
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable list of what is in it.")] = False,
) -> None:
    """One archive for a bug report: robot file, versions, doctor, log, settings, last incidents; no secrets, no names.

    (A page about a drive, to look at, is `drivegate replay report`.) It only reads. Passwords, keys, certificates,
    tokens, home directories, names of users and of this computer are taken out; look through it all the same before
    you give it away. What is missing is said in its README.txt. Exit 1: it could not be written.
    """
    _step_back()
    found = _source(robot)
    stamp = datetime.fromtimestamp(time.clock_gettime(time.CLOCK_REALTIME), UTC).strftime("%Y%m%dT%H%M%SZ")
    path = out or Path(f"drivegate-report-{found.robot}-{stamp}.zip")
    archive = _Archive(found)
    archive.collect()
    try:
        members = archive.write(path, stamp)
    except OSError as error:
        complain(f"the report is not written: {in_words(error)}")
        raise typer.Exit(EXIT_NOT_WRITTEN) from None
    size = path.stat().st_size
    if json:
        contents = [{"name": name, "bytes": length} for name, length in members.items()]
        print_json({"file": str(path), "bytes": size, "members": contents, "missing": archive.missing})
        return
    for name, length in members.items():
        console.print(f"{length:>10}  {name}", highlight=False, markup=False)
    for what, why in archive.missing.items():
        console.print(f"   missing  {what}: {why}", highlight=False, markup=False, soft_wrap=True)
    console.print(f"{path}: {size} bytes. Look through it before you give it away.", highlight=False, soft_wrap=True)


def _source(robot: str | None) -> Source:
    """Raises ConfigError where what is given is no robot file; leaves the command where several could be meant."""
    try:
        if robot is not None:
            path = robot_files.find(robot)
            return parts.source(path, ours=path.parent == robot_files.INSTALLED)
        installed = list(robot_files.installed().values())
        if len(installed) > 1:
            complain(f"several robots are installed: say which of {', '.join(path.stem for path in installed)}")
            raise typer.Exit(2)
        return parts.source(installed[0] if installed else None, ours=True)
    except MissingError as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_WRITTEN) from None


class _Archive:
    """Parts by their names in the archive, and why others are missing. What is called as the robot keeps its name."""

    def __init__(self, found: Source) -> None:
        self._found = found
        self.missing: dict[str, str] = {}
        self._texts: dict[str, str] = {}
        self._incidents: dict[str, Session] = {}
        self._zenoh: object = None
        self._redaction = Redaction(
            people=parts.people() - {found.robot}, homes=parts.homes(), hosts=parts.hosts() - {found.robot}
        )

    def collect(self) -> None:
        """Read everything."""
        found = self._found
        self._redaction.text(found.text or "")
        self._take("zenoh.json", self._zenoh_text)
        for name, read in _TEXTS.items():
            self._take(name, read)
        state = None
        try:
            told = parts.running(found)
        except MissingError as error:
            self.missing["state.json"] = str(error)
        else:
            state = told.state
            self._texts["state.json"] = _as_text(state)
            if told.robot_file is not None and told.robot_file != found.text:
                self._texts["running-robot.toml"] = told.robot_file
        self._choose_incidents(state)

    def write(self, path: Path, stamp: str) -> dict[str, int]:
        """The archive whole or not at all; names of its members with their lengths. Raises OSError."""
        for text in self._texts.values():
            self._redaction.text(text)
        for session in self._incidents.values():
            for text in texts(session):
                self._redaction.text(text)
        members = {name: self._redacted(name, text).encode() for name, text in self._texts.items()}
        members |= self._shared_incidents()
        for name in [name for name, data in members.items() if self._redaction.left_in(data)]:
            del members[name]
            self.missing[name] = "something that was taken out of another part could not be taken out of it"
        self.missing = {name: self._redaction.again(why) for name, why in self.missing.items()}
        members[README] = self._readme(members, stamp).encode()
        _write(path, members)
        return {name: len(data) for name, data in members.items()}

    def _redacted(self, name: str, text: str) -> str:
        try:
            document = json.loads(text) if name.endswith(".json") else None
        except ValueError:  # of something that was cut off
            document = None
        return self._redaction.again(text) if document is None else _as_text(self._redaction.again_in(document))

    def _take(self, name: str, read: Callable[[Source], str]) -> None:
        try:
            self._texts[name] = read(self._found)
        except MissingError as error:
            self.missing[name] = str(error)

    def _zenoh_text(self, found: Source) -> str:
        return _as_text(self._redaction.document(parts.zenoh_config(found)))

    def _choose_incidents(self, state: dict[str, object] | None) -> None:
        try:
            newest = parts.newest_incidents(self._found, state)
        except MissingError as error:
            self.missing["incidents"] = str(error)
            return
        left = MOST_INCIDENT_BYTES
        for path in newest[:MOST_INCIDENTS]:
            name = self._redaction.again(f"incidents/{path.name}")
            try:
                left -= path.stat().st_size
                if left < 0:
                    self.missing[name] = "too long: all incidents together may have 100 MB"
                    return
                self._incidents[name] = open_session(path)
                self._redaction.name({self._incidents[name].header.host} - {self._found.robot}, SOMEWHERE)
            except (SessionError, OSError) as error:
                self.missing[name] = in_words(error)

    def _shared_incidents(self) -> dict[str, bytes]:
        shared: dict[str, bytes] = {}
        began = time.monotonic()
        for name, session in self._incidents.items():
            if time.monotonic() - began > INCIDENTS_S:
                self.missing[name] = f"no time: the others took more than {INCIDENTS_S:g} s"
                continue
            try:
                shared[name] = self._shared(session)
            except (SessionError, OSError, RecordingOffError, WriterDeadError, ValueError) as error:
                self.missing[name] = f"cannot be shared: {in_words(error)}"
        return shared

    def _shared(self, session: Session) -> bytes:
        """Raises what `share` does; ValueError where a secret is left in it."""
        with tempfile.TemporaryDirectory(prefix="drivegate-report-") as folder:
            path = Path(folder) / "incident.rrd"
            share(session, path, self._redaction.again)
            if any(self._redaction.left_in(text.encode()) for text in texts(open_session(path))):
                raise ValueError("something that was taken out could not be taken out of it")
            return path.read_bytes()

    def _readme(self, members: dict[str, bytes], stamp: str) -> str:
        there = [f"{name} ({len(data)} bytes): {_what(name)}" for name, data in members.items()]
        missing = [f"{name}: {why}" for name, why in self.missing.items()]
        return "\n".join(
            [
                f"Report of `drivegate report`, {stamp}",
                "",
                "In it:",
                *(f"  {line}" for line in there),
                "",
                "Missing:",
                *(f"  {line}" for line in [*missing, _FIRMWARE]),
                "",
                f"Taken out, {self._redaction.times} times: what looks like a password, key, certificate or token;",
                "home directories; names of users and of this computer. Addresses (IP) and marks are still in it.",
                "Incidents are without their drawings: `drivegate replay cut` draws them again.",
                "",
            ]
        )


def _as_text(document: object) -> str:
    return json.dumps(document, indent=1)


def _what(name: str) -> str:
    return _WHAT[name.partition("/")[0]]


def _write(path: Path, members: dict[str, bytes]) -> None:
    """Raises OSError; also where the file is there already."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    file = path.open("xb")
    try:
        with file:
            os.fchmod(file.fileno(), 0o600)
            file.write(buffer.getvalue())
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _step_back() -> None:
    """Behind everything else that runs here, a robot above all, and with it what it starts."""
    with contextlib.suppress(OSError):
        os.nice(NICE)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_GO, encoding="ascii")
