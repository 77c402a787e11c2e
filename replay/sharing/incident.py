"""An incident once more in a file without secrets and names, which verifies as the original does.

Its header, its cycles and its states of the core are read, every text in them goes through the redaction, and they
are written anew; what is drawn of them is left out, which any copy of this software draws again. The digest chain
is that of the new file.
"""

from collections.abc import Callable, Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from typing import cast

import msgspec

from gateway.config import ConfigError, parse
from gateway.core.snapshot import fingerprint
from gateway.recording.packets import Gap, Record, Snapshot
from gateway.recording.schema import SCHEMA_VERSION
from gateway.recording.segment import Segment
from gateway.types import Outputs, Trace
from replay.sessions.reader import Session, SessionError

BATCH = 250  # cycles, some second

Text = Callable[[str], str]


def share(session: Session, path: Path, text: Text) -> None:
    """Write it to `path`; `text` takes secrets out.

    Raises SessionError for one that cannot be shared, and why; OSError, RecordingOffError, WriterDeadError.
    """
    header = session.header
    if header.schema_version != SCHEMA_VERSION:
        raise SessionError(f"it has session schema {header.schema_version}, of which none is written any more")
    told = _redacted(msgspec.to_builtins(header), text)
    assert isinstance(told, dict)
    robot_file = told["config_text"]
    if not _drives_alike(header.config_text, robot_file):
        raise SessionError("what is to be taken out of it is a name in its robot file too: it would not verify without")
    told |= {"config_sha256": sha256(robot_file.encode()).hexdigest(), "sealed": True, "chain": None}
    segment = Segment(path, header=msgspec.convert(told, type(header)), views=None, blueprint=None)
    last = header.first_cycle
    for batch, snapshot in _batches(session):
        if snapshot is not None:
            segment.keep(Snapshot(snapshot[0], _snapshot(snapshot[1], text)))
        segment.write([_record(record, text) for record in batch], ())
        segment.flush()
        last = batch[-1].inputs.cycle
    gaps = [Gap(gap.first_cycle, gap.last_cycle, text(gap.reason)) for gap in session.gaps]
    if gaps:
        segment.write((), gaps)
    segment.close(first_segment=1, final=True, last_cycle=last)


def texts(session: Session) -> Iterator[str]:
    """Every text in it, so that what is a secret anywhere is known before it is shared."""
    yield from _texts(msgspec.to_builtins(session.header))
    for inputs, outputs in session.cycles():
        for told in (inputs.refusals, inputs.requests, inputs.bus_events, outputs.events, outputs.replies):
            yield from _texts(msgspec.to_builtins(told))


def _drives_alike(text: str, shared: str) -> bool:
    """Whether the core reads the same of both; of one that is read no more nothing can be lost."""
    try:
        before = fingerprint(parse(text, "robot file of the session"))
    except ConfigError:
        return True
    try:
        return fingerprint(parse(shared, "robot file to be shared")) == before
    except ConfigError:
        return False


def _batches(session: Session) -> Iterator[tuple[list[Record], tuple[int, bytes] | None]]:
    """Cycles in batches, each with the state of the core in front of it, where one was recorded there."""
    timings = dict(session.timings())
    batch: list[Record] = []
    front: tuple[int, bytes] | None = None
    for inputs, recorded in session.cycles():
        state = session.snapshots.get(inputs.cycle - 1)
        if batch and (state is not None or len(batch) >= BATCH):
            yield batch, front
            batch, front = [], None
        if state is not None:
            front = inputs.cycle - 1, state
        outputs = Outputs(*recorded, None, cast(Trace, None), False)  # of these nothing is stored
        batch.append(Record(inputs, outputs, timings[inputs.cycle]))
    if batch:
        yield batch, front


def _record(record: Record, text: Text) -> Record:
    inputs, outputs = record.inputs, record.outputs
    if not (inputs.refusals or inputs.requests or inputs.bus_events or outputs.events or outputs.replies):
        return record
    inputs = inputs._replace(
        refusals=tuple(one._replace(text=text(one.text)) for one in inputs.refusals),
        requests=tuple(one._replace(text=one.text and text(one.text)) for one in inputs.requests),
        bus_events=tuple(one._replace(text=text(one.text)) for one in inputs.bus_events),
    )
    outputs = outputs._replace(
        events=tuple(one._replace(text=text(one.text)) for one in outputs.events),
        replies=tuple(one._replace(reason=one.reason and text(one.reason)) for one in outputs.replies),
    )
    return Record(inputs, outputs, record.timing)


def _snapshot(state: bytes, text: Text) -> bytes:
    """Byte for byte the same where there is nothing to take out."""
    plain = msgspec.msgpack.decode(state)
    shared = _redacted(plain, text)
    return state if shared == plain else msgspec.msgpack.encode(shared)


def _redacted(value: object, text: Text) -> object:
    match value:
        case str():
            return text(value)
        case Mapping():
            return {key: _redacted(one, text) for key, one in value.items()}
        case list() | tuple():
            return [_redacted(one, text) for one in value]
    return value


def _texts(value: object) -> Iterator[str]:
    match value:
        case str():
            yield value
        case Mapping():
            for one in value.values():
                yield from _texts(one)
        case list() | tuple():
            for one in value:
                yield from _texts(one)
