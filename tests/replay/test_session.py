"""Write, read back, compare: exact values, damaged files, gaps, segments."""

import math
import random
import shutil
import struct
from collections import Counter
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
import rerun as rr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from drivers.contract import CanFrame
from gateway.recording.block import unpacked
from gateway.recording.columns import arrays
from gateway.recording.packets import Gap, Record
from gateway.recording.schema import APPLICATION_ID, HEADER_ARCHETYPE, HEADER_COLUMNS, HEADER_PATH, SCHEMA_VERSION
from gateway.types import (
    ZERO_TWIST,
    AbilityStatus,
    BusEvent,
    BusEventKind,
    CycleTiming,
    EffectiveMotors,
    Event,
    Inputs,
    Level,
    Mode,
    MotorStatus,
    Odometry,
    Outputs,
    Pose,
    Refusal,
    RefusalCode,
    Region,
    Reply,
    Request,
    RequestKind,
    SensorSample,
    SensorStatus,
    SettingStatus,
    SlipStatus,
    SourceStatus,
    Status,
    Trace,
    Twist,
    TwistCommand,
    TwistFrame,
)
from replay.sessions.reader import SessionError, open_session
from replay.sessions.software import change
from tests.drives import drive
from tests.recordings import STARTED_NS, expected, robot_text, write, writer

EMPTY_TRACE = Trace(
    target=ZERO_TWIST,
    setpoint=ZERO_TWIST,
    measured=None,
    pose=Pose(0.0, 0.0, 0.0),
    wheel_setpoints=(None,) * 3,
    wheel_speeds=(None,) * 3,
    wheel_positions=(None,) * 3,
    winner_age_s=None,
    residual=None,
    residuals=None,
)
EMPTY_OUTPUTS = Outputs((), Mode.IDLE, (), (), None, None, EMPTY_TRACE, finished=False)
TIMING = CycleTiming(0, 1, STARTED_NS)
STATUS = Status(
    mode=Mode.DRIVE,
    reason=None,
    faults=(),
    winner="teleop",
    winner_age_s=0.01,
    sources=(SourceStatus("teleop", 0.01, None),),
    motors=(MotorStatus("left", "operational", 1.0, None, None, None, None, None, 0.001),),
    limits_active=("vx",),
    stop_category=1,
    standing=False,
    pose=Pose(0.0, 0.0, 0.0),
    twist=None,
    refused=0,
    tx_dropped=0,
    overruns=0,
    dropped_records=0,
    cycle=3,
    ability=AbilityStatus(
        2,
        0.5,
        0.3,
        (Twist(0.3, 0.0, 0.0), Twist(0.0, 0.3, 0.1)),
        (Twist(0.0, 0.0, 1.0),),
        EffectiveMotors((2.0, 1.5), (1.0, 0.0)),
    ),
    chassis={"region": "pull", "turn_radius": None},
    sensors=(SensorStatus("imu", "heading", (1.5,), 0.01, 0),),
    settings=(SettingStatus("speed_override", 0.5, "of limits.velocity", 0.05, 1.0),),
    slip=SlipStatus(slipping=True, wheels=("left",), evidence=("torque",), threshold=0.01, tells="that a wheel slips"),
)

