"""The closed loop in virtual time: its grid of cycles, pauses, and what a restart keeps and loses."""

import pytest

from gateway.config import RobotConfig, load
from gateway.types import BusEventKind, Mode, Request, RequestKind
from replay.drive.closed_loop import FIRST_NS, ClosedLoop
from tests.world import NAMES, ROBOTS

PERIOD_NS = 4_000_000


def robot(name: str) -> RobotConfig:
    return load(ROBOTS / f"{name}.toml")[0]


def run(loop: ClosedLoop, cycles: int) -> None:
    for _ in range(cycles):
        loop.cycle()


@pytest.mark.parametrize("name", NAMES)
def test_two_loops_go_alike(name: str) -> None:
    first, second = ClosedLoop(robot(name)), ClosedLoop(robot(name))
    for _ in range(100):
        assert first.cycle() == second.cycle()


def test_cycles_lie_on_the_grid() -> None:
    loop = ClosedLoop(robot("omni4"))
    stamps = [loop.cycle()[0].now_ns for _ in range(3)]
    assert stamps == [FIRST_NS, FIRST_NS + PERIOD_NS, FIRST_NS + 2 * PERIOD_NS]
    assert loop.now_ns == stamps[-1]


def test_a_pause_leaves_cycles_out_and_counts_them() -> None:
    loop = ClosedLoop(robot("omni4"))
    run(loop, 10)
    begin_ns = loop.now_ns
    loop.pause(begin_ns + 10 * PERIOD_NS + 1)
    inputs, _ = loop.cycle()
    assert (inputs.now_ns, inputs.overruns) == (begin_ns + 11 * PERIOD_NS, 10)
    assert inputs.cycle == 10
    assert len(inputs.frames) == pytest.approx(4 * 44, abs=4), "they waited"
    loop.pause(inputs.now_ns)
    assert loop.next_ns == inputs.now_ns + PERIOD_NS, "a pause into the past changes nothing"


def test_a_restart_hears_nothing_from_before() -> None:
    loop = ClosedLoop(robot("omni4"))
    run(loop, 10)
    begin_ns = loop.now_ns
    before = loop.engine
    loop.restart(begin_ns + 50 * PERIOD_NS)
    inputs, outputs = loop.cycle()
    assert loop.engine is not before
    assert (inputs.now_ns, inputs.cycle, inputs.overruns) == (begin_ns + 50 * PERIOD_NS, 0, 0)
    assert len(inputs.frames) == 0
    assert inputs.requests == ()
    assert outputs.mode is Mode.IDLE
    assert len(loop.cycle()[0].frames) == pytest.approx(16, abs=1)


def test_a_latched_emergency_stop_outlives_the_process() -> None:
    loop = ClosedLoop(robot("moby"))
    run(loop, 10)
    loop.cycle(requests=[Request(RequestKind.ESTOP, 3, loop.next_ns)])
    for _ in range(2):  # also when the process dies before its first cycle
        loop.restart(loop.now_ns + 10 * PERIOD_NS)
    inputs, outputs = loop.cycle()
    assert inputs.requests == (Request(RequestKind.ESTOP, 0, inputs.now_ns),)
    assert outputs.mode is Mode.ESTOP
    assert loop.cycle()[0].requests == ()


def test_a_new_process_is_told_that_a_bus_is_down() -> None:
    loop = ClosedLoop(robot("omni4"))
    run(loop, 10)
    loop.bus.fail("can0")
    run(loop, 2)
    loop.restart(loop.now_ns + 10 * PERIOD_NS)
    assert [event.kind for event in loop.cycle()[0].bus_events] == [BusEventKind.DOWN]


def test_joints_stand_where_they_are_put() -> None:
    loop = ClosedLoop(robot("moby"), joint_angles={"platform": -1.5, "left": 2.0})
    loop.cycle()
    assert loop.bus.robot.truth.joint_angles == (2.0, 0.0, -1.5)
    assert loop.bus.robot.truth.chassis_angle == 1.5
