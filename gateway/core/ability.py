"""What a robot can still do without some of its motors, and whether its owner lets it.

How this works
--------------
With all motors, or with enough of the others to reach every direction, nothing changes but how hard it may accelerate,
and brake: by what is left in the worst direction, and along the way that is to be braked.
Where directions are lost the robot file decides, by what was lost: `stop` (a fault) or `limp`: what is commanded is
replaced by the nearest motion that is left (`gateway.kinematics.reachable`), at a share of top speed. A robot that no
longer sees how it moves, or whose geometry depends on an angle it does not know, cannot limp.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.arithmetic import dot
from gateway.config import RobotConfig
from gateway.control.drive_law import Measured
from gateway.control.limits import excess, scale_to
from gateway.core.assembly import Robot
from gateway.core.health import Health
from gateway.kinematics.contract import desaturate
from gateway.kinematics.forces import PushTable
from gateway.kinematics.linear import Matrix, Vector
from gateway.kinematics.reachable import JointUse, Reachable, effort, effort_along, reachable
from gateway.types import PLANAR, AbilityStatus, Rates, Twist

LIMP: Final = "limp"
LEAST_BRAKING: Final = 0.35  # of the acceleration limits: a stop takes at most three times as long
_HELD: Final = "held"


class Ability(NamedTuple):
    """`reach` None: every direction. `effort`: share of the acceleration, `speed`: of top speed, that may be used.

    `rows`: of the wheels where they are now, rad/s per unit of each axis.
    """

    reach: Reachable | None
    effort: float
    speed: float
    rows: Matrix = ()

    def target(self, wanted: Rates, velocity: Rates) -> Rates:
        """The nearest to what is wanted that can be driven, within this ability's share of the velocity limits."""
        if self.reach is None:
            return wanted
        return scale_to(self.reach.nearest(wanted), tuple([axis * self.speed for axis in velocity]))


FULL: Final = Ability(None, 1.0, 1.0)
NOTHING_LEFT: Final = AbilityStatus(0, 0.0, 0.0, (), ())


class Abilities:
    """Judges what is left, each cycle. Keeps nothing: the same motors and angles are the same ability."""

    def __init__(self, config: RobotConfig, robot: Robot) -> None:
        motors = config.motors_in_order()
        self._kinematics = robot.kinematics
        self._chassis = config.robot
        self._torques = tuple(limits.torque for limits in robot.limits)
        self._speeds = tuple(limits.speed for limits in robot.limits)
        self._velocity = config.limits.velocity.as_rates(robot.kinematics.axes)
        self._lost_use = tuple(JointUse.HELD if motor.when_lost == _HELD else JointUse.FREE for motor in motors)
        self._policy = config.degraded
        steered = bool(robot.kinematics.steered)
        self._pushes = None if steered else PushTable(robot.kinematics.matrix(), self._torques)

    def of(self, health: Health, measured: Measured) -> Ability | None:
        """What the usable motors can do now; None: not what the robot file calls driving."""
        usable = health.usable
        if all(usable):
            return FULL
        lost = [index for index, ok in enumerate(usable) if not ok]
        if all(self._lost_use[index] is JointUse.FREE for index in lost):
            reach = self._kinematics.reach(usable)
            if reach.complete:
                return Ability(None, reach.effort, 1.0)
        angles = self._angles(health, measured)
        if angles is None or not self._sees_its_motion(health, measured) or not self._may_limp(lost, health, measured):
            return None
        return self._limping(usable, angles)

    def braking(self, health: Health, measured: Measured, rates: Rates) -> float:
        """Share of the acceleration limits by which the motors that still obey can brake this motion, to 1.

        1 where that cannot be told, or where none of it can be braked: then the setpoint of wheels leads nobody.
        """
        if all(health.obeying):
            return 1.0
        angles = self._angles(health, measured)
        if angles is None or not any(rates):
            return 1.0
        rows, inertia = self._kinematics.matrix(angles), self._chassis.inertia(angles)
        uses = self._uses(health.obeying)
        momentum = [dot(row, rates) for row in inertia]
        share = effort_along(rows, uses, self._torques, reachable(rows, uses, inertia), momentum)
        return 1.0 if share is None else max(LEAST_BRAKING, share)

    def describe(self, ability: Ability | None, usable: Sequence[bool]) -> AbilityStatus:
        """For `state`: the furthest twists along each way that is left, the ways that are not, and how hard it pushes.

        `usable`: the motors; where what is left of them is not called driving, they push nothing.
        """
        told = self._described(ability)
        if self._pushes is None:
            return told
        pushing = usable if ability is not None else (False,) * len(usable)
        return told._replace(effective_motors=self._pushes.of(pushing))

    def _described(self, ability: Ability | None) -> AbilityStatus:
        if ability is None:
            return NOTHING_LEFT
        if ability.reach is None:
            return AbilityStatus(len(self._kinematics.axes), ability.effort, ability.speed, (), ())
        left, lost = ability.reach.basis, ability.reach.lost
        return AbilityStatus(
            rank=len(left),
            effort=ability.effort,
            speed=ability.speed,
            reachable=tuple(self._furthest(way, ability) for way in left),
            lost=tuple(self._furthest(way, ability) for way in lost),
        )

    def _limping(self, usable: Sequence[bool], angles: Sequence[float]) -> Ability | None:
        rows = self._kinematics.matrix(angles)
        uses = self._uses(usable)
        found = reachable(rows, uses, self._chassis.inertia(angles))
        share = effort(rows, uses, self._torques, found.basis)
        return Ability(found, share, self._policy.speed, rows) if share > 0.0 else None

    def _uses(self, usable: Sequence[bool]) -> list[JointUse]:
        return [JointUse.USABLE if ok else lost for ok, lost in zip(usable, self._lost_use, strict=True)]

    def _angles(self, health: Health, measured: Measured) -> list[float] | None:
        """Of all joints, where those that the geometry depends on are known; the others do not matter."""
        for index in self._kinematics.steered:
            if measured.angles[index] is None or not health.brakable[index]:
                return None
        return [0.0 if angle is None else angle for angle in measured.angles]

    def _sees_its_motion(self, health: Health, measured: Measured) -> bool:
        """Whether the wheels tell it without those that are known to tell something wrong."""
        if all(health.brakable):
            return measured.estimate is not None
        speeds = [speed if ok else None for speed, ok in zip(measured.speeds, health.brakable, strict=True)]
        return self._kinematics.twist(speeds, measured.angles) is not None

    def _may_limp(self, lost: Sequence[int], health: Health, measured: Measured) -> bool:
        """Whether the robot file lets it, for everything that was lost: a motor alone, or what tells how it turns."""
        for index in lost:
            blind = measured.speeds[index] is None or not health.brakable[index]
            if (self._policy.encoder_lost if blind else self._policy.motor_lost) != LIMP:
                return False
        return True

    def _furthest(self, way: Vector, ability: Ability) -> Twist:
        """The longest twist along this way within the limits of body and motors, its largest part positive."""
        sign = 1.0 if max(way, key=abs) > 0.0 else -1.0
        size = excess(way, self._velocity)
        twist = [part * sign * ability.speed / size for part in way]
        factor = desaturate([dot(row, twist) for row in ability.rows], self._speeds)
        return Twist(*[part * factor for part in twist[: len(PLANAR)]])