integers = st.integers(-(2**63), 2**63 - 1)
nanoseconds = st.integers(0, 2**62)
numbers = st.floats(allow_nan=False)  # NaN is never equal to itself; it has its own test
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
twists = st.builds(Twist, numbers, numbers, numbers)
poses = st.builds(Pose, numbers, numbers, numbers)
frames = st.builds(
    CanFrame,
    texts,
    st.integers(0, 2**29 - 1),
    st.binary(max_size=8) | st.binary(max_size=64),
    st.booleans(),
    st.booleans(),
    st.none() | integers,
    st.booleans(),
    st.booleans(),
)
inputs = st.builds(
    Inputs,
    cycle=st.just(0),
    now_ns=nanoseconds,
    frames=st.lists(frames, max_size=4).map(tuple),
    commands=st.lists(
        st.builds(
            TwistCommand,
            texts,
            twists,
            st.sampled_from(TwistFrame),
            st.none() | integers,
            integers,
            st.none() | texts,
            st.booleans(),
            st.none() | numbers,
            st.none() | numbers,
            st.sampled_from(Region),
            st.none() | numbers,
        ),
        max_size=2,
    ).map(tuple),
    refusals=st.lists(st.builds(Refusal, texts, st.sampled_from(RefusalCode), texts, integers), max_size=2).map(tuple),
    requests=st.lists(
        st.builds(
            Request,
            st.sampled_from(RequestKind),
            *[integers] * 2,
            *[st.none() | texts, st.none() | numbers] * 2,
            st.none() | texts,
        ),
        max_size=2,
    ).map(tuple),
    samples=st.lists(
        st.builds(
            SensorSample,
            texts,
            st.lists(st.none() | numbers, max_size=5).map(tuple),
            st.none() | integers,
            integers,
            st.none() | texts,
            st.booleans(),
        ),
        max_size=2,
    ).map(tuple),
    bus_events=st.lists(st.builds(BusEvent, texts, st.sampled_from(BusEventKind), integers, texts), max_size=2).map(
        tuple
    ),
    overruns=st.integers(0, 2**40),
    dropped_records=st.integers(0, 2**40),
)
outputs = st.builds(
    EMPTY_OUTPUTS._replace,
    frames=st.lists(frames, max_size=4).map(tuple),
    mode=st.sampled_from(Mode),
    events=st.lists(st.builds(Event, st.sampled_from(Level), texts, texts), max_size=2).map(tuple),
    replies=st.lists(st.builds(Reply, integers, st.booleans(), st.none() | texts), max_size=2).map(tuple),
    odometry=st.none()
    | st.builds(Odometry, poses, st.none() | twists, st.lists(numbers, max_size=9).map(tuple), st.none() | numbers),
    finished=st.booleans(),
)


def numbered(pairs: list[tuple[Inputs, Outputs]]) -> list[Record]:
    return [Record(before._replace(cycle=cycle), after, TIMING) for cycle, (before, after) in enumerate(pairs)]


def one(inputs: Inputs, outputs: Outputs = EMPTY_OUTPUTS) -> Record:
    return Record(inputs, outputs, TIMING)


def test_a_drive_comes_back_as_it_was(tmp_path: Path) -> None:
    records = list(drive(700))
    session = open_session(write(tmp_path, records, batch=250))
    assert session.cycle_count == 700
    assert list(session.cycles()) == expected(records)
    assert session.complete
    assert session.gaps == ()
    assert session.cycle_count == 700


def test_header(tmp_path: Path) -> None:
    session = open_session(write(tmp_path, list(drive(3))))
    header = session.header
    assert session.config_text == robot_text()
    assert (header.schema_version, header.robot, header.segment) == (SCHEMA_VERSION, "moby", 1)
    assert (header.started_wall_ns, header.wall_minus_mono_ns) == (STARTED_NS, STARTED_NS - 5_000_000_000)
    assert header.session == session.path.name == "moby-20260921T141320Z"
    assert header.versions["rerun-sdk"] == rr.__version__
    assert header.versions["arithmetic"] == "own, 1"
    assert len(header.config_sha256) == 64


def test_a_change_of_the_software_is_told_part_by_part(tmp_path: Path) -> None:
    header = open_session(write(tmp_path, list(drive(3)))).header
    assert change(header) is None
    then = msgspec.structs.replace(header, versions=header.versions | {"drivegate": "0.0.9"}, git_commit="abc")
    first, second = str(change(then)).split("; ")
    assert first == f"drivegate 0.0.9, now {header.versions['drivegate']}"
    assert second.startswith("commit abc, now ")
    del then.versions["arithmetic"]  # as before sessions told it
    assert str(change(then)).endswith("; arithmetic the machine's libraries, now own, 1")


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pairs=st.lists(st.tuples(inputs, outputs), min_size=1, max_size=6), batch=st.integers(1, 6))
def test_any_values_round_trip(tmp_path: Path, pairs: list[tuple[Inputs, Outputs]], batch: int) -> None:
    records = numbered(pairs)
    folder = write(tmp_path, records, batch=batch)
    session = open_session(folder)
    assert list(session.cycles()) == expected(records)
    assert session.gaps == ()
    shutil.rmtree(folder)


