"""The simulation in real time on python-can's virtual bus; waits are for frames, never for the clock."""

import errno
import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from struct import pack, unpack

import can
import pytest

from gateway.config import load
from replay.sim.server import SimulationServer

ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
MOBY = load(ROBOTS / "moby.toml")[0]
LEFT = 1 << 5


@pytest.fixture
def host(request: pytest.FixtureRequest) -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=request.node.name) as bus:
        yield bus


@pytest.fixture
def far_end(request: pytest.FixtureRequest) -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=request.node.name) as bus:
        yield bus


def send(bus: can.BusABC, identifier: int, data: bytes = b"", *, remote: bool = False) -> None:
    bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False, is_remote_frame=remote))


def drain(bus: can.BusABC) -> list[can.Message]:
    messages = []
    while (message := bus.recv(0)) is not None:
        messages.append(message)
    return messages


def arm_left(host: can.BusABC) -> None:
    send(host, LEFT | 0x0B, pack("<II", 2, 1))
    send(host, LEFT | 0x0F, pack("<ff", 200.0, 40.0))
    send(host, LEFT | 0x0D, pack("<ff", 10.0, 0.0))
    send(host, LEFT | 0x07, pack("<I", 8))


def test_steps_exchange_frames(host: can.BusABC, far_end: can.BusABC) -> None:
    server = SimulationServer(MOBY, {"can0": far_end})
    arm_left(host)
    for _ in range(500):
        server.step()
    messages = drain(host)
    assert all(not message.is_extended_id for message in messages)
    estimates = [message for message in messages if message.arbitration_id == LEFT | 0x09]
    assert len(estimates) == pytest.approx(125, abs=1)
    assert unpack("<ff", estimates[-1].data)[1] == pytest.approx(10.0, rel=0.02)
    assert server.robot.truth.joint_rates[0] > 1.0


def test_requests_are_answered_in_the_same_step(host: can.BusABC, far_end: can.BusABC) -> None:
    server = SimulationServer(MOBY, {"can0": far_end})
    send(host, LEFT, remote=True)
    server.step()
    replies = [message for message in drain(host) if message.arbitration_id == LEFT]
    assert [bytes(reply.data[4:]) for reply in replies] == [bytes((0, 6, 10, 0))]


def test_extended_and_error_frames_are_not_commands(host: can.BusABC, far_end: can.BusABC) -> None:
    server = SimulationServer(MOBY, {"can0": far_end})
    host.send(can.Message(arbitration_id=LEFT | 0x02, is_extended_id=True))
    host.send(can.Message(arbitration_id=LEFT | 0x02, is_extended_id=False, is_error_frame=True))
    host.send(can.Message(arbitration_id=LEFT | 0x02, is_extended_id=False, is_fd=True))
    for _ in range(110):
        server.step()
    heartbeats = [message for message in drain(host) if message.arbitration_id == LEFT | 0x01]
    assert bytes(heartbeats[-1].data[:4]) == bytes(4)


def test_run_in_a_thread_until_told_to_stop(host: can.BusABC, far_end: can.BusABC) -> None:
    server = SimulationServer(MOBY, {"can0": far_end})
    stop = threading.Event()
    thread = threading.Thread(target=server.run, args=(stop,))
    thread.start()
    try:
        arm_left(host)
        state = None
        while state != 8:
            message = host.recv(10.0)
            assert message is not None
            if message.arbitration_id == LEFT | 0x01:
                state = message.data[4]
    finally:
        stop.set()
        thread.join(10.0)
    assert not thread.is_alive()


class FlakyBus:
    """Stands in for an interface that goes down and comes up."""

    def __init__(self, error: Exception) -> None:
        self.error: Exception | None = error
        self.sent = 0

    def recv(self, _timeout: float) -> None:
        if self.error is not None:
            raise self.error

    def send(self, _message: can.Message) -> None:
        if self.error is not None:
            raise self.error
        self.sent += 1


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENETDOWN, "Network is down"),
        can.CanOperationError("No buffer space available", errno.ENOBUFS),
        ValueError("invalid literal for int() with base 16: b'zz'"),
        OverflowError("int too big to convert"),
    ],
)
def test_failing_bus_is_survived_counted_and_logged_once(error: Exception, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    bus = FlakyBus(error)
    server = SimulationServer(MOBY, {"can0": bus})  # type: ignore[dict-item]
    for _ in range(50):
        server.step()
    assert server.dropped > 30
    dropped, bus.error = server.dropped, None
    for _ in range(50):
        server.step()
    assert (server.dropped, bus.sent > 30) == (dropped, True)
    assert [record.levelname for record in caplog.records] == ["WARNING", "INFO"]


def test_missing_bus_is_named() -> None:
    with pytest.raises(ValueError, match="missing buses: \\['can0'\\]"):
        SimulationServer(MOBY, {})
