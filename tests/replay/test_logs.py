"""Logs of other tools: each style as its description has it, other people's readers and writers, and damage."""

import gzip
import random
from collections.abc import Callable, Iterable
from pathlib import Path
from struct import pack
from typing import NamedTuple

import can
import pytest

from drivers.contract import CanFrame
from replay.logs import asc, blf, candump, mcap_frames
from replay.logs.formats import opened
from replay.logs.logged import Account, Clock, LogError, Logged, LogWriter, nanoseconds, seconds

SECOND_NS = 10**9
ENCODER, HEARTBEAT = bytes.fromhex("DB0F494000000000"), bytes.fromhex("0000000001000000")
TWO = [CanFrame("can0", 0x029, ENCODER), CanFrame("can0", 0x021, HEARTBEAT)]
PLAIN = "  can0  029   [8]  DB 0F 49 40 00 00 00 00\n  can0  021   [8]  00 00 00 00 01 00 00 00\n"


class Read(NamedTuple):
    """Everything that a log gave."""

    frames: list[Logged]
    account: Account

    @property
    def left_out(self) -> dict[str, int]:
        return {what: one.times for what, one in self.account.left_out.items()}


def read(path: Path) -> Read:
    with opened(path) as (frames, account):
        return Read(list(frames), account)


def read_text(tmp_path: Path, text: str, name: str = "log") -> Read:
    path = tmp_path / name
    path.write_bytes(text.encode("latin-1"))
    return read(path)


class Style(NamedTuple):
    """A way in which candump writes two frames."""

    text: str
    style: str
    clock: Clock
    times: tuple[int | None, int | None]
    sent: tuple[bool | None, bool | None] = (None, None)


WALL_NS = 1_672_531_200 * SECOND_NS  # the first of January 2023
STYLES = {
    "plain": Style(PLAIN, "candump", Clock.NONE, (None, None)),
    "-c": Style(
        "\x1b[31m  can0  029   [8]  DB 0F 49 40 00 00 00 00\x1b[0m\n"
        "\x1b[32m  can0  021   [8]  00 00 00 00 01 00 00 00\x1b[0m\n",
        *("candump", Clock.NONE, (None, None)),
    ),
    "-a": Style(
        "  can0  029   [8]  DB 0F 49 40 00 00 00 00   '..I@....'\n"
        "  can0  021   [8]  00 00 00 00 01 00 00 00   '........'\n",
        *("candump", Clock.NONE, (None, None)),
    ),
    "-S": Style(
        "  can0  029   [8]  00`00`00`00`40`49`0F`DB\n  can0  021   [8]  00`00`00`01`00`00`00`00\n",
        *("candump", Clock.NONE, (None, None)),
    ),
    "-x": Style(
        "  can0  TX - -  029   [8]  DB 0F 49 40 00 00 00 00\n  can0  RX - -  021   [8]  00 00 00 00 01 00 00 00\n",
        *("candump", Clock.NONE, (None, None), (True, False)),
    ),
    "-ta": Style(
        " (1672531200.000001)  can0  029   [8]  DB 0F 49 40 00 00 00 00\n"
        " (1672531200.250002)  can0  021   [8]  00 00 00 00 01 00 00 00\n",
        *("candump -ta", Clock.EPOCH, (WALL_NS + 1000, WALL_NS + 250_002_000)),
    ),
    "-tA": Style(
        " (2023-01-01 00:00:00.000001)  can0  029   [8]  DB 0F 49 40 00 00 00 00\n"
        " (2023-01-01 00:00:00.250002)  can0  021   [8]  00 00 00 00 01 00 00 00\n",
        *("candump -tA", Clock.WALL, (WALL_NS + 1000, WALL_NS + 250_002_000)),
    ),
    "-tz": Style(
        " (000.000000)  can0  029   [8]  DB 0F 49 40 00 00 00 00\n"
        " (000.001995)  can0  021   [8]  00 00 00 00 01 00 00 00\n",
        *("candump -tz", Clock.BEGINNING, (0, 1_995_000)),
    ),
    "-td": Style(
        " (000.010000)  can0  029   [8]  DB 0F 49 40 00 00 00 00\n"
        " (000.002500)  can0  021   [8]  00 00 00 00 01 00 00 00\n",
        *("candump -td", Clock.BEGINNING, (10_000_000, 12_500_000)),
    ),
    "-L": Style(
        "(1672531200.000001) can0 029#DB0F494000000000\n(1672531200.250002) can0 021#0000000001000000\n",
        *("candump -L", Clock.EPOCH, (WALL_NS + 1000, WALL_NS + 250_002_000)),
    ),
    "-L -x": Style(
        "(1672531200.000001) can0 029#DB0F494000000000 T\n(1672531200.250002) can0 021#0000000001000000 R\n",
        *("candump -L", Clock.EPOCH, (WALL_NS + 1000, WALL_NS + 250_002_000), (True, False)),
    ),
    "-L in ns": Style(
        "(1672531200.000000001) can0 029#DB.0F.49.40.00.00.00.00\n(1672531200.250000002) can0 021#0000000001000000\n",
        *("candump -L", Clock.EPOCH, (WALL_NS + 1, WALL_NS + 250_000_002)),
    ),
}


