"""What a session is, told from its columns alone: when, how long, which modes, faults and gaps. The core is not run."""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from itertools import groupby
from typing import NamedTuple

import msgspec

from gateway.recording.incident import Incident
from gateway.recording.packets import Gap
from gateway.types import Event, Level
from replay.sessions.cycles import Sketch
from replay.sessions.reader import Session

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


class Stay(NamedTuple):
    """A mode, from when and for how long, s since the first recorded cycle."""

    mode: str
    t: float
    seconds: float


class Fault(NamedTuple):
    """Events of one code: how many, when the first and the last, s since the first cycle, and the first one's words."""

    level: str
    code: str
    times: int
    t: float
    last_t: float
    text: str


class SegmentFile(NamedTuple):
    """A segment, and its bytes on the disk."""

    name: str
    bytes: int


class Summary(NamedTuple):
    """What `drivegate replay info` tells. `seconds` and times: from the first cycle there is to the last."""

    session: str
    robot: str
    plant: str | None  # by what a simulated robot moved
    imported: str | None  # of which log these are the frames
    cut_from: str | None  # the session of which this is a piece
    began: str | None  # UTC, ISO 8601; None: nothing was recorded
    seconds: float
    cycles: int
    first_cycle: int | None
    last_cycle: int | None
    frames_received: int
    frames_sent: int
    modes: tuple[Stay, ...]
    faults: tuple[Fault, ...]
    gaps: tuple[Gap, ...]
    complete: bool
    problems: tuple[str, ...]
    segments: tuple[SegmentFile, ...]
    schema: int
    versions: dict[str, str]
    commit: str | None
    host: str
    config_origin: str
    incident: Incident | None = None  # that was kept in this file

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        lists = {name: [one._asdict() for one in getattr(self, name)] for name in ("modes", "faults", "segments")} | {
            "gaps": [_gap(gap) for gap in self.gaps]
        }
        return self._asdict() | lists | {"incident": None if self.incident is None else _incident(self.incident)}


class _Modes:
    """Stays in a mode, from the mode of each cycle."""

    def __init__(self) -> None:
        self._changes: list[tuple[str, int]] = []

    def add(self, sketch: Sketch) -> None:
        place = 0
        for mode, group in groupby(sketch.modes):
            if not self._changes or self._changes[-1][0] != mode:
                self._changes.append((mode, int(sketch.now_ns[place])))
            place += len(list(group))

    def stays(self, first_ns: int, last_ns: int) -> Iterator[Stay]:
        ends = [ns for _, ns in self._changes[1:]] + [last_ns] * bool(self._changes)
        for (mode, begin_ns), end_ns in zip(self._changes, ends, strict=True):
            yield Stay(mode, _seconds(begin_ns - first_ns), _seconds(end_ns - begin_ns))


def summary(session: Session) -> Summary:
    """Read all of a session, and run none of it."""
    modes = _Modes()
    events: list[tuple[int, Event]] = []
    first: tuple[int, int] | None = None  # cycle and time
    last: tuple[int, int] = (0, 0)
    cycles = received = sent = 0
    for sketch in session.sketches():
        first = first or (int(sketch.cycle[0]), int(sketch.now_ns[0]))
        last = (int(sketch.cycle[-1]), int(sketch.now_ns[-1]))
        cycles += len(sketch.cycle)
        received += sketch.frames_received
        sent += sketch.frames_sent
        modes.add(sketch)
        events += sketch.events
    header = session.header
    first_cycle, first_ns = first or (None, 0)
    return Summary(
        session=header.session,
        robot=header.robot,
        plant=header.plant,
        imported=header.imported,
        cut_from=header.cut_from,
        began=None if first is None else utc(first_ns + header.wall_minus_mono_ns),
        seconds=_seconds(last[1] - first_ns) if first else 0.0,
        cycles=cycles,
        first_cycle=first_cycle,
        last_cycle=last[0] if first else None,
        frames_received=received,
        frames_sent=sent,
        modes=tuple(modes.stays(first_ns, last[1])),
        faults=tuple(_faults(events, first_ns)),
        gaps=session.gaps,
        complete=session.complete,
        problems=session.problems,
        segments=tuple(SegmentFile(path.name, path.stat().st_size) for path in session.segments if path.exists()),
        schema=header.schema_version,
        versions=header.versions,
        commit=header.git_commit,
        host=header.host,
        config_origin=header.config_origin,
        incident=header.incident,
    )


def utc(wall_ns: int) -> str:
    """A wall time to the millisecond, ISO 8601."""
    return (EPOCH + timedelta(microseconds=wall_ns // 1000)).isoformat(timespec="milliseconds")


def _faults(events: Iterable[tuple[int, Event]], first_ns: int) -> Iterator[Fault]:
    """Warnings and errors by their code, in the order in which they first came."""
    groups: dict[tuple[str, str], list[tuple[int, Event]]] = {}
    for now_ns, event in events:
        if event.level is not Level.INFO:
            groups.setdefault((event.level.value, event.code), []).append((now_ns, event))
    for (level, code), found in groups.items():
        begin_ns, event = found[0]
        yield Fault(
            level, code, len(found), _seconds(begin_ns - first_ns), _seconds(found[-1][0] - first_ns), event.text
        )


def _seconds(ns: int) -> float:
    return round(ns * 1e-9, 6)


def _incident(incident: Incident) -> dict[str, object]:
    judged = incident.judgement
    told = ("cycle", "code", "text")
    return {
        "causes": [
            {"at": utc(cause.wall_ns)} | {name: getattr(cause, name) for name in told} for cause in incident.causes
        ],
        "more": incident.more,
        "buses": [msgspec.structs.asdict(bus) for bus in incident.buses],
        "verdict": None if judged is None else judged.verdict,
        "difference": None if judged is None else judged.difference,
    }


def _gap(gap: Gap) -> dict[str, object]:
    return {"first_cycle": gap.first_cycle, "last_cycle": gap.last_cycle, "reason": gap.reason}
