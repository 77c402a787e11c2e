"""What a measured course can tell of a chassis: the numbers that are sought, and where in a robot file they are.

How this works
--------------
An offset-differential robot has one radius for both wheels in its file, so a common one is sought; by how much the
right wheel is larger than the left, and how far the platform's joint is off its zero, is sought beside it, as both
would otherwise pass for something else, but no key of the file says them. Its axle offset shows in the end of a course
only as far as the chassis stands another way there than at the start: the middle is the axle's plus the offset along
the chassis.

Of an omni or mecanum wheel three numbers make its speed, one for each axis of the body: radius, angle, and the lever by
which it feels the body turn. Each wheel has its own in the file, and each shows. Only the lever of its place does, so x
and y are moved along that lever alone. Wheels that do not slip turn together in three ways, however many there are
(singular values of how they turned). What these ways are in metres and radians of the body, nine numbers, is what ends
tell, linearly; the rows of all wheels follow from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import atan, atan2, cos, hypot, remainder, sin, tan, tau
from typing import Final, NamedTuple, Protocol

import numpy as np

from gateway.chassis.mecanum import MecanumPose, MecanumRobot
from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.chassis.omni import OmniRobot, OmniWheel
from gateway.setup.courses import CourseError
from replay.calibrate.fitting import derivative
from replay.calibrate.ways import Array, Driven, mapping, steps

WIDEST: Final = 0.05  # half the interval, of a length; of an angle, rad
SLIP: Final = 0.01  # of the ways of wheels, that no motion of a rigid body explains
PIECE: Final = 50  # steps that are looked at together for that
UNMOVED: Final = 0.01  # of the interval, by which a place has to move to be written anew
UNDRIVEN: Final = 0.02  # of the ways of wheels, below which a way to move was not driven
_AXES: Final = ("forward or back", "to the side", "a turn that is no whole number of turns, both ways")


class Number(NamedTuple):
    """One number of a robot file that was found: its `keys` and what they become; `half`: of the interval.

    `widest`: it is not written with a half of more than that; `hint`: what would make it narrower.
    """

    name: str
    keys: tuple[tuple[tuple[str | int, ...], float], ...]
    old: float
    value: float
    half: float
    unit: str
    widest: float
    hint: str


class Told(NamedTuple):
    """One that is sought beside them, and has no key."""

    name: str
    value: float
    half: float
    unit: str


class Model(Protocol):
    """Numbers that are sought. `optional`: places that are held where a course does not tell them."""

    names: tuple[str, ...]
    start: Array
    scales: Array
    optional: bool

    def way(self, driven: Driven, values: Array) -> Array:
        """Displacements of the body (3, n)."""
        ...

    def numbers(self, values: Array, covariance: Array, quantile: float) -> list[Number]:
        """What goes into the robot file; no covariance (zeros) for what is held."""
        ...

    def told(self, values: Array, covariance: Array, quantile: float) -> list[Told]:
        """What does not."""
        ...

    def missing(self, at: int) -> str:
        """What would have to be driven to tell the number at this place."""
        ...


RADIUS, OFFSET, TRACK, RATIO, ZERO = range(5)
_KEYS: Final = ("wheel_radius", "axle_offset", "track")
_REPEAT: Final = "repeat the courses, or drive longer ones"
_SHOWN_BY: Final = {
    "wheel_radius": "a straight line of some metres shows it",
    "axle_offset": "only courses that end with the chassis turned another way than at their start show it (one line "
    "sideways)",
    "track": "only courses that turn the chassis show it (squares both ways)",
    "wheel_ratio": "squares both ways, or straight lines whose turn is measured, show it",
    "joint_zero": "straight lines whose end is measured in y show it",
}


@dataclass
class OffsetDifferential:
    """Common radius, offset, track; ratio of the wheels, and zero of the joint."""

    robot: OffsetDifferentialRobot
    names: tuple[str, ...] = (*_KEYS, "wheel_ratio", "joint_zero")
    optional: bool = True
    start: Array = field(init=False)
    scales: Array = field(init=False)

    def __post_init__(self) -> None:
        lengths = [self.robot.wheel_radius, self.robot.axle_offset, self.robot.track]
        self.start = np.array([*lengths, 1.0, 0.0])
        self.scales = np.array([*lengths, 1.0, 1.0])

    def way(self, driven: Driven, values: Array) -> Array:
        """By the robot's own kinematics, of wheels made alike."""
        lengths = dict(zip(_KEYS, map(float, values[:RATIO]), strict=True))
        kinematics = self.robot.model_copy(update=lengths).kinematics()
        by_joint = mapping(kinematics) * np.array([2.0, 2.0 * values[RATIO], 1.0 + values[RATIO]])
        angles = driven.angles.copy()
        angles[2] += values[ZERO]
        return steps(angles, by_joint / (1.0 + values[RATIO]), kinematics.steered)

    def numbers(self, values: Array, covariance: Array, quantile: float) -> list[Number]:
        """The three lengths."""
        halves = quantile * np.sqrt(np.diag(covariance))
        return [
            Number(
                key,
                ((("robot", key), float(values[at])),),
                float(self.start[at]),
                float(values[at]),
                float(halves[at]),
                "m",
                WIDEST * float(self.start[at]),
                _SHOWN_BY[key],
            )
            for at, key in enumerate(_KEYS)
            if halves[at] > 0.0
        ]

    def told(self, values: Array, covariance: Array, quantile: float) -> list[Told]:
        """Ratio and zero."""
        halves = quantile * np.sqrt(np.diag(covariance))
        units = {RATIO: "right to left wheel", ZERO: "rad"}
        return [
            Told(self.names[at], float(values[at]), float(halves[at]), units[at])
            for at in (RATIO, ZERO)
            if halves[at] > 0.0
        ]

    def missing(self, at: int) -> str:
        """As the head of this file has it."""
        return _SHOWN_BY[self.names[at]]