@pytest.mark.parametrize("name", STYLES)
def test_every_style_of_candump(name: str, tmp_path: Path) -> None:
    style = STYLES[name]
    found = read_text(tmp_path, style.text, "log.asc")  # its name says nothing
    assert [one.frame for one in found.frames] == TWO
    assert tuple(one.time_ns for one in found.frames) == style.times
    assert tuple(one.sent for one in found.frames) == style.sent
    assert (found.account.style, found.account.clock) == (style.style, style.clock)
    assert not found.account.left_out


def test_steady_differences_are_differences(tmp_path: Path) -> None:
    found = read_text(tmp_path, " (000.010000)  can0  001   [1]  00\n" * 20)
    assert found.account.style == "candump -td"
    assert found.frames[-1].time_ns == 200_000_000


def test_two_buses_slightly_out_of_order_are_no_differences(tmp_path: Path) -> None:
    times = [number * 0.001 for number in range(40)]
    times[20], times[21] = times[21], times[20]
    found = read_text(tmp_path, "".join(f" (000.{round(t * 1e6):06d})  can0  001   [1]  00\n" for t in times))
    assert found.account.style == "candump -tz"


KINDS = {  # a line, and the frame, or why there is none
    "(1.5) can0 1ABCDEF0#": CanFrame("can0", 0x1ABCDEF0, b"", extended=True),
    "(1.5) can0 00000123#11": CanFrame("can0", 0x123, b"\x11", extended=True),
    "(1.5) can0 123#R": CanFrame("can0", 0x123, b"", remote=True),
    "(1.5) can0 123#R8": CanFrame("can0", 0x123, b"", remote=True),
    "(1.5) can0 123##1" + "AB" * 64: CanFrame("can0", 0x123, b"\xab" * 64, fd=True, bit_rate_switch=True),
    "(1.5) can0 123##0": CanFrame("can0", 0x123, b"", fd=True),
    "(1.5) can0 123#1122334455667788_E": CanFrame("can0", 0x123, bytes.fromhex("1122334455667788")),
    "(1.5) vcan.0-a 7FF#00": CanFrame("vcan.0-a", 0x7FF, b"\0"),
    "(1.5) can0 20000004#0000000000000000": "error frame",
    "(1.5) can0 20000088#00009000000000": "error frame",
    "(1.5) can0 123#1": "data that is no whole bytes",
    "(1.5) can0 123#112233445566778899": "more or less data than a frame can have",
    "(1.5) can0 123##0112233445566778899": "more or less data than a frame can have",
    "(1.5) can0 FFF#00": "an id that is none",
    "(1.5) can0 123##": "CAN FD frame without flags",
    "(1.5.2) can0 123#00": "a time that is none",
    "(1.5) can0 123###00": "CAN XL frame",
    "hello": "no line of candump",
    " (1.5)  can0  20000004   [8]  00 00 00 00 00 00 00 00   ERRORFRAME": "error frame",
    " (1.5)  can0  123   [2]  remote request": CanFrame("can0", 0x123, b"", remote=True),
    " (1.5)  can0  00008001  [03]  42 01 20": CanFrame("can0", 0x8001, b"\x42\x01\x20", extended=True, fd=True),
    " (1.5)  can0  TX B -  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B": CanFrame(
        "can0", 0x123, bytes(range(12)), fd=True, bit_rate_switch=True
    ),
    " (1.5)  can0  123   [3]  01 02": "fewer bytes of data than its length says",
    " (1.5)  can0  123   [1]  0": "fewer bytes of data than its length says",
    " (1.5)  can0  123   [1]  XY": "data that is not hexadecimal",
    " (1.5)  can0  064   [10]  F0 01 FF FF FF FF FF FF FF FF": "more or less data than a frame can have",
    " (1.5) TX 000 [2]  82 03        -> reset node 3": CanFrame("-", 0, b"\x82\x03"),
    "\tbus-error": None,
    "# a comment": None,
    "// can0 123 [1] 00": None,
}


