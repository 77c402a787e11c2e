"""A batch as bytes: what is damaged is known cycle by cycle, and newer and older columns are read."""

import random
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drivers.contract import CanFrame
from gateway.recording import segment
from gateway.recording.block import DAMAGED, Block, packed, unpacked
from gateway.recording.cells import CODINGS
from gateway.recording.packets import Gap, Record
from gateway.recording.schema import FRAMES_IN, TABLES, Kind
from gateway.types import Inputs, Twist
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.drives import drive
from tests.recordings import write, write_drive
from tests.world import World

KINDS = (Kind.INT, Kind.BOOL, Kind.MAYBE_INT, Kind.MAYBE_TEXT, Kind.FLOATS, Kind.BINARY, Kind.TEXT)
Plain = dict[str, dict[str, list[object]]]


def cycle_values(block: Block, place: int) -> list[object]:
    """Everything there is of one cycle."""
    head = [block.cycles.column(name, kind, place, place + 1) for name, (kind, _) in block.cycles._cells.items()]
    rows: list[object] = []
    for table in TABLES:
        columns = block.tables[table.name]
        end, count = int(columns.ends[place]), int(columns.counts[place])
        rows.append(columns.values(table, end - count, end) if count else ())
    return [head, rows]


def test_no_flipped_bit_passes_as_what_was_written() -> None:
    """Of every cycle that is called whole all values are as they were."""
    block = packed(list(drive(40)))
    before = unpacked(block)
    assert before.whole.all()
    values = [repr(cycle_values(before, place)) for place in range(40)]
    generator = random.Random(5)
    read = changed = 0
    for _ in range(600):
        spoilt = bytearray(block)
        spoilt[generator.randrange(len(block))] ^= 1 << generator.randrange(8)
        try:
            after = unpacked(bytes(spoilt))
        except DAMAGED:
            continue
        read += 1
        changed += not after.whole.all()
        for place in np.flatnonzero(after.whole).tolist():
            assert repr(cycle_values(after, place)) == values[place]
    assert read > 300
    assert changed > 0.9 * read


def test_lengths_that_add_up_only_because_they_wrap_are_refused() -> None:
    """Four of 2^62 are 2^64, which is nothing in 64 bits."""
    lengths = CODINGS[Kind.INT].pack([2**62] * 4).parts()
    with pytest.raises(ValueError, match="do not fit"):
        CODINGS[Kind.FLOATS].unpack([*lengths, b""], 4)


def test_a_change_of_one_frame_spoils_one_cycle() -> None:
    """The last byte of the eight stands in the last plane, and no other row depends on it."""
    records = list(drive(30))
    plain: Plain = msgspec.msgpack.decode(packed(records))
    parts = plain["frames_in"]["data"][1]
    assert isinstance(parts, list)
    rows = len(parts[1]) // 8
    planes = bytearray(parts[1])
    planes[7 * rows + 6 * 11 + 2] ^= 1  # the third of six frames of cycle 11
    parts[1] = bytes(planes)
    assert np.flatnonzero(~unpacked(msgspec.msgpack.encode(plain)).whole).tolist() == [11]


@pytest.mark.parametrize(
    "exchange",
    [
        lambda frames: (frames[1], frames[0], *frames[2:]),
        lambda frames: (frames[0]._replace(received_ns=None), *frames[1:]),
        lambda frames: (frames[0]._replace(data=frames[0].data[:7]), *frames[1:]),
        lambda frames: (frames[0]._replace(data=frames[0].data + b"\0"), *frames[1:]),
        lambda frames: (frames[0]._replace(bus="can1"), *frames[1:]),
        lambda frames: frames[1:],
    ],
)
def test_the_check_sees_order_absence_and_length(
    exchange: Callable[[tuple[CanFrame, ...]], tuple[CanFrame, ...]],
) -> None:
    """The check of one drive does not fit another one."""

    def checked(records: list[Record]) -> bytes:
        found: Plain = msgspec.msgpack.decode(packed(records))
        part = found["cycles"]["check"][1]
        assert isinstance(part, list)
        return bytes(part[0])

    records = list(drive(1))
    inputs = records[0].inputs
    other = Record(inputs._replace(frames=exchange(inputs.frames)), records[0].outputs, records[0].timing)
    assert checked(records) != checked([other])
    assert checked(records) == checked(list(drive(1)))


