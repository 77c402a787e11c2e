"""MF4: made byte by byte from the published layout, by other people's writer, and damaged in every way."""

import gzip
import os
import random
import subprocess
import sys
from collections.abc import Iterator
from importlib import reload
from pathlib import Path
from struct import pack
from typing import IO, Any

import can
import numpy as np
import pytest

from drivers.contract import CanFrame
from replay.logs import mf4, mf4_files
from replay.logs.formats import opened
from replay.logs.logged import Account, Clock, LogError, Logged
from tests.replay.mf4_made import BEGAN_NS, TIME, Channel, Records, canedge, file, packed, unfinished

FRAMES = [
    Logged(BEGAN_NS + 1, CanFrame("1", 0x123, b"\1\2\3\4\5\6\7\x08"), sent=False),
    Logged(BEGAN_NS + 1_000_000_003, CanFrame("2", 0x1ABCDEF0, b"\1", extended=True), sent=True),
    Logged(BEGAN_NS + 1_000_000_007, CanFrame("1", 0x45, bytes(range(12)), fd=True, bit_rate_switch=True), sent=False),
    Logged(BEGAN_NS + 40 * 86_400 * 10**9 + 11, CanFrame("1", 0x7FF, b""), sent=False),
]
WIDTH = 12


def records(*rows: bytes) -> Records:
    size = 14 + WIDTH
    return Records(canedge(WIDTH), size, b"".join(row.ljust(size, b"\0") for row in rows))


def made(**more: Any) -> bytes:  # noqa: ANN401  # of `file`
    first, second, third, fourth = FRAMES
    return file(
        records(
            packed(1, 0x123, first.frame.data, 8),
            packed(1_000_000_003, 0x1ABCDEF0, second.frame.data, 1, flags=1, sent=1, channel=2),
            packed(1_000_000_007, 0x45, third.frame.data, 9, flags=6),
            packed((fourth.time_ns or 0) - BEGAN_NS, 0x7FF, b"", 0),
        ),
        **more,
    )


def read(path: Path) -> tuple[list[Logged], Account]:
    with opened(path) as (frames, account):
        return list(frames), account


def read_bytes(tmp_path: Path, content: bytes) -> tuple[list[Logged], Account]:
    path = tmp_path / "log.asc"  # its name says nothing
    path.write_bytes(content)
    return read(path)


def left_out(account: Account) -> dict[str, int]:
    return {what: one.times for what, one in account.left_out.items()}


@pytest.mark.parametrize("name", ["finished", "unfinished", "packed", "packed and unfinished"])
def test_every_frame_to_the_nanosecond(name: str, tmp_path: Path) -> None:
    content = unfinished(made()) if "unfinished" in name else made()
    found, account = read_bytes(tmp_path, gzip.compress(content) if "packed" in name else content)
    assert found == FRAMES
    assert (account.style, account.clock, left_out(account)) == ("MF4 4.10", Clock.EPOCH, {})
    path = tmp_path / "log.asc"
    assert (gzip.decompress(path.read_bytes()) if "packed" in name else path.read_bytes()) == content