@pytest.mark.parametrize("line", KINDS)
def test_every_kind_of_line_of_candump(line: str, tmp_path: Path) -> None:
    found = read_text(tmp_path, f"{line}\n(2.5) can0 123#00\n")
    expected = KINDS[line]
    assert found.frames[-1].frame == CanFrame("can0", 0x123, b"\0")
    assert [one.frame for one in found.frames[:-1]] == ([expected] if isinstance(expected, CanFrame) else [])
    assert found.left_out == ({expected: 1} if isinstance(expected, str) else {})
    assert all(one.place == "line 1" for one in found.account.left_out.values())


def test_a_last_line_without_an_end_is_not_believed(tmp_path: Path) -> None:
    found = read_text(tmp_path, "(1.5) can0 123#1122\n(2.5) can0 123#11")
    assert len(found.frames) == 1
    assert found.left_out == {"a last line without an end, which may be cut": 1}


ASC = """date Sam Okt 30 10:06:13.191 PM 2021
base hex  timestamps {stamps}
internal events logged
// a comment of M\xe4rz
Begin Triggerblock Sat Oct 30 10:06:13.191 PM 2021
   0.000000 Start of measurement
   0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0
   1.000000 1  C8             Tx   d 8 09 08 07 06 05 04 03 02  Length = 240015 BitCount = 124 ID = 200
   1.500000 2  18EBFF00x      Rx   d D 01 02 03 04 05 06 07 08
   1.500001 1  ErrorFrame ECC: 10100010
   2.000000 2  200            Rx   r
   2.250000 CANFD   1 Rx        300  A_Name    1 0 9 12 00 01 02 03 04 05 06 07 08 09 0a 0b 102203 133
End TriggerBlock
Begin Triggerblock Sat Oct 30 11:06:13.000 PM 2021
   0.500000 1  C8             Rx   d 0
   0.600000 1  C8             Rx   d 2 01
End TriggerBlock
"""
ASC_FRAMES = [
    CanFrame("1", 0xC8, bytes.fromhex("0908070605040302")),
    CanFrame("2", 0x18EBFF00, bytes(range(1, 9)), extended=True),
    CanFrame("2", 0x200, b"", remote=True),
    CanFrame("1", 0x300, bytes(range(12)), fd=True, bit_rate_switch=True),
    CanFrame("1", 0xC8, b""),
]
ASC_LEFT_OUT = {"event that is no frame": 1, "error frame": 1, "fewer bytes of data than its length says": 1}
BEGAN_NS = 1_635_631_573_191_000_000  # 2021-10-30 22:06:13.191
SECOND_BLOCK_NS = 1_635_635_173_000_000_000


def test_asc(tmp_path: Path) -> None:
    found = read_text(tmp_path, ASC.format(stamps="absolute"), "log.txt")
    assert [one.frame for one in found.frames] == ASC_FRAMES
    assert [one.time_ns for one in found.frames] == [
        *(BEGAN_NS + after for after in (1_000_000_000, 1_500_000_000, 2_000_000_000, 2_250_000_000)),
        SECOND_BLOCK_NS + 500_000_000,
    ]
    assert [one.sent for one in found.frames] == [True, False, False, False, False]
    assert found.left_out == ASC_LEFT_OUT
    assert found.account.clock is Clock.WALL