def test_columns_of_a_newer_and_of_an_older_recorder() -> None:
    """One that is not known is passed over, one that is not there says nothing; both are checked."""
    older = FRAMES_IN._replace(columns={name: FRAMES_IN.columns[name] for name in ("bus", "id")}, values=tuple)
    block = unpacked(packed(list(drive(2))))
    assert block.tables["frames_in"].values(older, 0, 1) == (("can0", 0x20),)
    newer = older._replace(columns={"bus": Kind.TEXT} | {f"new_{kind.name}": kind for kind in KINDS})
    assert block.tables["frames_in"].values(newer, 0, 1) == (("can0", 0, False, None, None, (), b"", ""),)
    named = older._replace(columns={"data": Kind.ID})
    with pytest.raises(ValueError, match=r"frames_in\.data is"):
        block.tables["frames_in"].values(named, 0, 1)


def test_flags_that_no_frame_has_take_no_place() -> None:
    """Classic traffic is as small as it was before there were flags of CAN FD."""
    records = list(drive(50))
    plain: Plain = msgspec.msgpack.decode(packed(records))
    assert set(plain["frames_in"]) == {"bus", "id", "data", "received_ns"}
    assert set(plain["frames_out"]) == {"bus", "id", "data"}
    (frame, *others) = records[7].inputs.frames
    modern = (frame._replace(fd=True, bit_rate_switch=True, data=bytes(64)), *others)
    records[7] = Record(records[7].inputs._replace(frames=modern), records[7].outputs, records[7].timing)
    assert set(msgspec.msgpack.decode(packed(records))["frames_in"]) >= {"fd", "bit_rate_switch"}
    assert unpacked(packed(records)).tables["frames_in"].values(FRAMES_IN, 42, 48) == modern


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame("can0", 2**32, b""),
        CanFrame("can0", 1, b"", received_ns=2**63),
        CanFrame("can0", 1, bytes(256)),
        CanFrame(None, 1, b""),  # type: ignore[arg-type]
        CanFrame("\ud800", 1, b""),
        CanFrame("can0", 1.5, b""),  # type: ignore[arg-type]
    ],
)
def test_a_value_beyond_its_column_is_refused(frame: CanFrame) -> None:
    record = next(iter(drive(1)))
    with pytest.raises((OverflowError, TypeError, ValueError)):
        packed([Record(Inputs(0, 0, (frame,)), record.outputs, record.timing)])


def test_a_damaged_cycle_is_named_and_not_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Damage from before the segment was sealed, such as of the memory: seal and footer are in order."""
    world = World("moby", rate_hz=100.0)
    world.start()
    world.run(0.3, Twist(0.2, 0.0, 0.0))

    def spoilt(records: list[Record]) -> bytes:
        plain: Plain = msgspec.msgpack.decode(packed(records))
        parts = plain["frames_out"]["data"][1]
        assert isinstance(parts, list)
        rows, before = len(parts[1]) // 8, sum(len(record.outputs.frames) for record in records[:30])
        planes = bytearray(parts[1])
        planes[3 * rows + before] ^= 0x10
        parts[1] = bytes(planes)
        return msgspec.msgpack.encode(plain)

    assert world.records[30][1].frames
    monkeypatch.setattr(segment, "packed", spoilt)
    session = open_session(write_drive(tmp_path, world))
    verdict = verify(session)
    assert session.gaps == (Gap(30, 30, "not as it was written"),)
    assert (verdict.exit_code, verdict.cycles) == (3, 30)
    assert verdict.problem == "cycles 30 to 30 are missing from the recording (not as it was written)"


def test_a_block_that_does_not_unpack_costs_its_batch_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = list(drive(60))
    monkeypatch.setattr(segment, "packed", lambda batch: packed(batch)[: -5 if batch[0].inputs.cycle == 20 else None])
    session = open_session(write(tmp_path, records, batch=20))
    assert [inputs.cycle for inputs, _ in session.cycles()] == [*range(20), *range(40, 60)]
    assert session.gaps == (Gap(20, 39, "not as it was written"),)