def test_a_log_that_may_only_be_read(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(unfinished(made()))
    path.chmod(0o400)
    assert read(path)[0] == FRAMES


@pytest.mark.parametrize(
    ("more", "clock", "began_ns"),
    [({"local": True}, Clock.WALL, BEGAN_NS), ({"began_ns": 0}, Clock.BEGINNING, 0)],
)
def test_what_times_count_from(more: dict[str, Any], clock: Clock, began_ns: int, tmp_path: Path) -> None:
    found, account = read_bytes(tmp_path, made(**more))
    assert account.clock is clock
    assert [(one.time_ns or 0) - began_ns for one in found] == [(one.time_ns or 0) - BEGAN_NS for one in FRAMES]


@pytest.mark.parametrize(
    ("raw", "step", "expected_ns"),
    [
        ([0, 3, 86_400_000_000_000_001], 1e-9, [0, 3, 86_400_000_000_000_001]),  # more than a float holds
        ([0, 7], 1e-7, [0, 700]),
        ([0.0, 0.5, 2.25], 1e-6, [0, 500, 2250]),
        ([0.0, 4_147_200.000_000_001], 1.0, [0, 4_147_200_000_000_001]),  # 48 days
        ([-2.0, 0.000_000_001], 1.0, [-2_000_000_000, 1]),
    ],
)
def test_times_are_as_exact_as_the_file_has_them(raw: list[float], step: float, expected_ns: list[int]) -> None:
    assert mf4_files._nanoseconds(np.array(raw), step, 0.0).tolist() == expected_ns


@pytest.mark.parametrize("raw", [[float("nan")], [float("inf")], [1e300]])
def test_times_that_are_none(raw: list[float]) -> None:
    with pytest.raises(ValueError, match="none"):
        mf4_files._nanoseconds(np.array(raw), 1.0, 0.0)


def test_groups_are_merged_by_time_and_a_constant_may_be_their_bus(tmp_path: Path) -> None:
    """One group for each bus, which a channel without bits tells, as newer loggers have it; one of remote frames."""
    channels = (TIME, Channel("CAN_RemoteFrame.ID", 8, 16), Channel("CAN_RemoteFrame.BusChannel", constant=2.0))
    remote = Records(channels, 10, b"".join(pack("<QH", time, 0x10 + time) for time in (2, 4, 6)))
    found, account = read_bytes(
        tmp_path, file(records(packed(1, 1, b"", 0), packed(4, 2, b"", 0), packed(7, 3, b"", 0)), remote)
    )
    assert not account.left_out
    assert [(one.time_ns or 0) - BEGAN_NS for one in found] == [1, 2, 4, 4, 6, 7]
    assert [(one.frame.bus, one.frame.id, one.frame.remote, one.sent) for one in found] == [
        ("1", 1, False, False),
        ("2", 0x12, True, None),
        ("1", 2, False, False),
        ("2", 0x14, True, None),
        ("2", 0x16, True, None),
        ("1", 3, False, False),
    ]


def test_frames_that_go_backwards_stay_where_they_are(tmp_path: Path) -> None:
    rows = [packed(time, number, b"", 0) for number, time in enumerate((5, 9, 3, 7, 12))]
    remote = Records((TIME, Channel("CAN_RemoteFrame.ID", 8, 16)), 10, pack("<QH", 8, 0x10))
    found, _ = read_bytes(tmp_path, file(records(*rows), remote))
    assert [one.frame.id for one in found] == [0, 0x10, 1, 2, 3, 4]
    assert found[1].frame.bus == "CAN"  # of the source, where no channel tells


def test_what_is_no_frame_is_counted_and_named(tmp_path: Path) -> None:
    error = Records((TIME, Channel("CAN_ErrorFrame.ID", 8, 16)), 10, bytes(30))
    lin = Records((TIME, Channel("LIN_Frame.ID", 8, 16)), 10, bytes(20), bus=3)
    spoilt = (
        packed(1, 0x123, b"\1\2\3", 8),  # three bytes, and a code that says eight
        packed(2, 0x45, bytes(9), 9, flags=4),  # nine bytes are none of CAN FD
        packed(3, 0x800, b"", 0),
        packed(4, 0x123, b"\1", 1),
    )
    found, account = read_bytes(tmp_path, file(error, records(*spoilt), lin))
    assert [one.frame.id for one in found] == [0x123]
    assert left_out(account) == {
        "more or less data than its length code says": 1,
        "more or less data than a frame can have": 1,
        "an id that is none": 1,
        "error frame": 3,
        "frame of LIN": 2,
    }


def test_what_python_can_writes(tmp_path: Path) -> None:
    """Its times are a float of seconds since the moment of writing."""
    reload(can.io.mf4)  # which we import as if there were no asammdf
    path = tmp_path / "log.mf4"
    began = 1_672_531_200.0
    with can.MF4Writer(path) as log:
        log.on_message_received(can.Message(began, 0x123, is_extended_id=False, data=b"\1\2\3", channel=1))
        log.on_message_received(can.Message(began + 0.25, 0x7FF, is_extended_id=False, is_remote_frame=True, channel=0))
        log.on_message_received(can.Message(began + 0.5, is_error_frame=True, channel=0))
        log.on_message_received(
            can.Message(began + 0.75, 0x45, data=bytes(range(64)), is_fd=True, bitrate_switch=True, is_rx=False)
        )
    found, account = read(path)
    assert [(one.frame, one.sent) for one in found] == [
        (CanFrame("1", 0x123, b"\1\2\3"), False),
        (CanFrame("0", 0x7FF, b"", remote=True), False),
        (CanFrame("0", 0x45, bytes(range(64)), extended=True, fd=True, bit_rate_switch=True), True),
    ]
    first_ns = found[0].time_ns or 0
    assert [round(((one.time_ns or 0) - first_ns) / 1e6) for one in found] == [0, 250, 750]
    assert left_out(account) == {"error frame": 1}


def test_without_the_package_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mf4, "is_installed", lambda: False)
    with pytest.raises(LogError, match=r"pip install 'drivegate\[mf4\]'"):
        read_bytes(tmp_path, made())


def test_links_in_a_circle_come_to_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mf4, "LIMITS", mf4.LIMITS._replace(seconds=1))
    with pytest.raises(LogError, match=r"log\.asc: an MF4 that is cut or damaged: its reader came to no end"):
        read_bytes(tmp_path, made(circle=True))