def test_asc_with_differences(tmp_path: Path) -> None:
    found = read_text(tmp_path, ASC.format(stamps="relative"))
    assert [one.frame for one in found.frames] == ASC_FRAMES
    assert found.frames[0].time_ns == BEGAN_NS + 1_015_991_000
    assert found.frames[1].time_ns == BEGAN_NS + 2_515_991_000
    assert found.frames[4].time_ns == SECOND_BLOCK_NS + 500_000_000


def test_asc_with_decimal_numbers_and_no_date_it_can_read(tmp_path: Path) -> None:
    text = ASC.format(stamps="absolute").replace("base hex", "base dec").replace("Okt", "Xyz").replace("Oct", "Xyz")
    text = text.replace(" C8 ", " 200 ").replace("18EBFF00x", "10x").replace("09 08", "255 08")
    found = read_text(tmp_path, text)
    assert found.frames[0].frame == CanFrame("1", 200, bytes.fromhex("FF08070605040302"))
    assert found.account.clock is Clock.BEGINNING
    assert found.left_out["a date that is none"] == 3
    assert found.frames[-1].time_ns == 2_250_000_000 + 500_000_000  # behind the block before


TRC = {
    "1.1": """;$FILEVERSION=1.1
;$STARTTIME=44548.5
     1)     17535.4  Tx     00000100  8  00 01 02 03 04 05 06 07
     2)     17540.3  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY
     3)     17700.3  Rx         0704  1  RTR
     4)     17701.3  Rx         0704  2  01
""",
    "1.3": """;$FILEVERSION=1.3
;$STARTTIME=44548.5
     1)     17535.400 1  Tx    00000100 -  8    00 01 02 03 04 05 06 07
     2)     17540.300 1  Warng FFFFFFFF -  4    00 00 00 08  BUSHEAVY
     3)     17700.300 1  Rx        0704 -  1    RTR
     4)     17701.300 1  Rx        0704 -  2    01
""",
    "2.0": """;$FILEVERSION=2.0
;$STARTTIME=44548.5
;$COLUMNS=N,O,T,I,d,l,D
      1     17535.400 DT 00000100 Tx 8  00 01 02 03 04 05 06 07
      2     17540.300 ST          Rx    00 00 00 08
      3     17700.300 RR     0704 Rx 1
      4     17701.300 DT     0704 Rx 2  01
""",
    "2.1": """;$FILEVERSION=2.1
;$STARTTIME=44548.5
;$COLUMNS=N,O,T,B,I,d,R,L,D
      1     17535.400 DT 1  00000100 Tx -  8    00 01 02 03 04 05 06 07
      2     17540.300 ST 1         - Rx -  4    00 00 00 08
      3     17700.300 RR 1      0704 Rx -  1
      4     17701.300 DT 1      0704 Rx -  2    01
      5     17702.300 FB 1      0704 Rx -  9    00 01 02 03 04 05 06 07 08 09 0A 0B
""",
}
TRC_DAY_NS = 1_639_828_800 * SECOND_NS  # 2021-12-18 12:00


@pytest.mark.parametrize("version", TRC)
def test_trc(version: str, tmp_path: Path) -> None:
    found = read_text(tmp_path, TRC[version])
    expected = [CanFrame("1", 0x100, bytes(range(8)), extended=True), CanFrame("1", 0x704, b"", remote=True)]
    if version == "2.1":
        expected.append(CanFrame("1", 0x704, bytes(range(12)), fd=True, bit_rate_switch=True))
    assert [one.frame for one in found.frames] == expected
    assert [one.time_ns for one in found.frames][:2] == [TRC_DAY_NS + 17_535_400_000, TRC_DAY_NS + 17_700_300_000]
    assert [one.sent for one in found.frames][:2] == [True, False]
    passed_over = "warning" if version < "2" else "status of the hardware"
    assert found.left_out == {passed_over: 1, "fewer bytes of data than its length says": 1}
    assert found.account.style == f"TRC {version}"


def test_trc_1_0_tells_its_beginning_in_a_comment(tmp_path: Path) -> None:
    head = f";{'#' * 74}\n;   C:\\a.trc\n;    Start time: 18.12.2021 12:00:00.062\n"
    lines = (
        "     1)     17535  00000100  8  00 01 02 03 04 05 06 07\n     2)     17540  FFFFFFFF  4  00 00 00 08 -- --\n"
    )
    found = read_text(tmp_path, head + lines)
    assert [one.time_ns for one in found.frames] == [TRC_DAY_NS + 17_597_000_000]
    assert found.frames[0].frame == CanFrame("1", 0x100, bytes(range(8)), extended=True)
    assert found.left_out == {"warning": 1}


