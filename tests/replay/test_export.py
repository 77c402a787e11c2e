"""What a session is exported as holds every frame, as python-can, MCAP's own reader and Arrow read it back."""

import json
from importlib import reload
from pathlib import Path

import can
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pyarrow import parquet
from typer.testing import CliRunner, Result

from drivers.contract import CanFrame
from gateway.cli.app import build
from gateway.recording.disk import segment_path
from gateway.recording.packets import Record
from gateway.types import CycleTiming, Twist
from replay.compare.retrace import columns, rows
from replay.logs import blf, mf4
from replay.logs.export import Format, export, format_of, logged
from replay.logs.formats import opened
from replay.logs.logged import Clock, LogError, Logged
from replay.sessions.reader import Session, open_session
from tests.recordings import write, write_drive
from tests.world import World

SECOND_NS = 10**9
FRAMES = [Format.CANDUMP, Format.ASC, Format.BLF, Format.MF4, Format.MCAP]
READERS = {
    Format.CANDUMP: can.CanutilsLogReader,
    Format.ASC: can.ASCReader,
    Format.BLF: can.BLFReader,
    Format.MF4: can.MF4Reader,
}
SUFFIX = {to: "log" if to is Format.CANDUMP else to.value for to in Format}
EXACT_NS = {to: 1000 if to is Format.CANDUMP else 1 for to in FRAMES}  # the least that a time is told in


@pytest.fixture(scope="module")
def world() -> World:
    driven = World("omni4", rate_hz=100.0)
    driven.start()
    driven.run(0.5, Twist(0.3, 0.1, 0.2))
    return driven


@pytest.fixture(scope="module")
def session(world: World, tmp_path_factory: pytest.TempPathFactory) -> Session:
    return open_session(write_drive(tmp_path_factory.mktemp("s"), world, batch=30, segment_bytes=60_000))


@pytest.fixture(scope="module")
def odd(world: World, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """One cycle with frames of every kind, on two buses, and times to the nanosecond."""
    inputs, outputs = world.records[0]
    now_ns = inputs.now_ns
    heard = (
        CanFrame("can0", 0x123, b"\1\2\3", received_ns=now_ns - 3),
        CanFrame("can1", 0x1ABCDEF0, b"", extended=True, received_ns=now_ns - 2),
        CanFrame("can0", 0x7FF, b"", remote=True, received_ns=now_ns - 1),
        CanFrame("can1", 0x45, bytes(64), fd=True, bit_rate_switch=True, received_ns=now_ns),
        CanFrame("can1", 0x46, bytes(range(12)), fd=True, extended=True, received_ns=now_ns),
    )
    record = Record(inputs._replace(frames=heard), outputs._replace(frames=()), CycleTiming(0, 0, 0))
    return open_session(write(tmp_path_factory.mktemp("s"), [record]))


def asked(*arguments: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "export", *map(str, arguments)])


def written(session: Session, to: Format, tmp_path: Path) -> Path:
    path = tmp_path / f"log.{SUFFIX[to]}"
    assert export(session, path, to).frames == len(list(logged(session)))
    return path


def when(one: Logged) -> int:
    assert one.time_ns is not None
    return one.time_ns


def message(one: Logged) -> tuple[object, ...]:
    frame = one.frame
    kind = (frame.extended, frame.remote, frame.fd, frame.bit_rate_switch)
    return (frame.id, frame.data, *kind, one.sent)


def by_python_can(found: can.Message) -> tuple[object, ...]:
    kind = (found.is_extended_id, found.is_remote_frame, found.is_fd, found.bitrate_switch)
    return (found.arbitration_id, bytes(found.data or b""), *kind, not found.is_rx)


