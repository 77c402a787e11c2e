"""Faults of a real bus while a commander keeps asking for motion: rest, the reason, recovery, and no motion after it.

One service lives through all of them, in the order of this file; its session is judged at the end.
"""

import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pytest

from gateway.edges.messages import StateMessage
from gateway.types import Mode
from replay.compare.verify import verify
from tests.vm.test_vcan_drive import read_odrive
from tests.vm.vcan_robot import GO, ZERO, VcanRobot, at_speed, candump, drivegate, fresh_vcan0, heard, in_mode, shell

pytestmark = pytest.mark.vcan

ADD = "ip link add dev vcan0 type vcan && ip link set vcan0 up"
PORT = 17561
FOREIGN = 0x7A5
FOREIGN_PER_S = 1000  # many times what the loop could take in here; the virtual CPU decides how many more


class BusFault(NamedTuple):
    """How to break the bus, how to mend it, and what the state then says."""

    name: str
    breaks: str
    mends: str
    reason: str


BUS_FAULTS = (
    BusFault("interface down", "ip link set vcan0 down", "ip link set vcan0 up", "Network is down"),
    BusFault("interface deleted", "ip link del vcan0", ADD, "No such device"),
    BusFault(
        "transmit queue full",
        "tc qdisc replace dev vcan0 root pfifo limit 0",
        "tc qdisc del dev vcan0 root",
        "send queue full",
    ),
    BusFault(
        "bus-off", "cansend vcan0 20000040#0000000000000000", "cansend vcan0 20000100#0000000000000000", "bus-off"
    ),
)


class Faulty(NamedTuple):
    """The robot under test and what was heard on the bus."""

    robot: VcanRobot
    log: Path
    told: list[str]  # event codes that the session must hold

    def events(self) -> dict[str, str]:
        """What was told since the last call, texts by code."""
        events = {event.code: event.text for event in self.robot.client.events()}
        self.told.extend(events)
        return events

    def await_events(self, codes: set[str]) -> dict[str, str]:
        """Goes on asking for motion until all of these were told; everything told since the last call."""
        events = self.events()

        def complete(_: StateMessage) -> bool:
            events.update(self.events())
            return codes <= set(events)

        self.robot.stream(GO, complete)
        return events

    def setpoints_since(self, wall_ns: int) -> list[float]:
        """Velocity setpoints on the bus."""
        frames = [frame for frame in heard(self.log) if frame.wall_ns >= wall_ns]
        read = [read_odrive(frame.id, frame.data) for frame in frames if frame.id & 0x1F == 0x0D]
        return [setpoint for _, setpoint, *_ in filter(None, read)]


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Faulty]:
    """MOBY on vcan0, for all tests of this file."""
    directory = tmp_path_factory.mktemp("faulty")
    fresh_vcan0()
    log = directory / "candump.log"
    with candump(log, f"any,{FOREIGN:X}~7FF"), VcanRobot("moby", directory, PORT) as robot:
        yield Faulty(robot, log, [])


def idle(state: StateMessage) -> bool:
    """Well again, and waiting."""
    return state.status.mode is Mode.IDLE and not state.status.faults


@pytest.mark.parametrize("fault", BUS_FAULTS, ids=[fault.name for fault in BUS_FAULTS])
def test_a_broken_bus_stops_the_robot_until_it_is_asked_again(faulty: Faulty, fault: BusFault) -> None:
    robot = faulty.robot
    robot.drive()
    faulty.events()
    shell(fault.breaks)
    try:
        robot.stream(GO, in_mode(Mode.FAULT))
        robot.stream(GO, lambda state: any(fault.reason in text for text in state.status.faults))
        before = robot.await_truth_at_rest(GO)
    finally:
        mended_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        shell(fault.mends)
    robot.stream(GO, idle)
    after = robot.await_truth_at_rest(GO)
    assert abs(after.x - before.x) < 0.01
    assert set(faulty.setpoints_since(mended_ns)) == {0.0}
    events = faulty.await_events({"bus_down", "bus_up", "mode_fault", "mode_idle"})
    assert fault.reason in events["bus_down"]
    assert "mode_starting" not in events
    robot.drive()


