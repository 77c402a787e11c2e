"""The layout of a session: one table of entities and columns that the recorder writes and the reader reads.

How this works
--------------
The unit is the cycle, and what Rerun stores is a batch of them, some 0.4 s: one row of `/cycles`, whose only
cell is a block (`gateway.recording.block`). In a block each table below has its rows column by column. `cycles` has
one row per cycle, which says how many rows that cycle has in every other table. A row of Rerun's own for each cycle
and table costs 20 to 40 bytes before anything is said in it, and its reader some 5 us (measured with 0.41).

What is under `/trace` is for people and is not read back: plots at a viewing rate, the robot from above, CAN in words.
Version 1, which had a row of Rerun's for each frame, and version 2, which had no digest chain
(`gateway.recording.chain`), are still read (`replay.sessions.version_1`, `version_2`).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from itertools import repeat
from math import isnan, nan
from struct import Struct
from typing import Any, NamedTuple

import msgspec

from drivers.contract import CanFrame
from gateway.recording.incident import Incident
from gateway.recording.packets import Record
from gateway.types import (
    BusEvent,
    BusEventKind,
    Event,
    Level,
    Odometry,
    Pose,
    Refusal,
    RefusalCode,
    Region,
    Reply,
    Request,
    RequestKind,
    SensorSample,
    Status,
    Twist,
    TwistCommand,
    TwistFrame,
)

SCHEMA_VERSION = 3
APPLICATION_ID = "drivegate"

CYCLE = "cycle"  # sequence; the first of the two by name, and Rerun sorts the rows of a chunk by that one
WALL = "wall"  # timestamp: CLOCK_REALTIME of the cycle


class Kind(Enum):
    """What a column holds. Only the MAYBE kinds may hold None; FLOATS is a row of any number of float64."""

    INT = "int64"
    ID = "uint32"
    FLOAT = "float64"
    BOOL = "bool"
    TEXT = "text"
    BINARY = "binary"
    FLOATS = "list of float64"
    MAYBE_INT = "int64 or nothing"
    MAYBE_FLOAT = "float64 or nothing"
    MAYBE_TEXT = "text or nothing"


Row = Sequence[Any]  # values in the order of the columns


Values = Callable[[Iterable[Row]], Iterable[Any]]


class Table(NamedTuple):
    """What the rows of a block hold, how a cycle becomes rows and how rows become values again.

    A column that a block does not have, because it is older or because it would say nothing else (`block`), reads as
    None, zero, False or empty; one that this table does not have is passed over.
    """

    name: str
    columns: Mapping[str, Kind]
    rows: Callable[[Record], Sequence[Row]]
    values: Values


def each(value: Callable[[Row], Any]) -> Values:
    """Of a function for one row the one for many."""
    return lambda rows: map(value, rows)


def tuples(kind: type[tuple[Any, ...]]) -> Values:
    """Named tuples whose fields are the columns, made without a call of Python for each."""
    return lambda rows: map(tuple.__new__, repeat(kind), rows)


class Header(msgspec.Struct, frozen=True):
    """What every segment says of itself; enough, with the rows, to replay it elsewhere and years later."""

    schema_version: int
    session: str
    segment: int
    robot: str
    config_origin: str
    config_sha256: str
    config_text: str
    versions: dict[str, str]
    git_commit: str | None
    host: str
    started_wall_ns: int
    wall_minus_mono_ns: int
    sealed: bool = False  # each segment ends with a seal; recordings from before there were any do not
    first_segment: int = 1  # those before it were deleted to make room
    plant: str | None = None  # by what a simulated robot moved; None: not simulated, or not told
    first_cycle: int = 0  # of a piece of a session; what was in front of it is elsewhere
    cut_from: str | None = None  # the session of which it is a piece
    imported: str | None = None  # of which log these are the frames; None: a drive of drivegate's own
    chain: str | None = None  # value of the digest chain in front of this segment, hex; None: nothing is in front of it
    incident: Incident | None = None  # that was kept; None: it is a session, or a piece that somebody has cut


HEADER_PATH = "/header"
HEADER_ARCHETYPE = "SessionHeader"
# Of a batch or a snapshot: values of the digest chain in front of it and with it. The seal has the last one.
LINK_COLUMNS = {"before": Kind.BINARY, "chain": Kind.BINARY}

HEADER_COLUMNS = {"schema_version": Kind.INT, "json": Kind.TEXT}  # the version is readable in every version

# The last row of a segment. `bytes` and `crc32` (zlib) are of the file in front of it. `first_segment` as in the
# header, when the segment was closed. `final`: nothing follows, the service ended in order; `last_cycle` was its last.
SEAL_PATH = "/seal"
SEAL_ARCHETYPE = "Seal"
SEAL_COLUMNS = {
    "bytes": Kind.INT,
    "crc32": Kind.INT,
    "first_segment": Kind.INT,
    "final": Kind.BOOL,
    "last_cycle": Kind.MAYBE_INT,
    "chain": Kind.BINARY,
}

FOOTER_MARK = b"RRF2FOOT"  # of Rerun's files
FOOTER_TAIL = Struct("<QQI8sI")  # their last bytes: place of the footer in the file, its length, checksum, mark, count

GAP_PATH = "/gap"
GAP_ARCHETYPE = "Gap"
GAP_COLUMNS = {"first_cycle": Kind.INT, "last_cycle": Kind.INT, "reason": Kind.TEXT}


def _command_rows(record: Record) -> Sequence[Row]:
    return [
        (c.source, *c.twist, c.frame.value, *c[3:9], None if c.region is Region.ANY else c.region.value, c.width)
        for c in record.inputs.commands
    ]


def _command(row: Row) -> TwistCommand:
    source, vx, vy, wz, frame, *rest, region, width = row
    region = Region.ANY if region is None else Region(region)
    return TwistCommand(source, Twist(vx, vy, wz), TwistFrame(frame), *(*rest, region, width))


def _refusal_rows(record: Record) -> Sequence[Row]:
    return [(r.source, r.code.value, r.text, r.received_ns) for r in record.inputs.refusals]


def _refusal(row: Row) -> Refusal:
    source, code, text, received_ns = row
    return Refusal(source, RefusalCode(code), text, received_ns)


def _request_rows(record: Record) -> Sequence[Row]:
    return [(r.kind.value, *r[1:]) for r in record.inputs.requests]


def _request(row: Row) -> Request:
    kind, *rest = row
    return Request(RequestKind(kind), *rest)


def _bus_event_rows(record: Record) -> Sequence[Row]:
    return [(e.bus, e.kind.value, e.occurrences, e.text) for e in record.inputs.bus_events]


def _bus_event(row: Row) -> BusEvent:
    bus, kind, occurrences, text = row
    return BusEvent(bus, BusEventKind(kind), occurrences, text)


# What a sensor does not tell is no number in the list: no number that an edge lets in is one.
def _sample_rows(record: Record) -> Sequence[Row]:
    return [(s.source, [nan if value is None else value for value in s.values], *s[2:]) for s in record.inputs.samples]


def _sample(row: Row) -> SensorSample:
    source, values, *rest = row
    return SensorSample(source, tuple([None if isnan(value) else value for value in values]), *rest)


def _event_rows(record: Record) -> Sequence[Row]:
    return [(e.level.value, e.code, e.text) for e in record.outputs.events]


def _event(row: Row) -> Event:
    level, code, text = row
    return Event(Level(level), code, text)


def _odometry_rows(record: Record) -> Sequence[Row]:
    odometry = record.outputs.odometry
    if odometry is None:
        return ()
    twist = odometry.twist if odometry.twist is not None else (None, None, None)
    return ((*odometry.pose, *twist, odometry.covariance, odometry.residual),)


def _odometry(row: Row) -> Odometry:
    x, y, theta, vx, vy, wz, covariance, residual = row
    twist = None if vx is None else Twist(vx, vy, wz)
    return Odometry(Pose(x, y, theta), twist, tuple(covariance), residual)


CAN_COLUMNS = {  # the fields of CanFrame, in its order
    "bus": Kind.TEXT,
    "id": Kind.ID,
    "data": Kind.BINARY,
    "extended": Kind.BOOL,
    "remote": Kind.BOOL,
    "received_ns": Kind.MAYBE_INT,
    "fd": Kind.BOOL,
    "bit_rate_switch": Kind.BOOL,
}
FRAMES_IN = Table("frames_in", CAN_COLUMNS, lambda record: record.inputs.frames, tuples(CanFrame))
COMMANDS = Table(
    "commands",
    {"source": Kind.TEXT, "vx": Kind.FLOAT, "vy": Kind.FLOAT, "wz": Kind.FLOAT, "frame": Kind.TEXT}
    | {"sequence": Kind.MAYBE_INT, "received_ns": Kind.INT, "sender": Kind.MAYBE_TEXT, "stamped": Kind.BOOL}
    | {"width_rate": Kind.MAYBE_FLOAT, "path_rate": Kind.MAYBE_FLOAT, "region": Kind.MAYBE_TEXT}
    | {"width": Kind.MAYBE_FLOAT},
    _command_rows,
    each(_command),
)
REFUSALS = Table(
    "refusals",
    {"source": Kind.TEXT, "code": Kind.TEXT, "text": Kind.TEXT, "received_ns": Kind.INT},
    _refusal_rows,
    each(_refusal),
)
REQUESTS = Table(
    "requests",
    {"kind": Kind.TEXT, "id": Kind.INT, "received_ns": Kind.INT}
    | {"motor": Kind.MAYBE_TEXT, "angle": Kind.MAYBE_FLOAT, "setting": Kind.MAYBE_TEXT, "value": Kind.MAYBE_FLOAT}
    | {"text": Kind.MAYBE_TEXT},
    _request_rows,
    each(_request),
)
BUS_EVENTS = Table(
    "bus_events",
    {"bus": Kind.TEXT, "kind": Kind.TEXT, "occurrences": Kind.INT, "text": Kind.TEXT},
    _bus_event_rows,
    each(_bus_event),
)
SAMPLES = Table(
    "samples",
    {"source": Kind.TEXT, "values": Kind.FLOATS, "sequence": Kind.MAYBE_INT, "received_ns": Kind.INT}
    | {"sender": Kind.MAYBE_TEXT, "stamped": Kind.BOOL},
    _sample_rows,
    each(_sample),
)
FRAMES_OUT = Table("frames_out", CAN_COLUMNS, lambda record: record.outputs.frames, tuples(CanFrame))
EVENTS = Table("events", {"level": Kind.TEXT, "code": Kind.TEXT, "text": Kind.TEXT}, _event_rows, each(_event))
REPLIES = Table(
    "replies",
    {"id": Kind.INT, "ok": Kind.BOOL, "reason": Kind.MAYBE_TEXT},
    lambda record: record.outputs.replies,
    tuples(Reply),
)
ODOMETRY = Table(
    "odometry",
    {"x": Kind.FLOAT, "y": Kind.FLOAT, "theta": Kind.FLOAT}
    | dict.fromkeys(("vx", "vy", "wz"), Kind.MAYBE_FLOAT)
    | {"covariance": Kind.FLOATS, "residual": Kind.MAYBE_FLOAT},
    _odometry_rows,
    each(_odometry),
)

INPUTS = (FRAMES_IN, COMMANDS, REFUSALS, REQUESTS, BUS_EVENTS, SAMPLES)  # in the order of the fields of Inputs
OUTPUTS = (FRAMES_OUT, EVENTS, REPLIES, ODOMETRY)
TABLES = (*INPUTS, *OUTPUTS)
COUNTERS = ("cycle", "now_ns", "overruns", "dropped_records", "late_ns", "work_ns", "wall_ns")


def _cycle_rows(record: Record) -> Sequence[Row]:
    """The one row of a cycle, but for its counts, which the block knows."""
    x, y = record.inputs, record.outputs
    return ((x.cycle, x.now_ns, x.overruns, x.dropped_records, *record.timing, y.mode.value, y.finished),)


# `late_ns`, `work_ns`, `wall_ns`: how the loop kept time, which no replay needs. The block adds one column for each of
# the other tables, by its name: how many rows the cycle has in it.
CYCLES = Table(
    "cycles",
    dict.fromkeys(COUNTERS, Kind.INT) | {"mode": Kind.TEXT, "finished": Kind.BOOL},
    _cycle_rows,
    each(tuple),
)

# The row of a batch, at the times of its first cycle.
BLOCK_PATH = "/cycles"
BLOCK_ARCHETYPE = "Cycles"
BLOCK_COLUMNS = {"count": Kind.INT, "block": Kind.BINARY, **LINK_COLUMNS}

# The state of the core after a cycle (`gateway.core.snapshot`, msgpack), from which a replay can begin. crc32: zlib.
SNAPSHOT_PATH = "/snapshot"
SNAPSHOT_ARCHETYPE = "Snapshot"
SNAPSHOT_COLUMNS = {"after": Kind.INT, "state": Kind.BINARY, "crc32": Kind.INT, **LINK_COLUMNS}

# For people: as rows of their own, which the viewer shows in words.
STATUS_PATH = "/outputs/status"
STATUS_ARCHETYPE = "Status"
STATUS_COLUMNS = {"json": Kind.TEXT}


def status_row(status: Status) -> Row:
    """The row of STATUS_COLUMNS, its numbers to six digits: what follows from the inputs is kept for people only."""
    named = status._asdict()  # plain JSON of a tuple would lose the names
    named["sources"] = [source._asdict() for source in status.sources]
    named["motors"] = [motor._asdict() for motor in status.motors]
    named["ability"] = status.ability._asdict()
    named["sensors"] = [sensor._asdict() for sensor in status.sensors]
    named["slip"] = None if status.slip is None else status.slip._asdict()
    named["settings"] = {setting.name: setting.value for setting in status.settings}  # their ranges never change
    return (msgspec.json.encode(_shown(named)).decode(),)


def _shown(value: object) -> object:
    match value:
        case float():
            return float(f"{value:.6g}")
        case dict():
            return {name: _shown(one) for name, one in value.items()}
        case tuple() | list():
            return [_shown(one) for one in value]
    return value