def test_edges_of_frames(tmp_path: Path) -> None:
    frames = (
        CanFrame("can0", 0, b""),
        CanFrame("can1", 0x7FF, b"", remote=True, received_ns=0),
        CanFrame("can0", 2**29 - 1, bytes(8), extended=True, received_ns=2**63 - 1),
        CanFrame("", 1, b"\0\xff", extended=True, remote=True),
        CanFrame("can0", 2, bytes(range(64)), received_ns=1),
        CanFrame("can0", 3, bytes(9), received_ns=-(2**63)),
    )
    records = [one(Inputs(0, 1, frames), EMPTY_OUTPUTS._replace(frames=frames)), one(Inputs(1, 2))]
    assert list(open_session(write(tmp_path, records)).cycles()) == expected(records)


def test_unknown_is_neither_nan_nor_zero_nor_empty(tmp_path: Path) -> None:
    def said(residual: float | None, twist: Twist | None, reason: str | None) -> Outputs:
        odometry = Odometry(Pose(-0.0, 0.0, math.inf), twist, (), residual)
        return EMPTY_OUTPUTS._replace(odometry=odometry, replies=(Reply(1, ok=False, reason=reason),))

    cases = [
        said(None, None, None),
        said(math.nan, Twist(math.nan, 0.0, 0.0), ""),
        said(0.0, ZERO_TWIST, "ä\0\N{GRINNING FACE}"),
        EMPTY_OUTPUTS,
    ]
    records = [one(Inputs(cycle, cycle), outputs) for cycle, outputs in enumerate(cases)]
    read = [outputs for _, outputs in open_session(write(tmp_path, records)).cycles()]
    assert [outputs.replies for outputs in read] == [case.replies for case in cases]
    assert read[3].odometry is None
    for outputs, case in zip(read[:3], cases[:3], strict=True):
        assert outputs.odometry is not None
        assert repr(outputs.odometry) == repr(case.odometry)  # equal to the last sign, and NaN where it was NaN


def test_floats_are_exact_to_the_bit(tmp_path: Path) -> None:
    generator = random.Random(1)
    values = [struct.unpack("<d", generator.randbytes(8))[0] for _ in range(300)]
    values = [value for value in values if not math.isnan(value)] + [5e-324, 1.7976931348623157e308, 0.1]
    records = [
        one(Inputs(cycle, cycle), EMPTY_OUTPUTS._replace(odometry=Odometry(Pose(value, 0, 0), None, (value,), value)))
        for cycle, value in enumerate(values)
    ]
    read = [outputs.odometry for _, outputs in open_session(write(tmp_path, records)).cycles()]
    assert [struct.pack("<d", odometry.pose.x) for odometry in read if odometry] == [
        struct.pack("<d", value) for value in values
    ]


def test_status_is_written_for_people(tmp_path: Path) -> None:
    records = [one(Inputs(0, 0), EMPTY_OUTPUTS._replace(status=STATUS))]
    folder = write(tmp_path, records)
    assert list(open_session(folder).cycles()) == expected(records)
    found = list(RrdReader(folder / "segment-00001.rrd").stream().filter(content="/outputs/status"))
    text = found[0].to_record_batch().column("Status:json").to_pylist()[0][0]
    assert msgspec.json.decode(text)["motors"][0]["name"] == "left"