class _WheelNumbers(NamedTuple):
    """What three numbers of a wheel's row are."""

    radius: float
    angle: float
    lever: float


class _Places(NamedTuple):
    """How a kind of wheel is written: key of its angle, its numbers from a row, and the direction of its lever."""

    angle: str

    def numbers(self, row: Array, near: float) -> _WheelNumbers:
        """`row`: rad per m, m and rad of the body; `near`: the angle that it should be near."""
        x, y, turn = map(float, row)
        if self.angle == "axis_angle":
            radius = 1.0 / hypot(x, y)
            angle = atan2(-x, y)
        else:
            radius = 1.0 / x
            angle = atan(y / x)
        half = tau / 2.0 if self.angle == "roller_angle" else tau  # an axis is the same the other way round
        return _WheelNumbers(radius, near + remainder(angle - near, half), turn * radius)

    def lever(self, angle: float) -> tuple[float, float]:
        """M of lever by a m of x and of y."""
        return (cos(angle), sin(angle)) if self.angle == "axis_angle" else (tan(angle), -1.0)


class Wheels:
    """Of n omni or mecanum wheels."""

    optional = False

    def __init__(self, robot: OmniRobot | MecanumRobot, driven: Sequence[Driven]) -> None:
        self._wheels: list[OmniWheel | MecanumPose] = [*robot.wheel]
        self._kind = _Places("axis_angle" if isinstance(robot, OmniRobot) else "roller_angle")
        self._rows = np.array(robot.kinematics().matrix())
        radii = np.array([wheel.radius for wheel in robot.wheel])
        self._ways, sizes = _together(driven, radii)  # (wheels, 3): rad of each, in the three ways they go together
        by = mapping(robot.kinematics()) @ self._ways
        if sizes[2] < UNDRIVEN * sizes[0]:
            driven_by = np.linalg.norm(by * sizes, axis=1) * [1.0, 1.0, np.max(np.abs(self._rows[:, 2] * radii))]
            raise CourseError(f"not every way to move was driven; drive also: {_AXES[int(np.argmin(driven_by))]}")
        self.names = tuple(f"{axis} of way {way}" for axis in ("x", "y", "turn") for way in range(3))
        self.start = by.ravel()
        lever = float(np.max(np.abs(self._rows[:, 2] * radii)))
        self.scales = np.repeat([1.0, 1.0, 1.0 / lever], 3)  # of the body, by a metre of rims

    def way(self, driven: Driven, values: Array) -> Array:
        """By nine numbers."""
        return steps(driven.angles, values.reshape(3, 3) @ np.linalg.pinv(self._ways), ())

    def numbers(self, values: Array, covariance: Array, quantile: float) -> list[Number]:
        """Three of each wheel; the place along its lever."""
        flat = self._flat(values)
        change = derivative(self._flat, values, self.scales)
        halves = quantile * np.sqrt(np.maximum(0.0, np.diag(change @ covariance @ change.T)))
        found = []
        for place, wheel in enumerate(self._wheels):
            radius, angle, lever = map(float, flat[3 * place : 3 * place + 3])
            half = [float(one) for one in halves[3 * place : 3 * place + 3]]
            key = ("robot", "wheel", place)
            old_angle = float(getattr(wheel, self._kind.angle))
            old = self._kind.numbers(self._rows[place], old_angle)
            along, across = self._kind.lever(angle)
            more = (lever - along * wheel.x - across * wheel.y) / (along * along + across * across)
            moved = ("x", wheel.x, more * along), ("y", wheel.y, more * across)
            kept = tuple(((*key, axis), at + by) for axis, at, by in moved if abs(by) > UNMOVED * half[2])
            names = [f"{wheel.motor}.{name}" for name in ("radius", self._kind.angle, "lever")]
            found += [
                Number(*numbered, _REPEAT)
                for numbered in (
                    (
                        names[0],
                        (((*key, "radius"), radius),),
                        wheel.radius,
                        radius,
                        half[0],
                        "m",
                        WIDEST * wheel.radius,
                    ),
                    (names[1], (((*key, self._kind.angle), angle),), old_angle, angle, half[1], "rad", WIDEST),
                    (names[2], kept, old.lever, lever, half[2], "m", WIDEST * self._reach()),
                )
            ]
        return found

    def told(self, values: Array, covariance: Array, quantile: float) -> list[Told]:
        """Nothing."""
        return []

    def missing(self, at: int) -> str:
        """Every way to move was driven, so more of the same."""
        return "measure x, y and turn of every course, and turns that are no whole number of turns"

    def _reach(self) -> float:
        return max(hypot(wheel.x, wheel.y) for wheel in self._wheels)

    def _flat(self, values: Array) -> Array:
        rows = self._ways @ np.linalg.inv(values.reshape(3, 3))
        angles = [float(getattr(wheel, self._kind.angle)) for wheel in self._wheels]
        return np.array([one for row, near in zip(rows, angles, strict=True) for one in self._kind.numbers(row, near)])


def _together(driven: Sequence[Driven], radii: Array) -> tuple[Array, Array]:
    """The three ways in which the wheels turned together, and how much they did.

    Raises CourseError where they slipped.
    """
    pieces = [one.angles[:, ::PIECE] for one in driven]
    moved = np.concatenate([np.diff(piece) for piece in pieces], axis=1) * radii[:, None]
    vectors, values, _ = np.linalg.svd(moved, full_matrices=False)
    if len(values) > 3 and values[3] > SLIP * values[0]:
        share = values[3] / values[0]
        raise CourseError(
            f"wheels slipped: {share:.1%} of how they turned fits no motion of a rigid body (at most {SLIP:.0%}); "
            "drive slower, or on another floor"
        )
    return np.asarray(vectors[:, :3] / radii[:, None]), np.asarray(values[:3])


def model_of(robot: object, driven: Sequence[Driven]) -> Model:
    """Of this kind of chassis. Raises CourseError."""
    if isinstance(robot, OffsetDifferentialRobot):
        return OffsetDifferential(robot)
    if isinstance(robot, OmniRobot | MecanumRobot):
        return Wheels(robot, driven)
    raise CourseError("this kind of chassis is not calibrated by measured courses")