CSV = {
    "old": "Time Stamp,ID,Extended,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    "166064000,0000021A,false,0,8,FE,36,12,FE,69,05,07,AD,\n166064001,1ABCDEF0,true,1,2,00,37,\n1,x,false,0,0,\n",
    "new": "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    "166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,\n166064001,1ABCDEF0,true,Tx,1,2,00,37,\n1,2,\n",
}


@pytest.mark.parametrize("name", CSV)
def test_savvycan(name: str, tmp_path: Path) -> None:
    found = read_text(tmp_path, CSV[name])
    first = CanFrame("0", 0x21A, bytes.fromhex("FE3612FE690507AD"))
    assert [one.frame for one in found.frames] == [first, CanFrame("1", 0x1ABCDEF0, b"\0\x37", extended=True)]
    assert [one.time_ns for one in found.frames] == [166_064_000_000, 166_064_001_000]
    assert [one.sent for one in found.frames] == ([None, None] if name == "old" else [False, True])
    assert sum(found.left_out.values()) == 1
    assert found.account.clock is Clock.BEGINNING


def test_nothing_is_told_by_a_name(tmp_path: Path) -> None:
    texts = {"candump -L": STYLES["-L"].text, "ASC": ASC.format(stamps="absolute"), "TRC 2.0": TRC["2.0"]}
    for style, text in texts.items():
        for name in ("a.blf", "b.log", "c.mcap", "d"):
            assert read_text(tmp_path, text, name).account.style == style


def test_packed_with_gzip(tmp_path: Path) -> None:
    path = tmp_path / "log.gz"
    whole = gzip.compress((STYLES["-L"].text * 500).encode())
    path.write_bytes(whole)
    assert len(read(path).frames) == 1000
    path.write_bytes(whole[:-40])
    found = read(path)
    assert len(found.frames) < 1000
    assert "what follows does not unpack" in found.left_out


FOREIGN = {
    "BusMaster": b"***BUSMASTER Ver 2.4.0***\n",
    "session": b"RRF2\0\0\0\0",
    "MDF of before version 4": b"MDF     3.30    ",
    "Microchip": b"//----\nMicrochip Technology Inc.\n",
    "CRTD": b"166.064000 CXX GVRET-PC Output\n",
    "expected candump": b"hello\n",
    "line 1 is ''": b"",
}


@pytest.mark.parametrize("words", FOREIGN)
def test_what_is_not_read_is_named(words: str, tmp_path: Path) -> None:
    path = tmp_path / "log.log"
    path.write_bytes(FOREIGN[words])
    with pytest.raises(LogError, match=words) as raised:
        read(path)
    assert str(path) in str(raised.value)


def test_what_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file"):
        read(tmp_path / "nothing")
    with pytest.raises(LogError, match="directory"):
        read(tmp_path)


def messages() -> list[can.Message]:
    """Of every kind that python-can writes into BLF and ASC."""
    began = 1_672_531_200.0
    return [
        can.Message(timestamp=began, arbitration_id=0x123, data=b"\1\2\3", is_extended_id=False, channel=0),
        can.Message(timestamp=began + 0.25, arbitration_id=0x1ABCDEF0, data=bytes(8), channel=1, is_rx=False),
        can.Message(timestamp=began + 0.5, arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True, channel=0),
        can.Message(
            timestamp=began + 0.75,
            arbitration_id=0x45,
            data=bytes(range(64)),
            is_fd=True,
            bitrate_switch=True,
            channel=1,
        ),
        can.Message(timestamp=began + 1.0, is_error_frame=True, channel=0),
    ]


def of_python_can(found: Iterable[can.Message]) -> list[CanFrame]:
    return [
        CanFrame(
            bus="2" if message.channel else "1",
            id=message.arbitration_id,
            data=bytes(message.data or b""),
            extended=message.is_extended_id,
            remote=message.is_remote_frame,
            fd=message.is_fd,
            bit_rate_switch=message.bitrate_switch,
        )
        for message in found
        if not message.is_error_frame
    ]