def test_rotation_keeps_order_and_header(tmp_path: Path) -> None:
    records = list(drive(600))
    session = writer(tmp_path, segment_bytes=60_000)
    for start in range(0, 600, 50):
        session.write(records[start : start + 50])
    session.close()
    read = open_session(session.folder)
    assert len(read.segments) > 2
    assert list(read.cycles()) == expected(records)
    assert read.complete
    assert read.gaps == ()
    for number, segment in enumerate(read.segments, start=1):
        alone = open_session(segment)
        assert alone.config_text == robot_text()
        assert alone.header.segment == number
        assert all(cycles in expected(records) for cycles in alone.cycles())


def test_a_spoilt_segment_does_not_take_the_others_with_it(tmp_path: Path) -> None:
    records = list(drive(90))
    folder = write(tmp_path, records[:30])
    second = writer(tmp_path, folder=folder)
    second.write(records[30:])
    second.close()
    first = folder / "segment-00001.rrd"
    first.write_bytes(first.read_bytes()[:200])
    session = open_session(folder)
    assert list(session.cycles()) == expected(records[30:])
    assert not session.complete
    assert session.config_text == robot_text()


def test_marked_and_unmarked_gaps(tmp_path: Path) -> None:
    records = list(drive(100))
    kept = [record for record in records[5:90] if record.inputs.cycle not in range(20, 30)]
    kept = [record for record in kept if record.inputs.cycle != 50]
    markers = [Gap(0, 4, "before"), Gap(18, 25, "slow"), Gap(26, 29, "full"), Gap(60, 61, "not so"), Gap(88, 99, "end")]
    session = open_session(write(tmp_path, kept, gaps=markers))
    assert list(session.gaps) == [
        Gap(0, 4, "before"),
        Gap(20, 29, "slow; full"),
        Gap(50, 50, "not in the recording"),
        Gap(90, 99, "end"),
    ]
    assert list(session.cycles()) == expected(kept)


def test_a_session_begins_with_cycle_0(tmp_path: Path) -> None:
    session = open_session(write(tmp_path, list(drive(5, first=30))))
    assert session.gaps == (Gap(0, 29, "not in the recording"),)


def test_a_session_of_nothing_but_a_gap(tmp_path: Path) -> None:
    session = writer(tmp_path)
    session.write((), [Gap(0, 9, "full")])
    session.close()
    read = open_session(session.folder)
    assert list(read.cycles()) == []
    assert read.gaps == (Gap(0, 9, "full"),)
    assert read.cycle_count == 0


def test_cut_anywhere_the_whole_prefix_is_read(tmp_path: Path) -> None:
    """Cut at the end of each of the last messages, shortly before and after, in its middle, and at random places."""
    records = list(drive(60))
    path = write(tmp_path, records, batch=10) / "segment-00001.rrd"
    data = path.read_bytes()
    ends = message_ends(data)
    generator = random.Random(2)
    cuts = {end + offset for end in ends[-40:] for offset in (-1, 0, 1, 8, 20)}
    cuts |= {generator.randrange(100, len(data)) for _ in range(25)}
    whole = expected(records)
    lengths = []
    for cut in sorted(cut for cut in cuts if cut < len(data)):
        path.write_bytes(data[:cut])
        try:
            session = open_session(path)
        except SessionError as error:
            assert "no header" in str(error) or "not a Rerun file" in str(error)
            lengths.append(0)
            continue
        read = list(session.cycles())
        assert read == whole[: len(read)]
        assert not session.complete
        lengths.append(len(read))
    assert lengths == sorted(lengths)
    assert set(lengths) == {0, 10, 20, 30, 40, 50, 60}


def message_ends(data: bytes) -> list[int]:
    place, ends = 12, []
    while place + 16 <= len(data):
        kind, length = struct.unpack_from("<QQ", data, place)
        if kind == 0:
            break
        place += 16 + length
        ends.append(place)
    return ends


