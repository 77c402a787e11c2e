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
from math import isinf, sqrt
from typing import Final, NamedTuple

from drivers.setpoint import CommandKind
from gateway.arithmetic import angle_of, sin_cos
from gateway.control.compensation import Compensation, PathRate, RegionAt, region_at, region_refusal
from gateway.control.drive_law import Features, Floor, JointCommand, Measured, Motion, SpeedLaw
from gateway.control.pull_region import Pull, Region, examine, flip_speeds, settled, wrapped
from gateway.control.region_policy import RegionPolicy, Seen, still
from gateway.control.wheel_acceleration import FlipLimit, pace, within
from gateway.types import ChassisState, Event, Level, Rates
from gateway.types import Region as WayRound

GAIN: Final = "compensation_gain"
REGION: Final = "compensation_region"
# Of the chassis in `state`: turn_radius in m; rad/s of the faster wheel and of the joint in the flip that would come.
FACTS: Final = ("region", "saturated", "turn_radius", "flip_wheel_speed", "flip_joint_speed")
LOST: Final = "pull_lost"  # the event
_TURNED_BACK: Final = 2.5  # rad from one cycle to the next: the motion was reversed, which is somebody's will
_CORRECTED: Final = 1.0  # gain above which an error that is corrected gets smaller
_IN_LINE: Final = (0.0, 0.0, 0.0)  # angles, of a platform that looks along its chassis
_LEFT, _RIGHT = 0, 1
_ANY: Final = WayRound.ANY


class Geometry(NamedTuple):
    """Place of the platform joint among the motors; lengths in m."""

    joint: int
    wheel_radius: float
    axle_offset: float
    track: float


class OffsetDifferentialLaw:
    """State owner: correction and the error it holds, path rate, last speeds told, last velocity driven, policy."""

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

    @property
    def features(self) -> Features:
        """Twists, and regions where the robot file lets the robot get there."""
        return self._features

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

    def aim(
        self, target: Rates, measured: Measured, *, region: WayRound, path_rate: float | None, whole: bool
    ) -> Rates:
        """All of it, or what the way round that is asked for lets it be."""
        if self._policy is None or (region is _ANY and self._policy.idle):
            return target
        return self._policy.aim(target, self._seen(measured, whole=whole), region=region, path_rate=path_rate)

    def floor(self, aim: Rates, setpoint: Rates, *, whole: bool) -> Floor:
        """It gives everything, as far as is known."""
        return self._speeds.floor(aim, setpoint, whole=whole)

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Commands for this setpoint."""
        policy = self._policy
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
        told, events = policy.told(motion.chassis), (*motion.events, *policy.news())
        return Motion(motion.commands, motion.share, limits, told, events, turned=motion.turned)

    def _motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None) -> Motion:
        vx, vy, wz = setpoint
        estimated = self._path_rate.of(vx, vy, wz, measured.dt)
        rate = estimated if path_rate is None else path_rate
        angle = self._speeds.angles_ahead(measured)[self._geometry.joint]
        vx, vy, pull = self._corrected(vx, vy, angle, rate, measured.dt)
        events = self._lost(pull, vx, vy)
        share = self._flip_share(vx, vy, angle, pull)
        wanted = (vx * share, vy * share, wz * share)
        motion = self._paced(self._speeds.motion(wanted, measured, braking=braking), measured.dt)
        limits = ("flip", *motion.limits) if share < 1.0 else motion.limits
        state = self._state(pull, share * sqrt(vx * vx + vy * vy))
        return Motion(motion.commands, share * motion.share, limits, state, events)

    def stop(self, measured: Measured) -> Motion:
        """Every joint braked."""
        if self._compensation is not None:
            self._compensation.release()
        if self._policy is not None:
            self._policy.stop()
        self._told = self._held = None
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
        return Motion(motion.commands, share * motion.share, motion.limits, self._state(None, 0.0), turned=turned)

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
            return self._compensation.turn(vx, vy, joint=angle, path_rate=rate, dt=dt)
        if angle is None:
            return vx, vy, None
        return vx, vy, examine(vx, vy, angle=angle, path_rate=rate, axle_offset=self._geometry.axle_offset)

    def _flip_share(self, vx: float, vy: float, angle: float | None, pull: Pull | None) -> float:
        """Of the speed at which the wheels can follow the flip that is coming; 1 where one is being held off."""
        if self._flip is None or angle is None or pull is None or self._holds(pull, vx, vy):
            return 1.0
        speed = sqrt(vx * vx + vy * vy)
        allowed = self._flip.speed_towards(vx, vy, angle)
        return allowed / speed if allowed < speed else 1.0

    def _holds(self, pull: Pull, vx: float, vy: float) -> bool:
        one = self._compensation
        if one is None or not self._corrects:
            return False
        return abs(pull.error) <= region_at(one.regions, sqrt(vx * vx + vy * vy))

    def _lost(self, pull: Pull | None, vx: float, vy: float) -> tuple[Event, ...]:
        """What is told where an error has grown beyond those that are corrected; not where the motion turned back."""
        before = self._held
        self._held = pull.error if pull is not None and self._holds(pull, vx, vy) else None
        if before is None or self._held is not None or pull is None or not self._corrects:
            return ()
        if abs(wrapped(pull.error - before)) > _TURNED_BACK:
            return ()
        off = f"the chassis is {abs(pull.error):.2f} rad off being pulled"
        return (Event(Level.WARNING, LOST, f"{off}, more than is corrected: it flips"),)

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

    def _state(self, pull: Pull | None, speed: float) -> ChassisState:
        """What is told of it; at rest and at an unknown angle there is nothing to tell but the correction."""
        self._region = settled(self._region, pull)
        turned = 0.0 if self._compensation is None else self._compensation.angle
        if pull is None or self._region is None:
            return ChassisState(dict.fromkeys(FACTS), (None, None, None, turned, None, None))
        told = (self._region.value, pull.saturated, _finite(pull.turn_radius), *self._of_flip(pull, speed))
        return ChassisState(
            dict(zip(FACTS, told, strict=True)),
            (pull.gamma, pull.goal, pull.error, turned, pull.flip_way, pull.flip_time),
        )

    def _of_flip(self, pull: Pull, speed: float) -> tuple[float | None, float | None]:
        if pull.flip_way is None:
            return None, None
        _, radius, offset, track = self._geometry
        return flip_speeds(speed, wheel_radius=radius, axle_offset=offset, track=track)


def _features(own: Features, policy: RegionPolicy | None, compensation: Compensation | None) -> Features:
    """With the regions that a manoeuvre leads to; what is not corrected does not stay pulled."""
    if policy is None:
        return own._replace(more_regions=": [robot.manoeuvre] in the robot file allows others")
    if compensation is None:
        regions = frozenset({WayRound.ANY, WayRound.PUSH})
        return own._replace(regions=regions, more_regions=": [robot.compensation] in the robot file allows 'pull'")
    return own._replace(regions=frozenset(WayRound))


def _finite(number: float | None) -> float | None:
    return None if number is None or isinf(number) else number