@pytest.mark.parametrize(("suffix", "writer"), [("blf", can.BLFWriter), ("asc", can.ASCWriter)])
def test_what_python_can_writes(
    suffix: str, writer: Callable[..., can.BLFWriter | can.ASCWriter], tmp_path: Path
) -> None:
    path = tmp_path / f"log.{suffix}"
    with writer(str(path)) as file:
        for message in messages():
            file.on_message_received(message)
    found = read(path)
    assert [one.frame for one in found.frames] == of_python_can(messages())
    first_ns = found.frames[0].time_ns
    assert first_ns is not None
    assert [(one.time_ns or 0) - first_ns for one in found.frames] == [n * 250_000_000 for n in range(4)]
    assert found.left_out == {"error frame": 1}


def test_objects_across_containers(tmp_path: Path) -> None:
    path = tmp_path / "log.blf"
    with can.BLFWriter(str(path), max_container_size=101) as file:
        for number in range(300):
            file.on_message_received(can.Message(timestamp=1e9 + number, arbitration_id=number, data=b"\1", channel=0))
    found = read(path)
    assert [one.frame.id for one in found.frames] == list(range(300))
    assert not found.account.left_out


def blf_file(*objects: bytes, counted: int | None = None) -> bytes:
    """A log of these objects in one container each, not compressed; begun on 2023-01-01 00:00:00.5."""
    containers = [
        pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(found), 10, 0, len(found)) + found + bytes(len(found) % 4)
        for found in objects
    ]
    began = (2023, 1, 0, 1, 0, 0, 0, 500)
    count = len(objects) if counted is None else counted
    head = pack("<4sL8BQQLL8H8H", b"LOGG", 144, *([0] * 8), 0, 0, count, 0, *began, *began)
    return head.ljust(144, b"\0") + b"".join(containers)


def blf_object(kind: int, body: bytes, *, time: int, ten_us: bool = False, version: int = 1) -> bytes:
    times = pack("<LHHQ", 1 if ten_us else 2, 0, 0, time) if version == 1 else pack("<LBxHQ8x", 2, 0, 0, time)
    length = 16 + len(times) + len(body)
    return pack("<4sHHLL", b"LOBJ", 16 + len(times), version, length, kind) + times + body


BLF_OBJECTS = {
    "in steps of 10 us": blf_object(1, pack("<HBBL8s", 3, 0, 2, 0x123, b"\1\2"), time=7, ten_us=True),
    "a header of version 2": blf_object(1, pack("<HBBL8s", 3, 1, 2, 0x123, b"\1\2"), time=70_000, version=2),
    "of CAN_MESSAGE2": blf_object(86, pack("<HBBL8sLBBH", 3, 1, 2, 0x123, b"\1\2", 0, 0, 0, 0), time=70_000),
    "of CAN_FD_MESSAGE_64": blf_object(
        101,
        pack("<BBBBLLLLLLLHBBL", 3, 9, 12, 0, 0x9ABCDEF0, 0, 0x3000, 0, 0, 0, 0, 0, 1, 0, 0) + bytes(range(12)),
        time=70_000,
    ),
    "of a classic frame in CAN_FD_MESSAGE_64": blf_object(
        101, pack("<BBBBLLLLLLLHBBL", 3, 3, 3, 0, 0x12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0) + b"\1\2\3", time=70_000
    ),
}


