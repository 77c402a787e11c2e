"""The layout of a session: one table of entities and columns that the recorder writes and the reader reads.

How this works
--------------
The unit is the cycle. `/inputs/cycle` and `/outputs/cycle` have exactly one row per cycle, which says how many rows
that cycle has in every other entity; those rows carry the cycle and their index in it, so that nothing depends on
the order in which Rerun stores or sorts them. `/outputs/cycle` is written last of a batch: a cycle without its row
there was not recorded whole. Unknown (None) is an empty cell, never a number.
"""

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple

import msgspec

from drivers.contract import CanFrame
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
    Reply,
    Request,
    RequestKind,
    Twist,
    TwistCommand,
    TwistFrame,
)

SCHEMA_VERSION = 1
APPLICATION_ID = "drivegate"

CYCLE = "cycle"  # sequence; the first of the three by name, and Rerun sorts the rows of a chunk by that one
MONO = "mono"  # duration: CLOCK_MONOTONIC of the cycle
WALL = "wall"  # timestamp: CLOCK_REALTIME of the cycle
INDEX = "index"  # column of every entity: place of the row within its cycle


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


class Entity(NamedTuple):
    """Where rows live, what they hold, how a cycle becomes rows and how a row becomes a value again."""

    path: str
    archetype: str
    columns: Mapping[str, Kind]
    rows: Callable[[Record], Sequence[Row]]
    value: Callable[[Row], Any]


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


HEADER_PATH = "/header"
HEADER_ARCHETYPE = "SessionHeader"
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
}

GAP_PATH = "/gap"
GAP_ARCHETYPE = "Gap"
GAP_COLUMNS = {"first_cycle": Kind.INT, "last_cycle": Kind.INT, "reason": Kind.TEXT}

CAN_COLUMNS = {  # the fields of CanFrame, in its order
    "bus": Kind.TEXT,
    "id": Kind.ID,
    "data": Kind.BINARY,
    "extended": Kind.BOOL,
    "remote": Kind.BOOL,
    "received_ns": Kind.MAYBE_INT,
}


def _input_cycle_rows(record: Record) -> Sequence[Row]:
    x = record.inputs
    lengths = (len(x.frames), len(x.commands), len(x.refusals), len(x.requests), len(x.bus_events))
    return ((x.now_ns, x.overruns, x.dropped_records, *lengths),)


def _output_cycle_rows(record: Record) -> Sequence[Row]:
    y = record.outputs
    lengths = (len(y.frames), len(y.events), len(y.replies), int(y.odometry is not None))
    return ((y.mode.value, y.finished, *lengths),)


def _command_rows(record: Record) -> Sequence[Row]:
    return [
        (c.source, *c.twist, c.frame.value, c.sequence, c.received_ns, c.sender, int(c.stamped))
        for c in record.inputs.commands
    ]


def _command(row: Row) -> TwistCommand:
    source, vx, vy, wz, frame, sequence, received_ns, sender, stamped = row
    return TwistCommand(source, Twist(vx, vy, wz), TwistFrame(frame), sequence, received_ns, sender, bool(stamped))


def _refusal_rows(record: Record) -> Sequence[Row]:
    return [(r.source, r.code.value, r.text, r.received_ns) for r in record.inputs.refusals]


def _refusal(row: Row) -> Refusal:
    source, code, text, received_ns = row
    return Refusal(source, RefusalCode(code), text, received_ns)


def _request_rows(record: Record) -> Sequence[Row]:
    return [(r.kind.value, r.id, r.received_ns, r.motor, r.angle) for r in record.inputs.requests]


def _request(row: Row) -> Request:
    kind, *rest = row
    return Request(RequestKind(kind), *rest)


def _bus_event_rows(record: Record) -> Sequence[Row]:
    return [(e.bus, e.kind.value, e.occurrences, e.text) for e in record.inputs.bus_events]


def _bus_event(row: Row) -> BusEvent:
    bus, kind, occurrences, text = row
    return BusEvent(bus, BusEventKind(kind), occurrences, text)


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


def _status_rows(record: Record) -> Sequence[Row]:
    status = record.outputs.status
    if status is None:
        return ()
    named = status._asdict()  # plain JSON of a tuple would lose the names
    named["sources"] = [source._asdict() for source in status.sources]
    named["motors"] = [motor._asdict() for motor in status.motors]
    return ((msgspec.json.encode(named).decode(),),)