def test_an_error_passive_controller_is_told_and_driven_on(faulty: Faulty) -> None:
    faulty.robot.drive()
    faulty.events()
    for state, code in (("30", "bus_error_passive"), ("40", "bus_error_active")):
        shell(f"cansend vcan0 20000004#00{state}000000000000")
        faulty.await_events({code})
    faulty.robot.drive()


def test_killed_motors_stop_the_service_and_restarted_ones_do_not_start_it(faulty: Faulty) -> None:
    robot = faulty.robot
    robot.drive()
    faulty.events()
    robot.kill_motors()
    state = robot.stream(GO, lambda state: "silent for" in (state.status.reason or ""))
    assert state.status.mode is Mode.FAULT
    assert all(motor.state == "silent" for motor in state.status.motors)
    started_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
    robot.start_motors()
    robot.stream(GO, idle, timeout=60.0)
    assert set(faulty.setpoints_since(started_ns)) == {0.0}
    assert "mode_starting" not in faulty.events()
    robot.drive()


def test_foreign_traffic_at_full_load_is_kept_away_by_the_kernel(faulty: Faulty) -> None:
    robot = faulty.robot
    robot.drive()
    before, began = received_packets(), time.monotonic()
    with subprocess.Popen(["cangen", "vcan0", "-g", "0", "-I", f"{FOREIGN:X}", "-i"]) as cangen:
        try:
            state = robot.stream(GO, lambda _: time.monotonic() > began + 2.0)
            rate = (received_packets() - before) / (time.monotonic() - began)
        finally:
            cangen.terminate()
    assert rate > FOREIGN_PER_S
    assert state.status.mode is Mode.DRIVE or state.status.reason  # the one CPU here is shared with the babbler
    robot.drive()


def received_packets() -> int:
    return int(Path("/sys/class/net/vcan0/statistics/rx_packets").read_text(encoding="ascii"))


def test_of_two_commanders_the_higher_priority_drives(faulty: Faulty) -> None:
    robot = faulty.robot
    back = (-0.2, 0.0, 0.0)
    robot.drive()
    robot.client.send_twist(*ZERO, source="autonomy")

    def outranked(state: StateMessage) -> bool:
        robot.client.send_twist(*back, source="autonomy")
        assert state.status.twist is None or state.status.twist.vx > -0.02
        return {source.name: source.reason for source in state.status.sources}["autonomy"] == "outranked by teleop"

    assert robot.stream(GO, outranked).status.winner == "teleop"
    robot.stream(GO, at_speed(GO))
    state = robot.drive(back, source="autonomy")
    assert state.status.winner == "autonomy"


def test_a_second_service_for_the_same_motors_refuses_before_it_sends(faulty: Faulty, tmp_path: Path) -> None:
    robot = faulty.robot
    log, file = tmp_path / "log", tmp_path / "other.toml"
    file.write_text(f"{robot.file.read_text(encoding='utf-8')}\n[recording]\nenabled = false\n", encoding="utf-8")
    other = drivegate("run", str(file), "--endpoint", f"tcp/127.0.0.1:{PORT + 9}", log=log)
    try:
        assert other.wait(60.0) == 69
    finally:
        with suppress(ProcessLookupError):
            other.kill()
    assert f"vcan0: process {robot.service.pid} already commands CAN id" in log.read_text(encoding="utf-8")


def test_the_session_tells_it_all_and_verifies(faulty: Faulty) -> None:
    robot = faulty.robot
    faulty.events()
    session = robot.finish()
    told: set[str] = set()
    foreign = 0
    for inputs, outputs in session.cycles():
        told.update(event.code for event in outputs.events)
        foreign += sum(frame.id == FOREIGN for frame in inputs.frames)
    assert set(faulty.told) <= told
    assert foreign == 0
    verdict = verify(session)
    assert verdict.identical, verdict
