"""The offset-differential robot as a point and a heading: wheels that do what they are told, nothing that has mass.

The platform keeps its heading at zero, so its frame is the floor's, and the joint angle minus the chassis' heading.
"""

from collections.abc import Callable
from math import atan2, cos, exp, hypot, pi, remainder, sin, tau
from typing import NamedTuple

from gateway.control.compensation import Compensation, RegionAt
from gateway.control.pull_region import Region

RIGHT_ANGLE = (RegionAt(0.0, pi / 2.0),)  # the largest region of k = 2 (science 1.4)
UNBOUNDED = 1e9  # m/s^2 across the motion: the paper's correction is not limited


class Velocity(NamedTuple):
    """Wanted over the floor, m/s; `path_rate`: rad/s by which its direction is to turn; `hit`: added behind it all."""

    vx: float
    vy: float
    path_rate: float = 0.0
    hit: float = 0.0  # m/s along y


class Step(NamedTuple):
    """At the start of a cycle, s, m, rad; `error`: of gamma from its goal before it is corrected, None at rest."""

    t: float
    x: float
    y: float
    heading: float
    vx: float
    vy: float
    error: float | None
    region: Region | None


class IdealRobot:
    """A velocity is held for a cycle, and the chassis follows it exactly (closed form of Eq. 20, science 1.3)."""

    def __init__(self, axle_offset: float, heading: float) -> None:
        self.axle_offset = axle_offset
        self.heading = heading
        self.x = self.y = 0.0

    def move(self, vx: float, vy: float, dt: float) -> None:
        """tan(gamma/2) falls e-fold every d1 of way; the chassis turns by what gamma loses."""
        self.x, self.y = self.x + vx * dt, self.y + vy * dt
        way = hypot(vx, vy) * dt
        if way == 0.0:
            return
        gamma = remainder(atan2(vy, vx) - self.heading, tau)
        after = 2.0 * atan2(sin(gamma / 2.0) * exp(-way / self.axle_offset), cos(gamma / 2.0))
        self.heading += gamma - after


def compensation(gain: float, axle_offset: float) -> Compensation:
    """The service's own, with the largest region and nothing to bound how fast it acts."""
    return Compensation(gain=gain, regions=RIGHT_ANGLE, axle_offset=axle_offset, authority=UNBOUNDED)


def drive(
    wanted: Callable[[float], Velocity],
    *,
    seconds: float,
    period: float,
    axle_offset: float,
    heading: float,
    gain: Callable[[float], float],
) -> list[Step]:
    """Every cycle of such a drive. `wanted`, `gain`: velocity and k at a time, s."""
    robot, correct, steps = IdealRobot(axle_offset, heading), compensation(0.0, axle_offset), list[Step]()
    for cycle in range(round(seconds / period) + 1):
        t = cycle * period
        correct.gain = gain(t)
        vx, vy, rate, hit = wanted(t)
        vx, vy, pull = correct.turn(vx, vy, joint=-robot.heading, path_rate=rate, dt=period)
        error, region = (None, None) if pull is None else (pull.error, pull.region)
        steps.append(Step(t, robot.x, robot.y, robot.heading, vx, vy + hit, error, region))
        robot.move(vx, vy + hit, period)
    return steps
