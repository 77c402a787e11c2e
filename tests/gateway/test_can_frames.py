"""Frames of every length and flag: through python-can, a bus, a session and into words, each as it was."""

from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.contract import FD_LENGTHS, CanFrame
from gateway.core.frame_words import raw
from gateway.edges.can_adapter import MAX_EXTENDED_ID, MAX_STANDARD_ID, flaw, frame_of, message_of
from gateway.recording.packets import Record
from gateway.types import CycleTiming, Inputs
from replay.sessions.reader import open_session
from tests.drives import drive
from tests.recordings import write


@st.composite
def frames(draw: st.DrawFn) -> CanFrame:
    """What a bus with CAN FD can carry."""
    extended = draw(st.booleans())
    identifier = draw(st.integers(0, MAX_EXTENDED_ID if extended else MAX_STANDARD_ID))
    kind = draw(st.sampled_from(["classic", "remote", "fd", "fast"]))
    lengths = FD_LENGTHS if kind.startswith("f") else (0,) if kind == "remote" else range(9)
    length = draw(st.sampled_from(lengths))
    data = draw(st.binary(min_size=length, max_size=length))
    return CanFrame("can0", identifier, data, extended, kind == "remote", None, kind.startswith("f"), kind == "fast")


def every_kind() -> Iterator[CanFrame]:
    for extended in (False, True):
        for length in FD_LENGTHS:
            data = bytes(range(1, length + 1))
            if length <= 8:
                yield CanFrame("can0", 0x123, data, extended)
            for switch in (False, True):
                yield CanFrame("can0", 0x123, data, extended, fd=True, bit_rate_switch=switch)
        yield CanFrame("can0", 0x123, b"", extended, remote=True)


@given(frames())
def test_through_python_can_and_back(frame: CanFrame) -> None:
    message = message_of(frame)
    message._check()
    assert flaw(message, fd=True) is None
    assert (flaw(message) is None) is not frame.fd
    assert frame_of(message, bus="can0", received_ns=None) == frame


def test_over_a_bus(request: pytest.FixtureRequest) -> None:
    channel = request.node.name
    with (
        can.Bus(interface="virtual", channel=channel, fd=True) as here,
        can.Bus(interface="virtual", channel=channel, fd=True) as there,
    ):
        for frame in every_kind():
            here.send(message_of(frame))
            message = there.recv(1.0)
            assert message is not None
            assert frame_of(message, bus="can0", received_ns=None) == frame


def test_through_a_session(tmp_path: Path) -> None:
    sent = tuple(every_kind())
    heard = tuple(frame._replace(received_ns=place) for place, frame in enumerate(sent))
    outputs = next(iter(drive(1))).outputs._replace(frames=sent)
    records = [Record(Inputs(0, 1, heard), outputs, CycleTiming(0, 0, 0))]
    ((inputs, said),) = open_session(write(tmp_path, records)).cycles()
    assert inputs.frames == heard
    assert said.frames == sent
    assert {type(frame.fd) for frame in inputs.frames} == {bool}


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (CanFrame("can0", 0x12, b"\x01\xff"), "can0 012#01FF"),
        (CanFrame("can0", 0x12, b"", extended=True, remote=True), "can0 00000012#R"),
        (CanFrame("can0", 0x12, b"\x01", fd=True), "can0 012##001"),
        (CanFrame("can0", 0x12, b"\x01", fd=True, bit_rate_switch=True), "can0 012##101"),
    ],
)
def test_in_words_as_candump_writes_them(frame: CanFrame, words: str) -> None:
    assert raw(frame) == words
