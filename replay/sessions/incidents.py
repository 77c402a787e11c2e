"""Incidents that were kept (`gateway.recording.incidents`): which there are, and what their headers say."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from replay.sessions.folders import incidents
from replay.sessions.reader import SessionError, open_session
from replay.sessions.summary import utc


class Listed(NamedTuple):
    """One line of `drivegate replay incidents`. `problem`: why nothing is known of it; then the rest is empty."""

    file: Path
    robot: str | None = None
    began: str | None = None  # UTC of its cause, ISO 8601
    code: str | None = None
    text: str | None = None
    causes: int = 0
    verdict: str | None = None  # by the recorder, when it was written
    problem: str | None = None

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        return self._asdict() | {"file": str(self.file)}


def listed(paths: Iterable[Path]) -> Iterator[Listed]:
    """Of these folders and files, in the order of their times, those that cannot be read first."""
    found = [_listed(file) for path in paths for file in (incidents(path) if path.is_dir() else [path])]
    yield from sorted(found, key=lambda one: (one.began or "", one.file))


def _listed(file: Path) -> Listed:
    try:
        header = open_session(file).header
    except SessionError as error:
        return Listed(file, problem=str(error))
    incident = header.incident
    if incident is None or not incident.causes:
        return Listed(file, problem=f"{file}: a session, and no incident")
    first = incident.causes[0]
    return Listed(
        file,
        robot=header.robot,
        began=utc(first.wall_ns),
        code=first.code,
        text=first.text,
        causes=len(incident.causes) + incident.more,
        verdict=None if incident.judgement is None else incident.judgement.verdict,
    )
