"""Drives over the real kernel bus: what candump hears and a DBC reads is what the session says was commanded."""

import time
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from gateway.types import Mode
from replay.session import Session
from replay.verify import verify
from tests.drivers.test_dbc import DATABASES, DJI_DATABASE, numbers
from tests.vm.vcan_robot import Heard, VcanRobot, candump, faster_than, fresh_vcan0, heard, in_mode, sent, standing
from tests.world import NAMES

pytestmark = pytest.mark.vcan

COURSE = ((0.4, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.5), (-0.2, 0.2, 0.3))
PIECE_S = 0.8
STAMP_ERROR_NS = 50_000  # python-can keeps the kernel's stamp as a float: 0.2 us; candump prints whole microseconds
AT_THE_END = 8  # frames with which the service releases the motors after its last recorded cycle


@pytest.mark.parametrize("name", NAMES)
def test_the_bus_the_dbc_and_the_session_agree(name: str, tmp_path: Path, free_port: int) -> None:
    fresh_vcan0()
    log = tmp_path / "candump.log"
    with candump(log), VcanRobot(name, tmp_path, free_port) as robot:
        drive_course(robot)
        session = robot.finish()
    bus = heard(log)
    assert_same_commands(name, bus, session)
    assert_kernel_stamps(bus, session)
    verdict = verify(session)
    assert verdict.identical, verdict
    assert verdict.cycles > 200


def drive_course(robot: VcanRobot) -> None:
    """Every direction, one after the other, and to rest; odometry ends where the simulated robot really is."""
    client = robot.client
    robot.start()
    for twist in COURSE:
        until = time.monotonic() + PIECE_S
        robot.stream(twist, lambda _, until=until: time.monotonic() > until)  # type: ignore[misc]
    assert robot.stream((0.2, 0.0, 0.0), faster_than(0.15)).status.winner == "teleop"
    state = robot.watch(lambda state: state.status.mode is Mode.IDLE and standing(state))
    assert state.status.tx_dropped == 0
    truth, odometry = client.truth(), client.odometry()
    assert truth is not None
    assert odometry is not None
    assert odometry.x == pytest.approx(truth.x, abs=0.03)
    assert odometry.y == pytest.approx(truth.y, abs=0.03)


def assert_same_commands(name: str, bus: list[Heard], session: Session) -> None:
    """Every command frame of the session was on the bus, in that order, once, and nothing else."""
    commands = [(identifier, data) for _, identifier, data in sent(session)]
    ours = {identifier for identifier, _ in commands}
    on_bus = [(frame.id, frame.data) for frame in bus if frame.id in ours]
    assert on_bus[: len(commands)] == commands
    assert len(on_bus) - len(commands) <= AT_THE_END
    read = DBC_READERS[name]
    values = Counter(value for identifier, data in on_bus for value in [read(identifier, data)] if value is not None)
    assert sum(values.values()) > 200
    assert len(values) > 100  # a drive, not a constant


def assert_kernel_stamps(bus: list[Heard], session: Session) -> None:
    """Receive times rise, and are those of the kernel, not of the cycle that took the frame."""
    received = [frame for inputs, _ in session.cycles() for frame in inputs.frames]
    stamps = [frame.received_ns or 0 for frame in received]
    assert all(first <= second for first, second in pairwise(stamps))
    offset_ns = session.header.wall_minus_mono_ns
    heard_ns = {}
    for frame in bus:
        heard_ns.setdefault((frame.id, frame.data), []).append(frame.wall_ns - offset_ns)
    errors = sorted(nearest(heard_ns[frame.id, frame.data], frame.received_ns or 0) for frame in received)
    assert errors[len(errors) // 2] < STAMP_ERROR_NS
    assert errors[len(errors) * 99 // 100] < 20 * STAMP_ERROR_NS


def nearest(times: list[int], time_ns: int) -> int:
    """How far the nearest of these rising times is."""
    place = bisect_left(times, time_ns)
    return min(abs(candidate - time_ns) for candidate in times[max(0, place - 1) : place + 1])


def read_odrive(identifier: int, data: bytes) -> tuple[int, float] | None:
    """Axis and velocity setpoint as the vendor's DBC reads them."""
    message = DATABASES["0.6"].get_message_by_frame_id(identifier)
    node, _, what = message.name.partition("_")
    if what != "Set_Input_Vel":
        return None
    return int(node.removeprefix("Axis")), numbers(message, data)["Input_Vel"]


def read_dji(identifier: int, data: bytes) -> tuple[float, ...] | None:
    """The four currents."""
    return tuple(numbers(DJI_DATABASE.get_message_by_frame_id(identifier), data).values())


DBC_READERS: dict[str, Callable[[int, bytes], object]] = {"moby": read_odrive, "omni4": read_dji}
