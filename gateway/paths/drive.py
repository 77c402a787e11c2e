"""A robot along a path: whether it can, how long it takes, and what to tell it next, from where it is measured."""

from collections.abc import Sequence
from math import sqrt
from typing import Final, NamedTuple

from gateway.config import ConfigError, RobotConfig
from gateway.paths import rules
from gateway.paths.follower import Follower, FollowerState, Order
from gateway.paths.path import Path

START_DISTANCE: Final = 0.25  # m, from the path's start, up to which the robot merges into it
_PERIOD: Final = 0.1  # s, between plans
_LAG: Final = 0.06  # s from an order to what the odometry tells of it; measured: 56 ms omni4, 67 to 79 ms moby
_BRISK: Final = 0.5  # share of limits.acceleration: with the jerk limited, more would leave the robot behind
_SHORTEST: Final = 0.5  # m over which a robot merges that is not pulled,
_TIME: Final = 1.0  # and at least so many seconds of way
_WIDER: Final = 1.5  # axle offsets, of radius while merging: closer to one the balance has no room


class Demands(NamedTuple):
    """What of a robot matters to a path: m, m/s and m/s^2, in whatever direction.

    `axle_offset`: None: every direction is one to it; `pulled`: it is compensated, to be pulled.
    """

    axle_offset: float | None
    pulled: bool
    top_speed: float
    acceleration: float

    def problems(self, path: Path, speed: float) -> list[str]:
        """Where the path breaks a rule of the chassis, and a speed that is none; none: it can be driven."""
        found = [] if self.axle_offset is None else rules.problems(path, self.axle_offset)
        if path.on_axle and self.axle_offset is None:
            found.append("joints = 'on_axle': must be 'tangent': this robot has no axle behind its joint")
        if not 0.0 < speed <= self.top_speed:
            found.append(f"speed = {speed:g}: must be above 0 and at most {self.top_speed:g} m/s, any way")
        return found

    def fitted(self, path: Path) -> Path:
        """The path as this robot, which can drive it, is to drive it."""
        if path.on_axle and self.axle_offset is not None:
            return rules.joined_on_axle(path, self.axle_offset)
        return path

    def start_problems(self, path: Path, x: float, y: float, chassis_heading: float | None) -> list[str]:
        """Why the robot cannot begin from where it stands; heading in rad, None: not known."""
        ahead, aside = path.beside(x, y, 0.0)
        distance, found = sqrt(ahead * ahead + aside * aside), []
        if distance > START_DISTANCE:
            begin = path.at(0.0)
            found.append(
                f"start: x {begin.x:g} m, y {begin.y:g} m is {distance:.3f} m from the robot at x {x:z.3f} m, "
                f"y {y:z.3f} m: must be within {START_DISTANCE:g} m"
            )
        if self.axle_offset is not None and self.pulled:
            found += _balance(path, chassis_heading, self.axle_offset)
        return found

    def seconds(self, path: Path, speed: float) -> float:
        """How long it takes undisturbed, s: even growth of speed, and the same to its end."""
        ramp = speed * speed / self.acceleration
        if path.length < ramp:
            return 2.0 * sqrt(path.length / self.acceleration)
        return path.length / speed + speed / self.acceleration

    def follower(self, path: Path, speed: float) -> Follower:
        """Who leads it along this path."""
        offset = self.axle_offset
        stretch = max(_SHORTEST, _TIME * speed)
        if offset is not None:
            stretch = max(stretch, rules.least_stretch(offset, speed * _PERIOD))
        return Follower(
            path,
            speed=speed,
            acceleration=self.acceleration,
            period=_PERIOD,
            stretch=stretch,
            least_radius=None if offset is None else _WIDER * offset,
        )


def demands_of(config: RobotConfig) -> Demands:
    """Of this robot."""
    velocity, acceleration, trailing = config.limits.velocity, config.limits.acceleration, config.robot.trailing()
    return Demands(
        axle_offset=None if trailing is None else trailing.axle_offset,
        pulled=trailing is not None and trailing.pulled,
        top_speed=min(velocity.vx, velocity.vy),
        acceleration=_BRISK * min(acceleration.vx, acceleration.vy),
    )


def check(problems: Sequence[str], origin: str) -> None:
    """Raises ConfigError where there are any."""
    if problems:
        raise ConfigError(origin, problems)


class PathDrive:
    """One drive along a path, and its figures. Time is an argument, s.

    What was ordered within the last _LAG is not in the odometry yet: without it the robot goes too far by as much way.
    """

    def __init__(self, follower: Follower, *, period: float) -> None:
        """`period`: s from order to order, as far as is known before the first."""
        self._follower = follower
        self._state = FollowerState()
        self._period = period
        self._last: float | None = None
        self._velocity = (0.0, 0.0)  # m/s, ordered last
        self.max_deviation = 0.0  # m, beside the path

    def step(self, now: float, x: float, y: float) -> Order:
        """What to tell the robot measured there, in the frame of the path."""
        dt = self._period if self._last is None else now - self._last
        self._last = now
        vx, vy = self._velocity
        order, self._state = self._follower.step(self._state, x + _LAG * vx, y + _LAG * vy, dt)
        self._velocity = order.vx, order.vy
        self.max_deviation = max(self.max_deviation, abs(order.deviation))
        return order


def _balance(path: Path, chassis_heading: float | None, axle_offset: float) -> list[str]:
    if chassis_heading is None:
        return ["start: how the chassis lies is not known: the joint tells no angle"]
    problem = rules.start_problem(path, chassis_heading, axle_offset)
    return [] if problem is None else [problem]
