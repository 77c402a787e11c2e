"""Two driven wheels whose axle lies d1 behind a driven platform joint, and a passive caster (MOBY, Otbot)."""

from collections.abc import Sequence
from functools import partial
from math import isfinite, sqrt
from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from gateway.arithmetic import sin_cos
from gateway.chassis.contract import (
    ALIKE,
    BODY,
    KIND,
    NAME,
    ChassisChannels,
    Drawing,
    DrawnLength,
    DrawnWheel,
    LawParts,
    LoopLimit,
    Numbers,
    Sideways,
    Trailing,
)
from gateway.control.compensation import WHOLE_CIRCLE, Compensation, RegionAt, longest_period, region_refusal
from gateway.control.decoupled import Saturation
from gateway.control.drive_law import SpeedLaw
from gateway.control.manoeuvre import Form, Limits
from gateway.control.offset_law import Geometry, OffsetDifferentialLaw
from gateway.control.pull_region import flip_way
from gateway.control.region_policy import RegionPolicy
from gateway.control.wheel_acceleration import FlipLimit
from gateway.kinematics.linear import Matrix
from gateway.kinematics.offset_differential import PLATFORM, CasterGeometry, OffsetDifferentialKinematics
from gateway.sections import Body, Length, Name, Section, Unit
from gateway.types import PLANAR, Rates

_MIRROR: Final = 2.0  # gain of the mirror image (preprints202312.1327, Eq. 23)
_AUTHORITY: Final = 12.0  # m/s^2 across the motion where the motors have no limit of their own; source: ours
_SHARE: Final = 0.5  # of what the motors can change, that correcting may use


class Caster(Section):
    """The passive caster: trail d3, joint distance d4 ahead of the pivot, wheel radius Rc."""

    trail: Annotated[Length, Field(description="of its wheel behind its pivot")]
    position: Annotated[Length, Field(description="of its pivot ahead of the platform joint")]
    radius: Annotated[Length, Field(description="of its wheel")]

    def geometry(self) -> CasterGeometry:
        """The same for the kinematics."""
        return CasterGeometry(self.trail, self.position, self.radius)


class RegionPoint(Section):
    """Largest error that is corrected at this speed."""

    speed: Annotated[float, Field(ge=0.0, le=20.0, description="from which on it is that"), Unit("m/s")]
    region: Annotated[float, Field(gt=0.0, le=WHOLE_CIRCLE, description="largest error that is corrected"), Unit("rad")]


class CompensationConfig(Section):
    """Pull-region compensation: gain k of Eqs. 22 to 25, and the region of errors, rad, that it corrects.

    k = 2 lets an error die out as it would in the push region; 1 freezes it, less lets the chassis flip.
    """

    gain: Annotated[float, Field(ge=0.0, le=4.0, description="k; 2 lets an error die out as when pushed")] = _MIRROR
    region: Annotated[
        list[RegionPoint],
        Field(min_length=1, max_length=32, description="largest error that is corrected: one angle, or by speed"),
    ]

    @model_validator(mode="before")
    @classmethod
    def _one_region(cls, given: object) -> object:
        """A number is a region at every speed."""
        region = given.get("region") if isinstance(given, dict) else None
        if isinstance(given, dict) and isinstance(region, int | float) and not isinstance(region, bool):
            return given | {"region": [{"speed": 0.0, "region": region}]}
        return given

    @model_validator(mode="after")
    def _within_what_corrects(self) -> Self:
        refusals = [region_refusal(self.gain, point.region) for point in self.region]
        problems = [refusal for refusal in refusals if refusal is not None]
        speeds = [point.speed for point in self.region]
        if speeds != sorted(set(speeds)):
            problems.append(f"region: speeds {speeds} must grow")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def points(self) -> tuple[RegionAt, ...]:
        """For the law."""
        return tuple(RegionAt(point.speed, point.region) for point in self.region)


class ManoeuvreConfig(Section):
    """How it may turn its chassis round for a command that asks for a region; without this section none may ask.

    `arc`: the joint ends beside its place, `closed`: in it. `max_footprint`: m by which it may leave it on the way.
    """

    form: Annotated[Literal["arc", "closed"], Field(description="arc: the joint ends beside its place; closed: in it")]
    max_footprint: Annotated[
        float, Field(gt=0.0, le=20.0, description="by which the joint may leave its place on the way"), Unit("m")
    ]


