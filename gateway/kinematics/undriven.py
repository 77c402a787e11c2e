"""Motions of the body that its wheels hardly drive, or not at all, in words of who builds it.

How this works
--------------
The rim rows D take a motion to the rim speeds of the wheels. A motion that D takes to nothing turns no wheel, so no
wheel drives or holds it: those are the right singular vectors of D whose singular value is nothing, and small values
are motions that are pushed with little (Golub and Van Loan, Matrix Computations, section 2.4). Turning is measured at
the rim of the robot, so that it compares with going straight.
"""

from collections.abc import Sequence
from math import pi, remainder, sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import angle_of
from gateway.kinematics.contract import MAX_CONDITION
from gateway.kinematics.linear import Matrix, Vector, decompose
from gateway.types import PLANAR

WEAK: Final = 0.05  # of what the wheels push at most: below it they hardly drive a motion; source: ours
_TURN: Final = PLANAR.index("wz")
_HARDLY: Final = 0.01  # of a motion: what is less is not worth a word
_DEGREES: Final = 180.0 / pi


class Undriven(NamedTuple):
    """A motion, as an infinitive, and how hard it is pushed: of what the wheels push most."""

    words: str
    share: float


class Beyond(NamedTuple):
    """An axis beyond the twist: to move along it, and moving."""

    move: str
    moving: str


def undriven(
    rows: Matrix, length: float, *, least: float = WEAK, beyond: Sequence[Beyond] = ()
) -> tuple[Undriven, ...]:
    """Those with a share up to `least`, the weakest first. `rows`: rim rows; `length`: of the robot, m."""
    found = decompose(tuple(_turning(row, 1.0 / length) for row in rows))
    most = found.values[0]
    weak = [pair for pair in zip(found.values, found.right) if pair[0] <= least * most]
    return tuple([Undriven(_words(motion, length, beyond), value / (most or 1.0)) for value, motion in reversed(weak)])


def refusal(rows: Matrix, length: float, *, beyond: Sequence[Beyond] = ()) -> str:
    """What cannot be driven at all, as a sentence about the robot."""
    found = undriven(rows, length, least=1.0 / MAX_CONDITION, beyond=beyond)
    found = found or undriven(rows, length, least=1.0, beyond=beyond)[:1]
    return (
        f"it cannot {', nor '.join([one.words for one in found])}: that turns no wheel, so no wheel drives or holds it"
    )


def doubt(rows: Matrix, length: float, *, beyond: Sequence[Beyond] = ()) -> str | None:
    """The same of what is hardly driven; None: everything is driven well."""
    found = undriven(rows, length, beyond=beyond)
    if not found:
        return None
    shares = " and ".join(f"{one.words} ({100.0 * one.share:.2g} %)" for one in found)
    return f"it can hardly {shares} of what the wheels push most"


def _turning(row: Vector, factor: float) -> Vector:
    """With the turn in another measure."""
    return tuple([part * factor if axis == _TURN else part for axis, part in enumerate(row)])


def _words(motion: Sequence[float], length: float, beyond: Sequence[Beyond]) -> str:
    """Of this motion or its opposite; its turn is measured at the rim."""
    x, y, turn, *more = motion
    speed = sqrt(x * x + y * y)
    hardly = _HARDLY * max(speed, abs(turn), *map(abs, more))
    said = [one for one, part in zip(beyond, more) if abs(part) > hardly]
    if abs(turn) > hardly and speed > hardly:
        place = f"x = {_metres(-y / turn * length)}, y = {_metres(x / turn * length)} m"
        said.insert(0, Beyond(f"turn about the point {place}", f"turning about the point {place}"))
    elif abs(turn) > hardly:
        said.insert(0, Beyond("turn on the spot", "turning on the spot"))
    elif speed > hardly:
        way = _way(x, y)
        said.insert(0, Beyond(f"move {way}", f"moving {way}"))
    first, *others = said
    return " while ".join([first.move, *[one.moving for one in others]])


def _metres(value: float) -> str:
    return f"{round(value, 3) + 0.0:g}"  # no negative zero


def _way(x: float, y: float) -> str:
    turned = remainder(angle_of(y, x), pi) * _DEGREES
    if abs(turned) < 1.0:
        return "forward or backward"
    if abs(turned) > 89.0:
        return "sideways"
    return f"along the line {abs(turned):.0f} degrees to the {'left' if turned > 0.0 else 'right'} of forward"