def test_the_reader_has_so_much_memory_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mf4, "LIMITS", mf4.LIMITS._replace(memory=1 << 20))
    found, account = read_bytes(tmp_path, file(records(*[packed(1, 1, b"", 0)] * 50_000)))
    assert (found, left_out(account)) == ([], {"records that cannot be read: MemoryError": 50_000})


def test_nothing_is_left_of_a_log_that_is_not_read_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    children: list[subprocess.Popen[bytes]] = []
    start = subprocess.Popen

    def started(*arguments: Any, **more: Any) -> subprocess.Popen[bytes]:  # noqa: ANN401  # of Popen
        children.append(start(*arguments, **more))
        return children[-1]

    monkeypatch.setattr("subprocess.Popen", started)
    path = tmp_path / "log"
    path.write_bytes(unfinished(made()))
    with opened(path) as (frames, _):
        assert next(frames) == FRAMES[0]
    assert [child.returncode is not None for child in children] == [True]
    assert list(tmp_path.iterdir()) == [path]


# damage


class Forked:
    """In the place of a process: one that is forked where the package has been imported already."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        command = [sys.executable, "-m", "tests.replay.mf4_made"]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def __call__(self, command: list[str], *, stdin: IO[bytes], **_: object) -> "Forked":
        log, out = self._folder / "forked.log", self._folder / "forked.out"
        log.write_bytes(os.pread(stdin.fileno(), 1 << 30, 0))
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{log} {out} {int('+' in stdin.mode)} {' '.join(command[3:])}\n")
        self.process.stdin.flush()
        self._code = int(self.process.stdout.readline())
        self.stdout = out.open("rb")
        return self

    def wait(self) -> int:
        return self._code

    def kill(self) -> None:
        self.stdout.close()

    def communicate(self) -> None:
        pass


@pytest.fixture
def forked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    made = Forked(tmp_path)
    monkeypatch.setattr("replay.logs.mf4.subprocess.Popen", made)
    monkeypatch.setattr(mf4, "LIMITS", mf4.Limits(1 << 29, 1 << 26, 1))
    yield
    made.process.communicate()


def written(path: Path) -> bytes:
    with path.open("wb") as log:
        writer = mf4_files.Writer(log, {"1": 1, "2": 2})
        for one in FRAMES:
            writer.add(one)
        writer.add(Logged(BEGAN_NS + 2, CanFrame("2", 0x11, b"", remote=True), sent=False))
        writer.close()
    return path.read_bytes()


def whole(name: str, tmp_path: Path) -> bytes:
    match name:
        case "made":
            return made()
        case "unfinished":
            return unfinished(made())
        case _:
            return written(tmp_path / "whole")


def frames_of(path: Path, content: bytes) -> list[Logged]:
    """Of damaged bytes: frames and an account, or words; nothing else ever."""
    path.write_bytes(content)
    try:
        return read(path)[0]
    except LogError as error:
        assert str(path) in str(error)
        assert "ended with 0" not in str(error)  # nothing but the child's own words goes to the pipe
        return []


NAMES = ["made", "unfinished", "written"]


@pytest.mark.usefixtures("forked")
@pytest.mark.parametrize("name", NAMES)
def test_cut_anywhere_the_frames_that_are_read_are_those_that_were(name: str, tmp_path: Path) -> None:
    content = whole(name, tmp_path)
    expected = frames_of(tmp_path / "log", content)
    assert len(expected) in {4, 5}
    chance = random.Random(name)
    for length in (*chance.sample(range(64, len(content)), 25), *range(len(content) - 120, len(content), 12)):
        found = frames_of(tmp_path / "log", content[:length])
        assert [one.frame for one in found] == [one.frame for one in expected][: len(found)]


@pytest.mark.usefixtures("forked")
@pytest.mark.parametrize("name", NAMES)
def test_flipped_bits_are_no_exceptions(name: str, tmp_path: Path) -> None:
    content = whole(name, tmp_path)
    chance = random.Random(name)
    for _ in range(60):
        spoilt = bytearray(content)
        for _ in range(chance.choice((1, 1, 1, 4))):
            spoilt[chance.randrange(len(spoilt))] ^= 1 << chance.randrange(8)
        for one in frames_of(tmp_path / "log", bytes(spoilt)):
            assert one.frame.id <= 0x1FFFFFFF
            assert len(one.frame.data) <= (64 if one.frame.fd else 8)
            assert one.time_ns is not None
            assert one.time_ns >= 0


def test_a_cut_is_said(tmp_path: Path) -> None:
    content = made()
    place = content.rfind(b"##DT") + 24 + 30
    with pytest.raises(LogError, match="an MF4 that is cut or damaged: MdfException"):
        read_bytes(tmp_path, content[:place])
    assert read_bytes(tmp_path, unfinished(content)[:place])[0] == FRAMES[:1]  # none ever was to be at its end