@pytest.mark.parametrize("to", READERS)
@pytest.mark.parametrize("name", ["session", "odd"])
def test_python_can_reads_every_frame(to: Format, name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    session: Session = request.getfixturevalue(name)
    expected = list(logged(session))
    reload(can.io.mf4)  # which we import as if there were no asammdf
    with READERS[to](written(session, to, tmp_path)) as log:
        messages = list(log)
    if to is Format.MF4:  # where remote frames are apart, and it cannot tell what is first within 240 ns
        expected.sort(key=lambda one: one.frame.remote)
        messages.sort(key=lambda one: one.is_remote_frame)
    assert list(map(by_python_can, messages)) == list(map(message, expected))
    begin_ns = when(expected[0]) // 10**6 * 10**6 if to is Format.ASC else 0  # it tells them since the beginning
    for found, one in zip(messages, expected, strict=True):
        assert abs(found.timestamp - (when(one) - begin_ns) / SECOND_NS) < 2e-6  # its times are floats
    first = 1 if to is Format.MF4 else 0  # it counts those of the others from 0
    numbers = {"can0": "can0", "can1": "can1"} if to is Format.CANDUMP else {"can0": first, "can1": first + 1}
    assert [found.channel for found in messages] == [numbers[one.frame.bus] for one in expected]


def test_ros_reads_every_frame(session: Session, odd: Session, tmp_path: Path) -> None:
    for one in (session, odd):
        expected = list(logged(one))
        with written(one, Format.MCAP, tmp_path).open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            assert reader.get_header().profile == "ros2"
            found = list(reader.iter_decoded_messages(log_time_order=False))
        assert len(found) == len(expected)
        for (schema, channel, raw, told), (time_ns, frame, sent) in zip(found, expected, strict=True):
            suffix = "_fd" if frame.fd else ""
            assert channel.topic == f"/{frame.bus}/{'to' if sent else 'from'}_can_bus{suffix}"
            assert schema is not None
            assert schema.name == ("ros2_socketcan_msgs/msg/FdFrame" if frame.fd else "can_msgs/msg/Frame")
            assert raw.log_time == told.header.stamp.sec * SECOND_NS + told.header.stamp.nanosec == time_ns
            assert (told.id, told.is_extended, told.header.frame_id) == (frame.id, frame.extended, frame.bus)
            length = told.len if frame.fd else told.dlc
            assert bytes(told.data)[:length] == frame.data
            assert not told.is_error
            assert frame.fd or told.is_rtr == frame.remote


@pytest.mark.parametrize("to", FRAMES)
@pytest.mark.parametrize("name", ["session", "odd"])
def test_our_own_readers_read_every_frame(
    to: Format, name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    session: Session = request.getfixturevalue(name)
    expected = list(logged(session))
    with opened(written(session, to, tmp_path)) as (frames, account):
        found = list(frames)
    assert not account.left_out
    assert account.clock is (Clock.WALL if to in {Format.ASC, Format.BLF} else Clock.EPOCH)
    names = {"1": "can0", "2": "can1"}
    assert [names.get(one.frame.bus, one.frame.bus) for one in found] == [one.frame.bus for one in expected]
    seen = list(map(message, expected))
    if to is Format.MCAP:
        seen = [(*one[:5], False, *one[6:]) for one in seen]  # FdFrame does not tell of the bit rate
    assert list(map(message, found)) == seen
    step = EXACT_NS[to]
    assert [one.time_ns for one in found] == [when(one) // step * step for one in expected]


def test_the_channels_as_a_table(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "channels.parquet"
    expected = list(rows(session.again()))
    assert export(session, path, Format.PARQUET).rows == len(expected)
    table = parquet.read_table(path)
    assert table.column_names == ["time", *columns(session)]
    assert [list(row) for row in zip(*table.drop_columns("time").to_pydict().values(), strict=True)] == expected
    stamps = table["time"].cast("int64").to_pylist()
    offset_ns = session.header.wall_minus_mono_ns
    assert stamps == [inputs.now_ns + offset_ns for inputs, _ in session.cycles()]


def test_the_command(session: Session, tmp_path: Path) -> None:
    result = asked(session.path, tmp_path / "drive.blf", "--json")
    assert result.exit_code == 0
    told = json.loads(result.stdout.splitlines()[-1])
    assert (told["format"], told["channels"], told["complete"]) == ("blf", {"can0": "1"}, True)
    assert told["frames"] == len(list(can.BLFReader(tmp_path / "drive.blf")))
    assert asked(session.path, tmp_path / "drive.txt", "--format", "candump").exit_code == 0
    assert asked(session.path, tmp_path / "drive.txt").exit_code == 2
    assert asked(tmp_path / "nothing", tmp_path / "drive.log").exit_code == 2


def test_what_is_left_of_a_session_is_exported_and_said(session: Session, tmp_path: Path) -> None:
    left = segment_path(tmp_path, 2)
    left.write_bytes(segment_path(session.path, 2).read_bytes())
    result = asked(left, tmp_path / "drive.log")
    assert result.exit_code == 3
    assert len(list(can.CanutilsLogReader(tmp_path / "drive.log"))) == len(list(logged(open_session(left)))) > 0


def test_a_file_is_whole_or_as_it_was(session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "drive.blf"
    path.write_bytes(b"before")
    monkeypatch.setattr(blf.Writer, "close", full)
    assert asked(session.path, path).exit_code == 2
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_named(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "nothing" / "drive.log"
    result = asked(session.path, path, "--json")
    problem = f"{path}: cannot be written: No such file or directory"
    assert (result.exit_code, json.loads(result.stdout)["problem"]) == (2, problem)


def test_without_the_package_for_mf4_it_is_said_what_to_install(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mf4, "is_installed", lambda: False)
    result = asked(session.path, tmp_path / "drive.mf4", "--json")
    assert result.exit_code == 2
    assert "pip install 'drivegate[mf4]'" in json.loads(result.stdout)["problem"]
    assert not list(tmp_path.iterdir())


def test_a_suffix_says_what_to_write() -> None:
    assert format_of(Path("a.MCAP")) is Format.MCAP
    with pytest.raises(LogError, match="--format"):
        format_of(Path("a.csv"))


def test_a_session_without_frames(world: World, tmp_path: Path) -> None:
    inputs, outputs = world.records[0]
    record = Record(inputs._replace(frames=()), outputs._replace(frames=()), CycleTiming(0, 0, 0))
    session = open_session(write(tmp_path / "s", [record]))
    assert written(session, Format.CANDUMP, tmp_path).read_bytes() == b""
    for to in FRAMES[1:]:
        with opened(written(session, to, tmp_path)) as (frames, account):
            assert list(frames) == []
        assert not account.left_out
