"""The look at a launch, alone: when it begins, how long it takes, and what keeps it from looking."""

from collections.abc import Iterator

import pytest

from gateway.chassis.omni import OmniRobot
from gateway.config import parse
from gateway.control.drive_law import Measured
from gateway.control.grip import Grip
from gateway.control.launch_slip import LATE, LOOK_TIME, PAUSE, LaunchSlip, Losses, Told
from tests.world import robot_text

MASS, RADIUS, DT, FRICTION, RATE = 25.0, 0.0762, 0.004, 0.5, 4.0


class Launching:
    """Wheels that turn as told, forward at RATE, and tell `share` of the torque that they were to push with."""

    def __init__(self, *, led: bool = True) -> None:
        robot = parse(robot_text("omni4"), "omni4").robot
        assert isinstance(robot, OmniRobot)
        kinematics = robot.kinematics()
        self.grip = Grip(
            kinematics.rim_matrix, [(one.x, one.y) for one in robot.wheel], mass=MASS, inertia=0.9, height=0.0
        )
        self.slip = LaunchSlip(
            self.grip,
            radii=[RADIUS] * 4,
            losses=Losses(0.0, 0.0, 0.0),
            top_speeds=[45.0] * 4,
            led=[led] * 4,
            period=DT,
        )
        self._along = [row[0] / RADIUS for row in self.grip.rows]  # rad/s per m/s
        forces = self.grip.shared((RATE, 0.0, 0.0), FRICTION).forces
        self.meant = tuple([RADIUS * force for force in forces])
        self.bears = tuple([FRICTION * RADIUS * rest for rest in self.grip.resting])
        self.speed = 0.5

    def cycle(
        self, share: float = 0.1, *, dt: float = DT, gains: bool = True, ahead: float = 0.0, silent: int | None = None
    ) -> float | None:
        """One, after which it has looked or not: what the floor gave. `ahead`: rad/s; `silent`: tells no torque."""
        self.speed += RATE * dt
        rates = tuple([(1.0 if gains else -1.0) * RATE * part for part in self._along])
        told = Told(self.meant, (RATE, 0.0, 0.0), rates, self.bears, launch=True)
        expected = [part * self.speed for part in self._along]
        speeds = [due + (ahead if due > 0.0 else -ahead) for due in expected]
        torques = [None if place == silent else share * torque for place, torque in enumerate(self.meant)]
        here = Measured(0, dt, tuple(speeds), (0.0,) * 4, tuple(torques), (0,) * 4, (0.0,) * 4)
        return self.slip.look(told, expected, here._replace(torque_ages_ns=(0,) * 4), FRICTION)

    def until_found(self) -> float:
        """S until it is seen."""
        for cycle in range(1, 200):
            if self.cycle() is not None:
                return cycle * DT
        raise AssertionError("never")


def test_it_is_seen_after_one_look_and_not_again_before_the_wheels_may_grip() -> None:
    launch = Launching()
    assert launch.until_found() == pytest.approx(LOOK_TIME + DT)
    assert launch.until_found() == pytest.approx(PAUSE + LOOK_TIME + DT, abs=1.5 * DT)


def test_after_a_late_cycle_nothing_is_seen_for_a_while() -> None:
    for late, after in ((1.01 * LATE, PAUSE), (0.99 * LATE, 0.0)):
        launch = Launching()
        for _ in range(4):
            assert launch.cycle() is None
        assert launch.cycle(dt=late * DT) is None
        seen = launch.until_found()
        if after:
            assert seen == pytest.approx(after + LOOK_TIME + DT, abs=1.5 * DT)
        else:
            assert seen < LOOK_TIME


def test_wheels_that_no_longer_gain_at_the_end_of_a_look_are_not_judged() -> None:
    for last in (True, False):
        launch = Launching()
        found = [launch.cycle(gains=cycle < 9 or last) for cycle in range(11)]
        assert (found[-1] is not None) is last


def test_wheels_that_push_as_they_were_to_do_not_slip() -> None:
    launch = Launching()
    assert [launch.cycle(share) for share in _shares() for _ in range(12)] == [None] * 48


def _shares() -> Iterator[float]:
    yield from (1.0, 0.9, 1.1, 1.0)


def test_the_floor_is_never_taken_to_give_more_than_before() -> None:
    """One wheel tells no torque and runs ahead; what the others tell is more than any floor of this friction gives."""
    launch = Launching()
    found = [launch.cycle(5.0, ahead=2.0, silent=0) for _ in range(11)]
    assert found[-1] == FRICTION


def test_what_the_floor_gave_is_what_came_to_it() -> None:
    launch = Launching()
    found = [launch.cycle(0.4) for _ in range(11)]
    part = max(abs(torque) / bears for torque, bears in zip(launch.meant, launch.bears, strict=True))
    assert found[-1] == pytest.approx(0.4 * part * FRICTION, rel=1e-6)