class OffsetDifferentialRobot(Section):
    """Two driven wheels whose axle lies `axle_offset` behind a driven platform joint (MOBY, Otbot)."""

    GEOMETRY: ClassVar[str] = "wheel_radius, axle_offset and track"
    AXES: ClassVar[tuple[str, ...]] = PLANAR
    SIDEWAYS: ClassVar[Sideways] = ALIKE
    saturation: ClassVar[Saturation] = Saturation.BOTH  # its wheels turn and drive it at once: nothing to choose

    kind: Annotated[Literal["offset_differential"], Field(description=KIND)]
    name: Annotated[Name, Field(description=NAME)]
    body: Annotated[Body, Field(description=BODY)]
    chassis_inertia: Annotated[
        float,
        Field(gt=1e-4, le=5000.0, description="of the chassis below the joint, about its own vertical"),
        Unit("kg m^2"),
    ]
    wheel_radius: Annotated[Length, Field(description="of the driven wheels")]
    axle_offset: Annotated[Length, Field(description="of the axle behind the platform joint (d1 of the paper)")]
    track: Annotated[Length, Field(description="between the driven wheels (d2)")]
    left: Annotated[Name, Field(description="motor of the left wheel")]
    right: Annotated[Name, Field(description="motor of the right wheel")]
    platform: Annotated[Name, Field(description="motor of the platform joint")]
    caster: Annotated[Caster | None, Field(description="the passive caster, for the simulated world")] = None
    compensation: Annotated[
        CompensationConfig | None, Field(description="keeps a pulled chassis pulled; without it, it flips")
    ] = None
    manoeuvre: Annotated[
        ManoeuvreConfig | None, Field(description="lets commands ask for a region; without it none may")
    ] = None

    def motor_names(self) -> tuple[str, ...]:
        """Left wheel, right wheel, platform joint."""
        return (self.left, self.right, self.platform)

    def kinematics(self) -> OffsetDifferentialKinematics:
        """From radius, offset and track; the caster is passive."""
        caster = None if self.caster is None else self.caster.geometry()
        return OffsetDifferentialKinematics(
            wheel_radius=self.wheel_radius, axle_offset=self.axle_offset, track=self.track, caster=caster
        )

    def doubts(self) -> tuple[str, ...]:
        """None: every length above its least can be meant."""
        return ()

    def trailing(self) -> Trailing:
        """By the platform joint, pulled where it is compensated."""
        return Trailing(PLATFORM, self.axle_offset, pulled=self.compensation is not None)

    def channels(self) -> tuple[ChassisChannels, ...]:
        """How the chassis lies in its motion; way and time until it flips, on a path that goes on as it is."""
        angles, flip = ("gamma", "gamma_goal", "gamma_error", "correction"), ("flip_way", "flip_time")
        return (
            ChassisChannels("angles", angles, "rad", "Chassis to motion [rad]", lambda numbers: numbers[:4]),
            ChassisChannels("", flip, "m, s", "", self._flip_ahead),
        )

    def _flip_ahead(self, numbers: Numbers) -> Numbers:
        gamma, _, error, _, speed, path_rate = numbers
        if gamma is None or error is None or speed is None or path_rate is None:
            return (None, None)
        way = flip_way(gamma, error, speed=speed, path_rate=path_rate, axle_offset=self.axle_offset)
        return (way, None if way is None else way / speed)

    def law(self, parts: LawParts) -> OffsetDifferentialLaw:
        """Pulled where the robot file asks for it, and slow enough for a flip where the motors have limits."""
        given, limits = self.compensation, parts.accelerations
        speeds = SpeedLaw(parts.kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period)
        compensation = None
        if given is not None:
            authority = _AUTHORITY if limits is None else _SHARE * self._across(limits)
            compensation = Compensation(
                gain=given.gain, regions=given.points(), axle_offset=self.axle_offset, authority=authority
            )
        return OffsetDifferentialLaw(
            speeds,
            geometry=Geometry(PLATFORM, self.wheel_radius, self.axle_offset, self.track),
            compensation=compensation,
            flip=None if limits is None else self._flip_limit(limits, parts.acceleration),
            policy=None if self.manoeuvre is None else self._policy(self.manoeuvre, parts),
            accelerations=limits,
            period=parts.period,
            longest_period=partial(
                longest_period, axle_offset=self.axle_offset, speed=max(parts.velocity[:2]), delay=parts.delay
            ),
        )

    def _policy(self, given: ManoeuvreConfig, parts: LawParts) -> RegionPolicy:
        """How fast the joint can go straight along and across the chassis, each wheel and the joint doing its part."""
        ahead = 1.0 / self.wheel_radius
        wheel = max(ahead, self.track / (2.0 * self.axle_offset * self.wheel_radius))
        shares = (wheel, wheel, 1.0 / self.axle_offset)  # rad/s of each motor per m/s
        limits = Limits(
            velocity=min(parts.velocity[:2]),
            acceleration=min(parts.acceleration[:2]),
            jerk=min(parts.jerk[:2]),
            motor_speed=min(speed / share for speed, share in zip(parts.top_speeds, shares, strict=True)),
        )
        if parts.accelerations is not None:
            changes = (change / share for change, share in zip(parts.accelerations, shares, strict=True))
            limits = limits._replace(motor_acceleration=min(changes))
        return RegionPolicy(
            form=Form(given.form), max_footprint=given.max_footprint, limits=limits, axle_offset=self.axle_offset
        )

    def _across(self, accelerations: Sequence[float]) -> float:
        """m/s^2 with which the motors can turn the velocity of the joint, the chassis lying any way."""
        left, right, joint = accelerations
        lever = self.track / (2.0 * self.axle_offset)
        return min(min(left, right) * self.wheel_radius / sqrt(1.0 + lever * lever), joint * self.axle_offset)

    def _flip_limit(self, accelerations: Sequence[float], body: Rates) -> FlipLimit:
        left, right, joint = accelerations
        return FlipLimit(
            wheel_radius=self.wheel_radius,
            axle_offset=self.axle_offset,
            track=self.track,
            wheel_acceleration=min(left, right),
            joint_acceleration=joint,
            braking=min(body[0], body[1]),
        )

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """The chassis turns at (n . v)/d1 below the joint, so a motion along n also turns it: mass + I_c/d1^2."""
        mass, turning = self.body.mass, self.chassis_inertia / (self.axle_offset * self.axle_offset)
        s, c = sin_cos(angles[PLATFORM])
        mixed = turning * s * c
        return (
            (mass + turning * s * s, mixed, 0.0),
            (mixed, mass + turning * c * c, 0.0),
            (0.0, 0.0, self.body.inertia),
        )

    def masses(self) -> Rates:
        """The whole body; that of a chassis below its joint is left out."""
        return (self.body.mass, self.body.mass, self.body.inertia)

    def drawing(self) -> Drawing:
        """The axle lies behind the joint, which is the middle of the body above; both turn against each other."""
        rear, half, radius = -self.axle_offset, self.track / 2, self.wheel_radius
        front = self.caster.position if self.caster is not None else self.axle_offset
        return Drawing(
            reach=max(self.axle_offset, half),
            wheels=(DrawnWheel(rear, half, 0.0, radius), DrawnWheel(rear, -half, 0.0, radius)),
            frame=((rear, half), (front, half / 2), (front, -half / 2), (rear, -half), (rear, half)),
            beneath=PLATFORM,
            lengths=(
                DrawnLength("axle_offset", (0.0, 0.0), (rear, 0.0)),
                DrawnLength("track", (rear, half), (rear, -half)),
            ),
        )

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """h < ln(1 + 2/(k - 1)) d1 / c: beyond it sampled compensation swings; without one, told for k = 2."""
        gain = _MIRROR if self.compensation is None else self.compensation.gain
        period = longest_period(gain, axle_offset=self.axle_offset, speed=top_speed, delay=delay)
        return (LoopLimit("compensation", period, used=self.compensation is not None),) if isfinite(period) else ()
