"""Drives over the real kernel bus: what candump hears and a DBC reads is what the session says was commanded."""

from bisect import bisect_left
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.core.assembly import build
from gateway.types import Mode
from replay.compare.verify import verify
from replay.sessions.reader import Session
from tests.drivers.test_dbc import DATABASES, DJI_DATABASE, numbers
from tests.vm.vcan_robot import Heard, VcanRobot, candump, fresh_vcan0, heard, sent, standing
from tests.world import NAMES

pytestmark = pytest.mark.vcan

COURSE = ((0.4, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.5), (-0.2, 0.2, 0.3))
STAMP_ERROR_NS = 50_000  # python-can keeps the kernel's stamp as a float: 0.2 us; candump prints whole microseconds
STALL_NS = 5_000_000  # between the two clocks that convert a stamp; half a cycle
AT_THE_END = 8  # frames with which the service releases the motors after its last recorded cycle


@pytest.mark.parametrize("name", NAMES)
def test_the_bus_the_dbc_and_the_session_agree(name: str, tmp_path: Path, free_port: int) -> None:
    fresh_vcan0()
    log = tmp_path / "candump.log"
    with candump(log, "vcan0"), VcanRobot(name, tmp_path, free_port) as robot:
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
    for twist in COURSE:
        robot.drive(twist)
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
    on_bus_by_dbc = [value for identifier, data in on_bus[: len(commands)] if (value := read(identifier, data))]
    (group,) = build(parse(session.config_text, "session")).groups
    words = [(identifier, group.driver.decode(CanFrame(group.bus, identifier, data))) for identifier, data in commands]
    by_driver = [
        (identifier, *(value for _, value in word.fields))
        for identifier, word in words
        if word is not None and word.message in SETPOINTS
    ]
    assert on_bus_by_dbc == by_driver
    assert len(set(by_driver)) > 100  # a drive, not a constant


def assert_kernel_stamps(bus: list[Heard], session: Session) -> None:
    """Receive times rise, and are those of the kernel, not of the cycle that took the frame."""
    received = [(frame, inputs.now_ns) for inputs, _ in session.cycles() for frame in inputs.frames]
    stamps = [frame.received_ns or 0 for frame, _ in received]
    assert all(first <= second for first, second in pairwise(stamps))
    offset_ns = session.header.wall_minus_mono_ns
    heard_ns: dict[tuple[int, bytes], list[int]] = {}
    for line in bus:
        heard_ns.setdefault((line.id, line.data), []).append(line.wall_ns - offset_ns)
    # A frame that arrives while its cycle already takes frames counts as of the cycle's own time.
    before = [frame for frame, now_ns in received if frame.received_ns != now_ns]
    assert len(before) > len(received) // 2
    errors = sorted(nearest(heard_ns[frame.id, frame.data], frame.received_ns or 0) for frame in before)
    assert errors[len(errors) // 2] < STAMP_ERROR_NS
    assert errors[len(errors) * 99 // 100] < STALL_NS


def nearest(times: list[int], time_ns: int) -> int:
    """How far the nearest of these rising times is."""
    place = bisect_left(times, time_ns)
    return min(abs(candidate - time_ns) for candidate in times[max(0, place - 1) : place + 1])


def read_odrive(identifier: int, data: bytes) -> tuple[float, ...] | None:
    """Id, velocity and torque setpoint as the vendor's DBC reads them; None: another message."""
    message = DATABASES["0.6"].get_message_by_frame_id(identifier)
    return (identifier, *numbers(message, data).values()) if message.name.endswith("Set_Input_Vel") else None


def read_dji(identifier: int, data: bytes) -> tuple[float, ...] | None:
    """Id and the four currents."""
    return (identifier, *numbers(DJI_DATABASE.get_message_by_frame_id(identifier), data).values())


SETPOINTS = ("Set_Input_Vel", "command")
DBC_READERS: dict[str, Callable[[int, bytes], tuple[float, ...] | None]] = {"moby": read_odrive, "omni4": read_dji}