def test_zeros_at_the_end_after_a_power_cut(tmp_path: Path) -> None:
    records = list(drive(60))
    path = write(tmp_path, records, batch=20) / "segment-00001.rrd"
    data = path.read_bytes()
    lengths = set()
    for end in message_ends(data)[-25:-1]:
        path.write_bytes(data[: end + 200].ljust(len(data), b"\0"))
        session = open_session(path)
        read = list(session.cycles())
        assert read == expected(records)[: len(read)]
        assert not session.complete
        lengths.add(len(read))
    assert lengths == {0, 20, 40, 60}


def test_a_spoilt_message_costs_at_most_its_batch(tmp_path: Path) -> None:
    """Every message in turn; one that carries the identity of the file may cost all."""
    records = list(drive(60))
    path = write(tmp_path, records, batch=20) / "segment-00001.rrd"
    data = path.read_bytes()
    ends = message_ends(data)
    whole = expected(records)
    lengths = Counter[int]()
    for start, end in pairwise(ends):
        spoilt = bytearray(data)
        spoilt[(start + end) // 2 : end] = bytes(end - (start + end) // 2)
        path.write_bytes(spoilt)
        try:
            session = open_session(path)
            read = list(session.cycles())
        except SessionError:
            lengths[-1] += 1
            continue
        assert len(read) == 60 or not session.complete
        assert all(pair in whole for pair in read)
        lengths[len(read)] += 1
    assert lengths.pop(-1, 0) < 3
    assert min(lengths) == 40
    assert lengths[40] == 3


def test_random_damage_never_escapes_as_anything_but_a_session_error(tmp_path: Path) -> None:
    path = write(tmp_path, list(drive(40)), batch=20) / "segment-00001.rrd"
    data = path.read_bytes()
    generator = random.Random(3)
    for _ in range(60):
        spoilt = bytearray(data)
        for _ in range(generator.randrange(1, 4)):
            spoilt[generator.randrange(len(spoilt))] ^= 1 << generator.randrange(8)
        path.write_bytes(spoilt)
        try:
            session = open_session(path)
            assert len(list(session.cycles())) <= 40
        except SessionError:
            continue


def test_rerun_itself_reads_the_same_rows(tmp_path: Path) -> None:
    """Our own walk over the file against the library that wrote it."""
    records = list(drive(300))
    folder = write(tmp_path, records, batch=100)
    found: list[tuple[int, int]] = []
    for chunk in RrdReader(folder / "segment-00001.rrd").store().stream().filter(content="/cycles"):
        batch = chunk.to_record_batch()
        for cycle, (block,) in zip(
            batch.column("cycle").to_pylist(), batch.column("Cycles:block").to_pylist(), strict=True
        ):
            cycles = unpacked(block).cycles.numbers("cycle").tolist()
            assert cycles[0] == cycle
            found += zip(cycles, unpacked(block).cycles.numbers("now_ns").tolist(), strict=True)
    assert found == [(record.inputs.cycle, record.inputs.now_ns) for record in records]


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "not a Rerun file"), (b"hello, this is no recording at all", "not a Rerun file")],
)
def test_not_a_recording(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "segment-00001.rrd"
    path.write_bytes(content)
    with pytest.raises(SessionError, match=words):
        open_session(path)


def test_not_a_session(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"there is no segment-\*\.rrd"):
        open_session(tmp_path)
    with pytest.raises(SessionError, match="cannot be read: No such file"):
        open_session(tmp_path / "missing.rrd")


@pytest.mark.parametrize(("version", "words"), [(None, "no header"), (999, "session schema 999; this version")])
def test_foreign_recordings(tmp_path: Path, version: int | None, words: str) -> None:
    path = tmp_path / "foreign.rrd"
    recording = rr.RecordingStream(APPLICATION_ID)
    recording.save(path)
    recording.log("/something", rr.TextDocument("else"), static=True)
    if version is not None:
        columns = arrays(HEADER_COLUMNS, [(version, "{}")])
        recording.log(HEADER_PATH, rr.DynamicArchetype(HEADER_ARCHETYPE, components=columns), static=True)
    recording.disconnect()
    with pytest.raises(SessionError, match=words):
        open_session(path)
