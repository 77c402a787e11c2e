"""What every chassis says of itself: one file here, its section of the robot file and all that follows from it."""

from collections.abc import Callable, Sequence
from typing import ClassVar, Final, NamedTuple, Protocol

from gateway.arithmetic import sin_cos
from gateway.control.decoupled import Saturation
from gateway.control.drive_law import DriveLaw
from gateway.control.launch import Pusher
from gateway.kinematics.contract import Kinematics
from gateway.kinematics.linear import Matrix
from gateway.sections import Body
from gateway.types import Rates

# What the keys that every kind of chassis has are for.
KIND: Final = "of chassis; the other keys of [robot] follow from it"
NAME: Final = "of the robot: its Zenoh keys and sessions begin with it"
BODY: Final = "mass properties of the whole robot"
SATURATION: Final = "what is kept where wheels or floor cannot give all: translation, rotation, or both in proportion"

Point = tuple[float, float]
Numbers = tuple[float | None, ...]


class DrawnWheel(NamedTuple):
    """A wheel from above: where (m), the direction in which it rolls (rad), its radius (m)."""

    x: float
    y: float
    rolling: float
    radius: float

    @property
    def along(self) -> Point:
        """Unit vector of that direction."""
        sine, cosine = sin_cos(self.rolling)
        return cosine, sine


class DrawnLength(NamedTuple):
    """A key of the robot file and where on the robot its length is, from and to (m)."""

    key: str
    start: Point
    end: Point


class Drawing(NamedTuple):
    """The robot from above, x forward and y left, in m.

    `reach`: radius of the circle that stands for the body; `frame`: a closed line, empty for none. `beneath`: place of
    the joint by which the body turns on frame and wheels; None where they are one. `rollers`: whether the wheels have
    some, on which they slide. `lengths`: what of the robot file is seen.
    """

    reach: float
    wheels: tuple[DrawnWheel, ...]
    frame: tuple[Point, ...] = ()
    beneath: int | None = None
    rollers: bool = False
    lengths: tuple[DrawnLength, ...] = ()


class Sideways(NamedTuple):
    """How much more a metre sideways, or of an axis beyond the twist, errs than one forward: ratios of variances.

    `position`: of where it is, `heading`: of how it is turned, as far as the wheels tell it.
    """

    position: float = 1.0
    heading: float = 1.0


ALIKE: Final = Sideways()


class LoopLimit(NamedTuple):
    """What works only with a loop that is fast enough: its name, and the longest period, s.

    `used`: the robot file asks for it, so a slower loop is refused.
    """

    name: str
    period: float  # 0.0: none is short enough
    used: bool

    @property
    def needed(self) -> str:
        """The rate that it needs, in words."""
        if self.period > 0.0:
            return f"at least {1.0 / self.period:.1f} Hz"
        return "no rate is enough, the feedback of the motors is too old: raise feedback_rate"


class ChassisChannels(NamedTuple):
    """Numbers that only this kind of chassis has: names, unit and plot.

    Without an entity they are not plotted, only told by `replay trace` and `watch --channels`. `read`: them from the
    numbers that its law tells in each cycle; what nobody plots is better made here than in each cycle.
    """

    entity: str
    names: tuple[str, ...]
    unit: str
    plot: str
    read: Callable[[Numbers], Numbers]


class Trailing(NamedTuple):
    """A body that a trailing chassis carries: by which joint, how far (m) ahead of the axle; `pulled`: kept so."""

    joint: int  # its place
    axle_offset: float
    pulled: bool


class LawParts(NamedTuple):
    """What a drive law is made of; per-motor tuples in chassis order."""

    kinematics: Kinematics
    top_speeds: tuple[float, ...]  # rad/s at the output
    accelerations: tuple[float, ...] | None  # rad/s^2; None: no limit of their own
    velocity: Rates  # limits of the body
    acceleration: Rates
    jerk: Rates
    period: float  # s
    delay: float  # s, by which a measurement may be old
    pushers: tuple[Pusher, ...]  # what each motor can be told of a push


class Chassis(Protocol):
    """A section of the robot file with kind, name, body and geometry, frozen."""

    GEOMETRY: ClassVar[str]  # the keys of the geometry, in words
    AXES: ClassVar[tuple[str, ...]]  # of its kinematics; limits of the robot file name each of them
    SIDEWAYS: ClassVar[Sideways]  # what its odometry knows of that

    @property
    def kind(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def body(self) -> Body: ...
    @property
    def saturation(self) -> Saturation:
        """What is kept where wheels or floor cannot give all."""
        ...

    def motor_names(self) -> tuple[str, ...]:
        """Motors of the chassis; the order of every per-motor sequence in the core."""
        ...

    def kinematics(self) -> Kinematics:
        """Its geometry. Raises GeometryError for one that cannot be driven."""
        ...

    def doubts(self) -> tuple[str, ...]:
        """What of its geometry can be driven but is most likely not meant so, in words; of one that can be driven."""
        ...

    def trailing(self) -> Trailing | None:
        """How its chassis trails, which paths have to respect; None: every direction is one to it."""
        ...

    def channels(self) -> tuple[ChassisChannels, ...]:
        """What of itself people look at; none for a chassis like any other."""
        ...

    def law(self, parts: LawParts) -> DriveLaw:
        """How it drives."""
        ...

    def masses(self) -> Rates:
        """What a motion along each axis moves at least: kg for an axis in m/s, kg m^2 for one in rad/s.

        `inertia` has in it what moves along below a joint, which hangs on the joint's angle; the checks of a robot file
        judge by this, the lightest that the body can be.
        """
        ...

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """About its body axes at these joint angles, as the motors feel it, rotors left out: kg, kg m, kg m^2."""
        ...

    def drawing(self) -> Drawing:
        """How it is drawn."""
        ...

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """What asks for a fast loop at this speed of the body, m/s, with measurements up to `delay` s old."""
        ...
