"""A healthy robot follows: after hard changes of command within its limits no detector and no lag gets in the way.

In closed loop with the simulated robot. What is followed is the setpoint, which the limits move towards the command.
"""

from collections import deque
from math import hypot

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from gateway.types import Mode, Outputs, Twist
from tests.world import NAMES, World

VELOCITY = {"moby": Twist(1.2, 1.2, 1.0), "omni4": Twist(2.0, 1.5, 4.0)}
TOP_SPEEDS = {"moby": (22.0, 22.0, 7.0), "omni4": (45.0, 45.0, 45.0, 45.0)}
# All of top speed. In 85 random drives of 8 to 14 changes wheels were off by at most 2.7 % (moby) and 2.0 % (omni4).
OFF_WHEEL = 0.05  # of a measured wheel from its setpoint on the way; from there on the core holds the setpoint back
# Of the true body from the setpoint on the way; seen were 1.1, 1.0, 7.9 % (moby) and 1.7, 5.7, 1.5 % (omni4). Wheels
# that lag by 2 % are much of an axis that asks little of them: moby turns its platform with a joint that runs at up to
# 7 rad/s to make up for the chassis beneath it, of which 1 rad/s is the top speed of a turn; the rollers of omni4 give
# 1.5 m/s sideways for 10 of 45 rad/s.
OFF_BODY = {"moby": (0.05, 0.05, 0.15), "omni4": (0.05, 0.10, 0.05)}
SETTLED = 0.02  # of body and wheels, once nothing moves any more but the robot
STANDS = 125  # cycles: half a second ...
MOVES = 0.005  # ... in which no wheel is told to turn differently by more; the chassis of moby swings on for long
LONGEST_S = 10.0

share = st.one_of(st.sampled_from([0.0, 1.0, -1.0]), st.floats(-1.0, 1.0))
courses = st.lists(st.tuples(st.tuples(share, share, share), st.floats(0.1, 1.2)), min_size=2, max_size=5)


def off(actual: tuple[float, ...], wanted: tuple[float, ...], top: tuple[float, ...]) -> list[float]:
    return [abs(a - w) / limit for a, w, limit in zip(actual, wanted, top, strict=True)]


def wheels_off(name: str, outputs: Outputs) -> list[float]:
    trace = outputs.trace
    told = tuple(speed or 0.0 for speed in trace.wheel_setpoints)
    return off(tuple(speed or 0.0 for speed in trace.wheel_speeds), told, TOP_SPEEDS[name])


class Follower:
    """Drives a course and remembers how far off anything was."""

    def __init__(self, name: str) -> None:
        self.world = World(name)
        self.world.start()
        self._name = name
        self.wheels = [0.0] * len(TOP_SPEEDS[name])
        self.body = [0.0] * 3
        self.limits: set[str] = set()  # that were at work
        self._told: deque[tuple[float, ...]] = deque(maxlen=STANDS)

    def drive(self, seconds: float, twist: Twist) -> None:
        self.world.run(seconds, twist, until=self._look)

    def settle(self, twist: Twist) -> bool:
        """Until wheels have been told the same for a while; whether that comes to pass."""
        self._told.clear()
        self.world.run(LONGEST_S, twist, until=lambda outputs: self._look(outputs) or self._stands())
        return self._stands()

    def _stands(self) -> bool:
        wheels = zip(*self._told, strict=True)
        moved = [max(told) - min(told) for told in wheels]
        top = TOP_SPEEDS[self._name]
        return len(self._told) == STANDS and all(way <= MOVES * limit for way, limit in zip(moved, top, strict=True))

    def _look(self, outputs: Outputs) -> bool:
        setpoint = outputs.trace.setpoint
        self._told.append(tuple(speed or 0.0 for speed in outputs.trace.wheel_setpoints))
        self.wheels = list(map(max, self.wheels, wheels_off(self._name, outputs)))
        truth = self.world.bus.robot.truth.twist
        self.body = list(map(max, self.body, off(truth, setpoint, VELOCITY[self._name])))
        if outputs.status is not None:
            self.limits.update(outputs.status.limits_active)
        return False


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@example(course=[((1.0, 1.0, 1.0), 1.2), ((-1.0, -1.0, -1.0), 1.0), ((0.0, 1.0, -1.0), 0.5), ((1.0, 0.0, 0.0), 0.2)])
@given(course=courses)
def test_a_healthy_robot_follows_hard_changes(
    name: str, course: list[tuple[tuple[float, float, float], float]]
) -> None:
    follower = Follower(name)
    top = VELOCITY[name]
    for shares, seconds in course:
        twist = Twist(*(part * limit for part, limit in zip(shares, top, strict=True)))
        follower.drive(seconds, twist)
    stands = follower.settle(twist)
    world = follower.world
    assert world.is_in(Mode.DRIVE)
    assert [code for code in world.codes() if code.startswith("fault")] == []
    assert "torque" not in follower.limits, "its limits ask no more than its motors have"
    assert max(follower.wheels) <= OFF_WHEEL
    assert all(found <= bound for found, bound in zip(follower.body, OFF_BODY[name], strict=True)), follower.body
    setpoint = world.last.trace.setpoint
    if stands:
        assert max(off(world.bus.robot.truth.twist, setpoint, top)) <= SETTLED
        assert max(wheels_off(name, world.last)) <= SETTLED
    else:  # at v the chassis, its axle 0.25 m behind the joint, turns at no more than v/0.25 m: it circles for ever
        assert name == "moby"
        assert hypot(setpoint.vx, setpoint.vy) < 2.0 * 0.25 * abs(setpoint.wz)