@pytest.mark.parametrize("name", BLF_OBJECTS)
def test_objects_of_blf_as_python_can_reads_them(name: str, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(blf_file(BLF_OBJECTS[name]))
    (message,) = can.BLFReader(path)
    found = read(path)
    assert not found.account.left_out
    (one,) = found.frames
    assert one.frame._replace(bus="1") == of_python_can([message])[0]._replace(bus="1")
    assert (one.frame.bus, one.sent) == (str(int(str(message.channel)) + 1), not message.is_rx)
    assert one.time_ns == WALL_NS + 500_070_000
    assert message.timestamp == pytest.approx(one.time_ns / SECOND_NS, abs=1e-6)


def test_objects_that_are_missing_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(blf_file(BLF_OBJECTS["of CAN_MESSAGE2"], counted=5))
    assert list(read(path).left_out) == ["objects that are missing: 5 by its head, 1 are there"]


def test_what_of_blf_is_no_frame_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log"
    kinds = (73, 2, 96, 115, 999)
    path.write_bytes(blf_file(*[blf_object(kind, bytes(64), time=1) for kind in kinds]))
    assert read(path).left_out == {"error frame": 2, "marker": 1, "object of kind 999": 1}


# damage


def some(count: int) -> list[Logged]:
    return [
        Logged(WALL_NS + number, CanFrame("can0", number, bytes([number]) * 8), sent=bool(number % 2))
        for number in range(count)
    ]


def binary(path: Path, make: Callable[..., LogWriter], *more: object) -> bytes:
    with path.open("wb") as file:
        writer = make(file, *more)
        for one in some(12):
            writer.add(one)
        writer.close()
    return path.read_bytes()


def whole(name: str, tmp_path: Path) -> bytes:
    match name:
        case "blf":
            return binary(tmp_path / "whole", blf.Writer, {"can0": 1})
        case "mcap":
            return binary(tmp_path / "whole", mcap_frames.Writer)
        case "gzip":
            return gzip.compress(STYLES["-L"].text.encode())
    texts = {"asc": ASC.format(stamps="absolute"), "csv": CSV["new"], "trc": TRC["2.1"], "trc 1.1": TRC["1.1"]}
    return (texts | {f"candump {name}": style.text for name, style in STYLES.items()})[name].encode("latin-1")


NAMES = ["blf", "mcap", "gzip", "asc", "csv", "trc", "trc 1.1", *(f"candump {name}" for name in STYLES)]


def frames_of(path: Path, data: bytes) -> list[Logged]:
    """Of damaged bytes: frames and an account, or words; nothing else ever."""
    path.write_bytes(data)
    try:
        return read(path).frames
    except LogError as error:
        assert str(path) in str(error)
        return []


@pytest.mark.parametrize("name", NAMES)
def test_cut_anywhere_the_frames_in_front_are_read(name: str, tmp_path: Path) -> None:
    data = whole(name, tmp_path)
    expected = frames_of(tmp_path / "log", data)
    for length in range(0, len(data), 1 if len(data) < 2500 else 7):
        found = frames_of(tmp_path / "log", data[:length])
        bare = [one.frame for one in found]
        assert bare == [one.frame for one in expected][: len(bare)]  # none is another one than it was


@pytest.mark.parametrize("name", NAMES)
def test_flipped_bits_are_no_exceptions(name: str, tmp_path: Path) -> None:
    data = whole(name, tmp_path)
    chance = random.Random(name)
    for _ in range(300):
        spoilt = bytearray(data)
        for _ in range(chance.choice((1, 1, 1, 4))):
            spoilt[chance.randrange(len(spoilt))] ^= 1 << chance.randrange(8)
        for one in frames_of(tmp_path / "log", bytes(spoilt)):
            assert one.frame.id <= 0x1FFFFFFF
            assert len(one.frame.data) <= (64 if one.frame.fd else 8)
            assert one.time_ns is None or one.time_ns >= 0


@pytest.mark.parametrize("name", ["blf", "mcap"])
def test_a_cut_is_said(name: str, tmp_path: Path) -> None:
    data = whole(name, tmp_path)
    path = tmp_path / "log"
    path.write_bytes(data[: len(data) * 2 // 3])
    assert read(path).account.left_out


def test_times_are_whole_numbers() -> None:
    assert nanoseconds("1672531200.123456789") == 1_672_531_200_123_456_789
    assert nanoseconds("0.1") == 100_000_000
    assert seconds(1_672_531_200_123_456_789) == "1672531200.123456789"
    assert seconds(1_672_531_200_123_456_789, 6) == "1672531200.123456"
    assert seconds(7) == "0.000000007"


def test_the_writers_have_the_frames_they_were_given(tmp_path: Path) -> None:
    for suffix, make in (("log", candump.Writer), ("asc", lambda file: asc.Writer(file, {"can0": 1}))):
        path = tmp_path / f"log.{suffix}"
        with path.open("w") as file:
            writer: LogWriter = make(file)
            for one in some(5):
                writer.add(one)
            writer.close()
        assert [one.frame.data for one in read(path).frames] == [one.frame.data for one in some(5)]
