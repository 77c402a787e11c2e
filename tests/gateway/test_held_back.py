"""What holds the setpoint back, or ahead, where the motors are: torque, a lost motor, a joint that turns."""

from itertools import pairwise
from math import cos, sin

import pytest

from gateway.types import ZERO_TWIST, Mode, Twist
from replay.drive.closed_loop import Cycle
from tests.world import World


def limits_at_work(records: list[Cycle]) -> set[str]:
    return {limit for _, outputs in records if outputs.status for limit in outputs.status.limits_active}


def furthest_behind(records: list[Cycle]) -> float:
    """By how much a wheel was slower than its setpoint at most, rad/s."""
    return max(
        abs(setpoint - speed)
        for _, outputs in records
        for setpoint, speed in zip(outputs.trace.wheel_setpoints, outputs.trace.wheel_speeds, strict=True)
        if setpoint is not None and speed is not None
    )


def test_motors_that_give_all_their_torque_hold_the_setpoint_back() -> None:
    """omni4 ten times as heavy as its file says: the setpoint waits for the wheels instead of running away."""
    world = World("omni4")
    world.bus.robot.set_mass(250.0)
    world.start()
    begin = len(world.records)
    world.run(3.0, Twist(1.5, 0.0, 0.0))
    assert furthest_behind(world.records[begin:]) < 0.03 * 45.0  # by their lag alone it would be held at 0.05 and more
    assert world.last.trace.setpoint.vx > 1.0, "it gets there all the same"
    assert world.is_in(Mode.DRIVE)


def test_an_overloaded_robot_obeys_a_command_for_less() -> None:
    """60 kg on a slope of 0.5 rad ask 282 N of wheels that have 205 N: nothing may grow, but forward has to fall."""
    world = World("omni4")
    world.start()
    world.run(2.0, Twist(1.5, 0.0, 0.0))
    world.bus.robot.set_mass(60.0)
    world.bus.robot.set_slope(0.5)
    world.run(0.5, Twist(1.5, 0.0, 0.0))
    world.run(1.5, Twist(0.2, 0.3, 0.0))
    assert world.is_in(Mode.DRIVE)
    assert "torque" in limits_at_work(world.records[-10:])
    assert world.last.trace.setpoint.vx <= 0.2


def test_a_light_robot_is_held_back_by_nothing_but_its_limits() -> None:
    world = World("omni4")
    world.start()
    begin = len(world.records)
    world.run(3.0, Twist(1.5, 0.0, 0.0))
    assert limits_at_work(world.records[begin:]) == {"acceleration"}


def test_a_lost_motor_halves_the_acceleration() -> None:
    """Limit 2 m/s^2 along x; three motors of four get half of it."""
    world = World("omni4")
    world.start()
    world.bus.robot.devices["rear_left"].power_off()
    world.run(0.3, ZERO_TWIST)
    assert world.is_in(Mode.DEGRADED)
    begin = len(world.records)
    world.run(1.0, Twist(1.5, 0.0, 0.0))
    speeds = [outputs.trace.setpoint.vx for _, outputs in world.records[begin:]]
    steepest = max(after - before for before, after in pairwise(speeds)) / 0.004
    assert steepest == pytest.approx(1.0, rel=1e-3)


def wheels_of_moby(twist: Twist, joint: float) -> tuple[float, float]:
    """Left and right, rad/s: radius 0.1 m, half the track 0.2 m, axle 0.25 m behind the joint."""
    along = twist.vx * cos(joint) - twist.vy * sin(joint)
    turning = (twist.vx * sin(joint) + twist.vy * cos(joint)) / 0.25
    return (along - 0.2 * turning) / 0.1, (along + 0.2 * turning) / 0.1


def test_wheels_are_told_what_fits_the_joint_where_it_will_be() -> None:
    """The chassis of moby swings round at up to 1.7 rad/s while it starts sideways.

    Between its measurement and the motors' answer the joint turns on: what is told fits the angle of the next cycle.
    Without that the wheels would be told up to 0.065 rad/s off.
    """
    world = World("moby")
    world.start()
    errors = []
    for _ in range(300):
        world.run(0.004, Twist(0.0, 1.0, 0.0))
        told = world.last.trace
        world.run(0.004, Twist(0.0, 1.0, 0.0))
        fitting = wheels_of_moby(told.setpoint, world.bus.robot.truth.joint_angles[2])
        errors += [abs((one or 0.0) - other) for one, other in zip(told.wheel_setpoints[:2], fitting, strict=True)]
    assert max(errors) < 0.03
