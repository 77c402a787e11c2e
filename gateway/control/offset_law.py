"""The drive law of the offset-differential robot: pulled where that is wanted, slow enough to be followed in a flip.

How this works
--------------
setpoint of the body -> turned by the compensation -> slowed for the flip that comes, where nothing corrects it ->
speeds of the joints (`SpeedLaw`) -> shortened to what the motors can change in a cycle. The setpoint stays what the
limits made it; what is driven of it goes back as `share`.
Where a command asks for a way round (`gateway.control.region_policy`), a manoeuvre may have to come first: the setpoint
then only says how fast, and the velocity is turned all the way into the piece of the manoeuvre that is driven. That is
straight along or across the chassis, so it needs no joint angle: it is the motion of a platform that stands at zero.
"""

from collections.abc import Callable, Mapping, Sequence
from math import sqrt
from typing import Final, NamedTuple

from drivers.setpoint import CommandKind
from gateway.arithmetic import angle_of, sin_cos
from gateway.control.compensation import Compensation, PathRate, RegionAt, region_at, region_refusal
from gateway.control.drive_law import Features, JointCommand, Measured, Motion, SpeedLaw
from gateway.control.limits import Ground
from gateway.control.posture import Posture
from gateway.control.pull_region import Pull, Region, examine, flip_speeds, flip_way, settled, turn_radius, wrapped
from gateway.control.region_policy import RegionPolicy, Seen, still
from gateway.control.wheel_acceleration import FlipLimit, pace, within
from gateway.types import Event, Facts, Level, Rates
from gateway.types import Region as WayRound

GAIN: Final = "compensation_gain"
REGION: Final = "compensation_region"
# Of a chassis at rest or at an unknown angle there is nothing to tell.
NO_FACTS: Final[Facts] = {
    "region": None,
    "saturated": None,
    "turn_radius": None,  # m
    "flip_wheel_speed": None,  # rad/s of the faster wheel, and of the joint, in the flip that would come
    "flip_joint_speed": None,
}
LOST: Final = "pull_lost"  # the event
_TURNED_BACK: Final = 2.5  # rad from one cycle to the next: the motion was reversed, which is somebody's will
_CORRECTED: Final = 1.0  # gain above which an error that is corrected gets smaller
_IN_LINE: Rates = (0.0, 0.0, 0.0)  # angles, of a platform that looks along its chassis
_LEFT, _RIGHT = 0, 1
_ANY: Final = WayRound.ANY
_PUSH: Final = WayRound.PUSH


class Geometry(NamedTuple):
    """Place of the platform joint among the motors; lengths in m."""

    joint: int
    wheel_radius: float
    axle_offset: float
    track: float