def _text_column(row: Row) -> Any:  # noqa: ANN401  the one column, whatever it holds
    return row[0]


# How many rows a cycle has in the other entities, in the order of INPUTS and OUTPUTS below.
INPUT_COUNTS = ("frames", "commands", "refusals", "requests", "bus_events")
OUTPUT_COUNTS = ("frames", "events", "replies", "odometry")

INPUT_CYCLE = Entity(
    "/inputs/cycle",
    "InputCycle",
    dict.fromkeys(("now_ns", "overruns", "dropped_records", *INPUT_COUNTS), Kind.INT),
    _input_cycle_rows,
    tuple,
)
INPUT_CAN = Entity("/inputs/can", "CanFrame", CAN_COLUMNS, lambda record: record.inputs.frames, CanFrame._make)
INPUT_COMMAND = Entity(
    "/inputs/command",
    "TwistCommand",
    {"source": Kind.TEXT, "vx": Kind.FLOAT, "vy": Kind.FLOAT, "wz": Kind.FLOAT, "frame": Kind.TEXT}
    | {"sequence": Kind.MAYBE_INT, "received_ns": Kind.INT, "sender": Kind.MAYBE_TEXT, "stamped": Kind.MAYBE_INT},
    _command_rows,
    _command,
)
INPUT_REFUSAL = Entity(
    "/inputs/refusal",
    "Refusal",
    {"source": Kind.TEXT, "code": Kind.TEXT, "text": Kind.TEXT, "received_ns": Kind.INT},
    _refusal_rows,
    _refusal,
)
INPUT_REQUEST = Entity(
    "/inputs/request",
    "Request",
    {"kind": Kind.TEXT, "id": Kind.INT, "received_ns": Kind.INT}
    | {"motor": Kind.MAYBE_TEXT, "angle": Kind.MAYBE_FLOAT},
    _request_rows,
    _request,
)
INPUT_BUS = Entity(
    "/inputs/bus",
    "BusEvent",
    {"bus": Kind.TEXT, "kind": Kind.TEXT, "occurrences": Kind.INT, "text": Kind.TEXT},
    _bus_event_rows,
    _bus_event,
)
OUTPUT_CAN = Entity("/outputs/can", "CanFrame", CAN_COLUMNS, lambda record: record.outputs.frames, CanFrame._make)
OUTPUT_EVENT = Entity(
    "/outputs/event",
    "Event",
    {"level": Kind.TEXT, "code": Kind.TEXT, "text": Kind.TEXT},
    _event_rows,
    _event,
)
OUTPUT_REPLY = Entity(
    "/outputs/reply",
    "Reply",
    {"id": Kind.INT, "ok": Kind.BOOL, "reason": Kind.MAYBE_TEXT},
    lambda record: record.outputs.replies,
    Reply._make,
)
OUTPUT_ODOMETRY = Entity(
    "/outputs/odometry",
    "Odometry",
    {"x": Kind.FLOAT, "y": Kind.FLOAT, "theta": Kind.FLOAT}
    | dict.fromkeys(("vx", "vy", "wz"), Kind.MAYBE_FLOAT)
    | {"covariance": Kind.FLOATS, "residual": Kind.MAYBE_FLOAT},
    _odometry_rows,
    _odometry,
)
OUTPUT_STATUS = Entity("/outputs/status", "Status", {"json": Kind.TEXT}, _status_rows, _text_column)
OUTPUT_CYCLE = Entity(
    "/outputs/cycle",
    "OutputCycle",
    {"mode": Kind.TEXT, "finished": Kind.BOOL} | dict.fromkeys(("frames", "events", "replies", "odometry"), Kind.INT),
    _output_cycle_rows,
    tuple,
)

INPUTS = (INPUT_CAN, INPUT_COMMAND, INPUT_REFUSAL, INPUT_REQUEST, INPUT_BUS)
OUTPUTS = (OUTPUT_CAN, OUTPUT_EVENT, OUTPUT_REPLY, OUTPUT_ODOMETRY)
BATCH = (*INPUTS, *OUTPUTS, OUTPUT_STATUS, INPUT_CYCLE, OUTPUT_CYCLE)  # in the order of writing
