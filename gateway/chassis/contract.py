"""What every chassis says of itself: one file here, its section of the robot file and all that follows from it."""

from typing import ClassVar, NamedTuple, Protocol

from gateway.kinematics.contract import Kinematics
from gateway.sections import Body
from gateway.types import Rates

Point = tuple[float, float]


class DrawnWheel(NamedTuple):
    """A wheel from above: where (m), the direction in which it rolls (rad), its radius (m)."""

    x: float
    y: float
    rolling: float
    radius: float


class Drawing(NamedTuple):
    """The robot from above, x forward and y left, in m.

    `reach`: radius of the circle that stands for the body; `frame`: a closed line, empty for none. `beneath`: place of
    the joint by which the body turns on frame and wheels; None where they are one.
    """

    reach: float
    wheels: tuple[DrawnWheel, ...]
    frame: tuple[Point, ...] = ()
    beneath: int | None = None


class LoopLimit(NamedTuple):
    """What works only with a loop that is fast enough: its name, and the longest period, s."""

    name: str
    period: float


class Chassis(Protocol):
    """A section of the robot file with kind, name, body and geometry, frozen."""

    GEOMETRY: ClassVar[str]  # the keys of the geometry, in words
    AXES: ClassVar[tuple[str, ...]]  # of its kinematics; limits of the robot file name each of them

    @property
    def kind(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def body(self) -> Body: ...

    def motor_names(self) -> tuple[str, ...]:
        """Motors of the chassis; the order of every per-motor sequence in the core."""
        ...

    def kinematics(self) -> Kinematics:
        """Its geometry. Raises GeometryError for one that cannot be driven."""
        ...

    def masses(self) -> Rates:
        """What a motion along each axis moves: kg for an axis in m/s, kg m^2 for one in rad/s."""
        ...

    def drawing(self) -> Drawing:
        """How it is drawn."""
        ...

    def loop_limits(self, top_speed: float) -> tuple[LoopLimit, ...]:
        """What asks for a fast loop at this speed of the body, m/s."""
        ...
