"""Recorded frames on python-can's virtual bus: all of them, in order, on time, and nothing that is no frame."""

import time
from pathlib import Path
from threading import Event, Thread

import can
import pytest

from drivers.contract import CanFrame
from gateway.types import ZERO_TWIST, Twist
from replay.drive.player import Direction, Due, is_alive, play, recorded, recorded_buses
from replay.sessions.reader import Session, open_session
from tests.recordings import write_drive
from tests.world import World

SECONDS = 1.0


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    world = World("moby")
    world.run(0.3, ZERO_TWIST)
    world.run(SECONDS - 0.3, Twist(0.3, 0.0, 0.0))
    return open_session(write_drive(tmp_path_factory.mktemp("sessions"), world))


@pytest.fixture
def target(request: pytest.FixtureRequest) -> can.BusABC:
    bus = can.Bus(interface="virtual", channel=request.node.name)
    request.addfinalizer(bus.shutdown)
    return bus


@pytest.fixture
def listener(request: pytest.FixtureRequest) -> can.BusABC:
    bus = can.Bus(interface="virtual", channel=request.node.name)
    request.addfinalizer(bus.shutdown)
    return bus


def drain(bus: can.BusABC) -> list[can.Message]:
    messages = []
    while (message := bus.recv(0)) is not None:
        messages.append(message)
    return messages


def due(time_ns: int, identifier: int, *, extended: bool = False) -> Due:
    return Due(time_ns, CanFrame("can0", identifier, b"\1\2", extended))


@pytest.mark.parametrize("only", [None, *Direction])
def test_every_frame_is_played_in_order_and_on_time(
    session: Session, target: can.BusABC, listener: can.BusABC, only: Direction | None
) -> None:
    frames = recorded(session, "can0", only)
    assert len(frames) > 500
    played = play(frames, target)
    assert [(message.arbitration_id, bytes(message.data)) for message in drain(listener)] == [
        (frame.id, frame.data) for _, frame in frames
    ]
    assert played.frames == len(frames)
    assert played.median_error_us <= 1000.0
    assert played.seconds == pytest.approx(SECONDS, abs=0.2)


def test_directions_make_up_the_whole(session: Session) -> None:
    both, sent, heard = (recorded(session, "can0", only) for only in (None, Direction.TX, Direction.RX))
    assert len(both) == len(sent) + len(heard)
    assert all(frame.received_ns is None for _, frame in sent)
    assert all(frame.received_ns is not None for _, frame in heard)
    assert [time_ns for time_ns, _ in both] == sorted(time_ns for time_ns, _ in both)
    assert recorded_buses(session) == ["can0"]


def test_speed(session: Session, target: can.BusABC) -> None:
    assert play(recorded(session, "can0", None), target, speed=4.0).seconds == pytest.approx(SECONDS / 4, abs=0.1)


def test_lateness_does_not_add_up(target: can.BusABC, monkeypatch: pytest.MonkeyPatch) -> None:
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda seconds: sleep(seconds + 0.005))
    played = play([due(index * 10_000_000, 1) for index in range(30)], target)
    assert played.seconds < 0.29 + 0.05
    assert played.median_error_us > 4000.0  # it says so


def test_an_error_frame_of_a_log_is_never_played_as_a_data_frame(target: can.BusABC, listener: can.BusABC) -> None:
    flag = 0x20000000
    frames = [due(0, flag | 0x40, extended=True), due(0, flag | 0x04), due(0, 0x801), due(0, 0x7FF)]
    played = play([*frames, due(0, 0x1FFFFFFF, extended=True)], target)
    assert (played.frames, played.not_frames) == (2, 3)
    assert [(message.arbitration_id, message.is_extended_id) for message in drain(listener)] == [
        (0x7FF, False),
        (0x1FFFFFFF, True),
    ]


def test_what_the_bus_refuses_is_counted_and_not_repeated(target: can.BusABC, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(message: can.Message, **_: object) -> None:
        raise can.CanOperationError(f"no room for {message.arbitration_id}", 105)

    monkeypatch.setattr(target, "send", refuse)
    played = play([due(0, 1), due(0, 2)], target)
    assert (played.frames, played.not_sent) == (0, 2)
    assert played.problem is not None
    assert "no room for 1" in played.problem


def test_a_bus_with_somebody_on_it_is_alive(target: can.BusABC, listener: can.BusABC) -> None:
    assert not is_alive(target)
    ended = Event()

    def talk() -> None:
        while not ended.wait(0.05):
            listener.send(can.Message(arbitration_id=1, is_extended_id=False))

    thread = Thread(target=talk)
    thread.start()
    assert is_alive(target)
    ended.set()
    thread.join()


def test_nothing_to_play(target: can.BusABC) -> None:
    assert play([], target).frames == 0


def test_a_session_without_this_bus_has_nothing_for_it(session: Session, tmp_path: Path) -> None:
    assert recorded(session, "can1", None) == []
    assert not list(tmp_path.iterdir())
