"""What every chassis answers: one small protocol, both directions from the same rows."""

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

from gateway.kinematics.linear import Matrix
from gateway.types import Rates, Twist

MAX_CONDITION: Final = 1e6  # beyond it a rounding error in a wheel speed becomes a visible body velocity


class GeometryError(ValueError):
    """A geometry that cannot be driven: singular, or too few distinct wheel directions."""


class Estimate(NamedTuple):
    """Body rate (or, from wheel displacements, body displacement) that fits measured wheels best.

    `residuals`: what of each wheel's rim speed no rigid motion explains, (I - D D+) m in m/s (Rojas 2005, section 9);
    None of a wheel that was not measured, and altogether where the wheels carry no redundancy. `residual`: their norm.
    """

    twist: Twist
    residual: float | None
    residuals: tuple[float | None, ...] | None = None
    more: Rates = ()  # axes of the kinematics beyond the twist

    @property
    def rates(self) -> Rates:
        """Every axis of the kinematics."""
        return (*self.twist, *self.more) if self.more else self.twist


class Reach(NamedTuple):
    """`lost`: twists that no usable motor drives or resists, a basis (of more axes: what of it
    is a twist). `effort`: share of the acceleration that is left.

    The effort holds in every direction, 0 where a direction is lost: what all motors together can push, the usable ones
    can push that much of.
    """

    rank: int
    lost: tuple[Twist, ...]
    effort: float

    @property
    def complete(self) -> bool:
        """Whether every direction is reached."""
        return not self.lost


class Kinematics(Protocol):
    """Geometry chassis <-> wheels. Per-wheel sequences are in the order of the robot file.

    `axes`: names of what the body can do, first those of a Twist (`PLANAR`), then what it has more, like a width.
    `positions` are the output angles (rad) of all motors; `steered` are the places of those the geometry depends on.
    """

    steered: tuple[int, ...]
    axes: tuple[str, ...]

    def wheel_speeds(self, rates: Rates, positions: Sequence[float | None]) -> list[float] | None:
        """Inverse kinematics: rad/s of every motor's output; None while a joint angle it needs is unknown."""
        ...

    def twist(self, speeds: Sequence[float | None], positions: Sequence[float | None]) -> Estimate | None:
        """Forward kinematics from the wheels that were measured (others None); None when they do not determine it."""
        ...

    def motion(self, speeds: Sequence[float | None], positions: Sequence[float | None]) -> Twist | None:
        """The twist of `twist` alone, for who asks nothing else."""
        ...

    def reach(self, usable: Sequence[bool]) -> Reach:
        """What the usable motors alone can do, at joint angle zero."""
        ...

    def matrix(self, positions: Sequence[float] | None = None) -> Matrix:
        """Wheel matrix (a row per wheel, rad/s per unit of each axis) at these joint angles, None: all at zero."""
        ...


def desaturate(speeds: Sequence[float], limits: Sequence[float]) -> float:
    """Largest factor <= 1 that brings every wheel within its limit; scaling all keeps the direction of motion."""
    factor = 1.0
    for speed, limit in zip(speeds, limits):
        if abs(speed) * factor > limit:
            factor = limit / abs(speed)
    return factor