class OffsetDifferentialLaw:
    """State owner: correction and the error it holds, path rate, last speeds told, last velocity driven, policy.

    And what was last seen of the chassis, for whom asks.
    """

    def __init__(
        self,
        speeds: SpeedLaw,
        *,
        geometry: Geometry,
        compensation: Compensation | None,
        flip: FlipLimit | None,
        policy: RegionPolicy | None,
        accelerations: Sequence[float] | None,
        period: float,
        longest_period: Callable[[float], float],
    ) -> None:
        """`policy`: None: no command may ask for a region. `accelerations`: rad/s^2 of each motor, None: no limit.

        `period`: s, of the loop; `longest_period`: s, with which a gain works at top speed.
        """
        self._speeds = speeds
        self._geometry = geometry
        self._compensation = compensation
        self._flip = flip
        self._policy = policy
        self._features = _features(speeds.features, policy, compensation)
        self._accelerations = None if accelerations is None else tuple(accelerations)
        self._period = period
        self._longest_period = longest_period
        self._region: Region | None = None  # as it is told
        self._path_rate = PathRate()
        self._told: tuple[float, ...] | None = None  # rad/s; None: nothing since it was let go
        self._held: float | None = None  # rad, the error that is being corrected; None: none is
        self._driven = (0.0, 0.0)  # m/s, of the setpoint, as far as it was driven
        self._pull: Pull | None = None  # of the last cycle, and m/s that its motion was slowed to
        self._speed = 0.0
        self._stopped = True  # and not driven

    @property
    def facts(self) -> Facts:
        """How the chassis lies in its motion, what a flip would ask for, and the manoeuvre; none in a stop."""
        if self._stopped:
            return {}
        pull, facts = self._pull, dict(NO_FACTS)
        if pull is not None and self._region is not None:
            facts["region"], facts["saturated"] = self._region.value, pull.saturated
            facts["turn_radius"] = turn_radius(pull.speed, pull.path_rate)
            facts["flip_wheel_speed"], facts["flip_joint_speed"] = self._of_flip(pull)
        return facts if self._policy is None else facts | self._policy.facts

    @property
    def features(self) -> Features:
        """Twists, and regions where the robot file lets the robot get there."""
        return self._features

    @property
    def posture(self) -> Posture | None:
        """It stands by itself."""
        return None

    @property
    def settings(self) -> Mapping[str, float]:
        """Gain and region of the compensation; a region that goes by speed as it is at its first speed."""
        if self._compensation is None:
            return {}
        return {GAIN: self._compensation.gain, REGION: self._compensation.regions[0].region}

    def set(self, name: str, value: float) -> str | None:
        """Another gain, or another region at every speed, where it can work."""
        one = self._compensation
        if one is None:
            return f"{name}: this robot is not compensated"
        gain = value if name == GAIN else one.gain
        regions = (RegionAt(0.0, value),) if name == REGION else one.regions
        refusal = self._objection(gain, max(point.region for point in regions))
        if refusal is None:
            one.gain, one.regions = gain, regions
        return refusal

    def _objection(self, gain: float, region: float) -> str | None:
        refusal = region_refusal(gain, region)
        if refusal is None and self._period > self._longest_period(gain):
            return f"gain {gain:g}: the loop is too slow for it at top speed"
        return refusal

    @property
    def unready(self) -> str | None:
        """Nothing."""
        return None

    def width_rate(self, width: float) -> float:
        """It knows no width."""
        return 0.0

    def aim(
        self, target: Rates, measured: Measured, *, region: WayRound, path_rate: float | None, whole: bool
    ) -> Rates:
        """All of it, or what the way round that is asked for lets it be."""
        if self._policy is None or (region is _ANY and self._policy.idle):
            return target
        return self._policy.aim(target, self._seen(measured, whole=whole), region=region, path_rate=path_rate)

    def ground(self, *, whole: bool) -> Ground | None:
        """It does not know."""
        return None

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Commands for this setpoint."""
        policy = self._policy
        self._stopped = False
        if policy is None:
            return self._motion(setpoint, measured, braking=braking, path_rate=path_rate)
        if braking and not policy.idle:
            policy.brake()
        if not policy.idle and policy.at_work:
            motion = self._manoeuvre(policy, setpoint, measured, braking=braking)
        else:
            motion = self._motion(setpoint, measured, braking=braking, path_rate=path_rate)
        self._driven = (setpoint[0] * motion.share, setpoint[1] * motion.share)
        limits = motion.limits if policy.idle else (*policy.limits, *motion.limits)
        events = (*motion.events, *policy.news())
        return Motion(motion.commands, motion.share, limits, motion.numbers, events, turned=motion.turned)

    def _motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None) -> Motion:
        vx, vy, wz = setpoint
        estimated = self._path_rate.of(vx, vy, wz, measured.dt)
        rate = estimated if path_rate is None else path_rate
        angles = self._speeds.angles_ahead(measured)
        angle = angles[self._geometry.joint]
        vx, vy, pull = self._corrected(vx, vy, angle, rate, measured.dt)
        speed = sqrt(vx * vx + vy * vy)
        holds = self._holds
        events = self._lost(pull, holds=holds)
        share = 1.0 if holds else self._flip_share(vx, vy, speed, angle, pull)
        wanted = (vx * share, vy * share, wz * share)
        motion = self._paced(self._speeds.motion_at(wanted, angles, braking=braking), measured.dt)
        limits = ("flip", *motion.limits) if share < 1.0 else motion.limits
        return Motion(motion.commands, share * motion.share, limits, self._told_of(pull, share * speed), events)

    def stop(self, measured: Measured) -> Motion:
        """Every joint braked."""
        if self._compensation is not None:
            self._compensation.release()
        if self._policy is not None:
            self._policy.stop()
        self._told = self._held = None
        self._stopped = True
        self._driven = (0.0, 0.0)
        return self._speeds.stop(measured)

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        """It stands when its wheels do."""
        return self._speeds.moves(measured, turning=turning)

    def may_release(self, measured: Measured) -> bool:
        """It stands by itself."""
        return self._speeds.may_release(measured)

    def forget_told(self) -> None:
        """No wheel is asked to go on from there."""
        self._told = None

    def _manoeuvre(self, policy: RegionPolicy, setpoint: Rates, measured: Measured, *, braking: bool) -> Motion:
        """The piece at work, as fast as the setpoint and no faster."""
        vx, vy, _ = setpoint
        speed = sqrt(vx * vx + vy * vy)
        at_rest = speed == 0.0 and not any(self._told or ())
        along, across = policy.direction
        share = policy.share(speed, self._seen(measured, whole=True), at_rest=at_rest)
        wanted = (along * share * speed, across * share * speed, 0.0)
        motion = self._paced(self._speeds.motion_at(wanted, _IN_LINE, braking=braking), measured.dt)
        turned, angle = 0.0, self._speeds.angles_ahead(measured)[self._geometry.joint]
        if angle is not None and speed > 0.0:
            s, c = sin_cos(angle)
            x, y = c * along + s * across, c * across - s * along
            turned = angle_of(vx * y - vy * x, vx * x + vy * y)
        return Motion(motion.commands, share * motion.share, motion.limits, self._told_of(None, 0.0), turned=turned)

    def _seen(self, measured: Measured, *, whole: bool) -> Seen:
        """For the policy of regions."""
        left, right = measured.positions[_LEFT], measured.positions[_RIGHT]
        one, corrected = self._compensation, (0.0, 0.0)
        if one is not None and one.gain > _CORRECTED:
            vx, vy = self._driven
            corrected = region_at(one.regions, sqrt(vx * vx + vy * vy)), min(point.region for point in one.regions)
        return Seen(
            measured.dt,
            self._speeds.angles_ahead(measured)[self._geometry.joint],
            None if left is None or right is None else 0.5 * self._geometry.wheel_radius * (left + right),
            self._driven,
            still(self._told, measured.estimate and measured.estimate.rates),
            corrected,
            whole,
        )

    def _corrected(
        self, vx: float, vy: float, angle: float | None, rate: float, dt: float
    ) -> tuple[float, float, Pull | None]:
        if self._compensation is not None:
            asked = self._asked
            return self._compensation.turn(vx, vy, joint=angle, path_rate=rate, dt=dt, asked=asked)
        if angle is None:
            return vx, vy, None
        return vx, vy, examine(vx, vy, angle=angle, path_rate=rate, axle_offset=self._geometry.axle_offset)

    def _flip_share(self, vx: float, vy: float, speed: float, angle: float | None, pull: Pull | None) -> float:
        """Of the speed at which the wheels can follow the flip that is coming."""
        if self._flip is None or angle is None or pull is None:
            return 1.0
        allowed = self._flip.speed_towards(vx, vy, angle)
        return allowed / speed if allowed < speed else 1.0

    @property
    def _holds(self) -> bool:
        """Whether a flip is being held off."""
        one = self._compensation
        return one is not None and one.holds and one.gain > _CORRECTED

    def _lost(self, pull: Pull | None, *, holds: bool) -> tuple[Event, ...]:
        """What is told where an error has grown beyond those that are corrected; not where the motion turned back."""
        before = self._held
        self._held = pull.error if holds and pull is not None else None
        if before is None or holds or pull is None or not self._corrects or self._asked is _PUSH:
            return ()
        if abs(wrapped(pull.error - before)) > _TURNED_BACK:
            return ()
        off = f"the chassis is {abs(pull.error):.2f} rad off being pulled"
        return (Event(Level.WARNING, LOST, f"{off}, more than is corrected: it flips"),)

    @property
    def _asked(self) -> WayRound:
        return _ANY if self._policy is None else self._policy.asked

    @property
    def _corrects(self) -> bool:
        return self._compensation is not None and self._compensation.gain > _CORRECTED

    def _paced(self, motion: Motion, dt: float) -> Motion:
        """The same within what each motor can change its speed by."""
        wanted = [command.value for command in motion.commands]
        before, self._told = self._told, tuple(wanted)
        if self._accelerations is None or before is None or dt <= 0.0:
            return motion
        most = [limit * dt for limit in self._accelerations]
        share, kept = pace(wanted, before, most)
        if share >= 1.0 and kept:
            return motion
        self._told = tuple(within([speed * share for speed in wanted], before, most))
        commands = tuple([JointCommand(CommandKind.VELOCITY, speed) for speed in self._told])
        return Motion(commands, motion.share * share, (*motion.limits, "motor_acceleration"))

    def _told_of(self, pull: Pull | None, speed: float) -> tuple[float | None, ...]:
        """Numbers of its channels; at rest and at an unknown angle there is nothing to tell but the correction."""
        self._pull, self._speed = pull, speed
        self._region = settled(self._region, pull)
        turned = 0.0 if self._compensation is None else self._compensation.angle
        if pull is None:
            return (None, None, None, turned, None, None)
        return (pull.gamma, pull.goal, pull.error, turned, pull.speed, pull.path_rate)

    def _of_flip(self, pull: Pull) -> tuple[float | None, float | None]:
        _, radius, offset, track = self._geometry
        way = flip_way(pull.gamma, pull.error, speed=pull.speed, path_rate=pull.path_rate, axle_offset=offset)
        if way is None:
            return None, None
        return flip_speeds(self._speed, wheel_radius=radius, axle_offset=offset, track=track)


def _features(own: Features, policy: RegionPolicy | None, compensation: Compensation | None) -> Features:
    """With the regions that a manoeuvre leads to; what is not corrected does not stay pulled."""
    if policy is None:
        return own._replace(more_regions=": [robot.manoeuvre] in the robot file allows others")
    if compensation is None:
        regions = frozenset({WayRound.ANY, WayRound.PUSH})
        return own._replace(regions=regions, more_regions=": [robot.compensation] in the robot file allows 'pull'")
    return own._replace(regions=frozenset(WayRound))
