"""What every chassis says of itself: one file here, its section of the robot file and all that follows from it."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple, Protocol

from gateway.kinematics.contract import Kinematics
from gateway.kinematics.linear import Matrix
from gateway.sections import Body

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

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """About its body axes at these joint angles, as the motors feel it, rotors left out: kg, kg m, kg m^2."""
        ...

    def drawing(self) -> Drawing:
        """How it is drawn."""
        ...

    def loop_limits(self, top_speed: float) -> tuple[LoopLimit, ...]:
        """What asks for a fast loop at this speed of the body, m/s."""
        ...
