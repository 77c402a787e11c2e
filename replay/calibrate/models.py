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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import atan, atan2, cos, hypot, pi, remainder, sin, tan, tau
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

    `widest`: it is not written with a half of more than that; `hint`: what would make it narrower. `part`: numbers of
    one part are written together or not at all, as each is what it is beside the others.
    """

    name: str
    keys: tuple[tuple[tuple[str | int, ...], float], ...]
    old: float
    value: float
    half: float
    unit: str
    widest: float
    hint: str
    part: str


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
                key,
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


class _Kind(NamedTuple):
    """How a kind of wheel is written: key of its angle, and by how much that may be off and be the same.

    `numbers`: radius and angle, from rad of the wheel by a m forward and to the left; `lever`: m of it by a m of x and
    of y.
    """

    angle: str
    period: float
    numbers: Callable[[float, float], tuple[float, float]]
    lever: Callable[[float], tuple[float, float]]


_OMNI: Final = _Kind(
    "axis_angle", tau, lambda x, y: (1.0 / hypot(x, y), atan2(-x, y)), lambda angle: (cos(angle), sin(angle))
)
_MECANUM: Final = _Kind("roller_angle", pi, lambda x, y: (1.0 / x, atan(y / x)), lambda angle: (tan(angle), -1.0))


class Wheels:
    """Of n omni or mecanum wheels."""

    optional = False

    def __init__(self, robot: OmniRobot | MecanumRobot, driven: Sequence[Driven]) -> None:
        self._wheels: list[OmniWheel | MecanumPose] = [*robot.wheel]
        self._kind = _OMNI if isinstance(robot, OmniRobot) else _MECANUM
        kinematics = robot.kinematics()
        radii = np.array([wheel.radius for wheel in robot.wheel])
        self._rows = np.array(kinematics.matrix())  # of the file
        lever = float(np.max(np.abs(self._rows[:, 2] * radii)))
        self._ways, sizes = _together(driven, radii)  # (wheels, 3): rad of each, in the three ways they go together
        by = mapping(kinematics) @ self._ways
        if sizes[2] < UNDRIVEN * sizes[0]:
            axis = int(np.argmin(np.linalg.norm(by * sizes, axis=1) * [1.0, 1.0, lever]))
            raise CourseError(f"not every way to move was driven; drive also: {_AXES[axis]}")
        self.names = tuple(f"{axis} of way {way}" for axis in ("x", "y", "turn") for way in range(3))
        self.start = by.ravel()
        self.scales = np.repeat([1.0, 1.0, 1.0 / lever], 3)  # of the body, by a metre of rims

    def way(self, driven: Driven, values: Array) -> Array:
        """By nine numbers."""
        return steps(driven.angles, values.reshape(3, 3) @ np.linalg.pinv(self._ways), ())

    def numbers(self, values: Array, covariance: Array, quantile: float) -> list[Number]:
        """Three of each wheel; the place along its lever."""
        change = derivative(self._flat, values, self.scales)
        halves = quantile * np.sqrt(np.maximum(0.0, np.diag(change @ covariance @ change.T)))
        now, old = self._flat(values), self._of_rows(self._rows)
        every = zip(self._wheels, *[one.reshape(-1, 3) for one in (now, old, halves)], strict=True)
        return [number for place, one in enumerate(every) for number in self._numbers(place, *one)]

    def _numbers(self, place: int, wheel: OmniWheel | MecanumPose, now: Array, old: Array, half: Array) -> list[Number]:
        """Of one wheel."""
        key, (radius, angle, lever) = ("robot", "wheel", place), map(float, now)
        x, y = self._kind.lever(angle)
        more = (lever - x * wheel.x - y * wheel.y) / (x * x + y * y)
        moved = ("x", wheel.x, more * x), ("y", wheel.y, more * y)
        rows = (
            ("radius", (((*key, "radius"), radius),), "m", WIDEST * wheel.radius),
            (self._kind.angle, (((*key, self._kind.angle), angle),), "rad", WIDEST),
            (
                "lever",
                tuple(((*key, axis), at + by) for axis, at, by in moved if abs(by) > UNMOVED * half[2]),
                "m",
                WIDEST * max(hypot(one.x, one.y) for one in self._wheels),
            ),
        )
        return [
            Number(
                f"{wheel.motor}.{name}",
                keys,
                float(old[at]),
                float(now[at]),
                float(half[at]),
                unit,
                widest,
                _REPEAT,
                wheel.motor,
            )
            for at, (name, keys, unit, widest) in enumerate(rows)
        ]

    def told(self, values: Array, covariance: Array, quantile: float) -> list[Told]:
        """Nothing."""
        return []

    def missing(self, at: int) -> str:
        """Every way to move was driven, so more of the same."""
        return "measure x, y and turn of every course, and turns that are no whole number of turns"

    def _flat(self, values: Array) -> Array:
        return self._of_rows(self._ways @ np.linalg.inv(values.reshape(3, 3)))

    def _of_rows(self, rows: Array) -> Array:
        """Radius, angle and lever of each wheel, one behind the other; `rows`: rad per m, m and rad of the body."""
        found = []
        for wheel, (x, y, turn) in zip(self._wheels, rows.tolist(), strict=True):
            radius, angle = self._kind.numbers(x, y)
            near = float(getattr(wheel, self._kind.angle))
            found += [radius, near + remainder(angle - near, self._kind.period), turn * radius]
        return np.array(found)


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
