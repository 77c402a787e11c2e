"""What the wheels can follow: in this cycle, and ahead of time where the chassis is about to flip.

How this works
--------------
Wheels that are asked for a step do not follow it, and the robot leaves its path while they try. `pace` shortens a
motion until no wheel changes faster than it may. That alone is too late for an offset-differential robot that is pulled
with its chassis leading the wrong way round: on a straight path it flips by itself, at speeds that grow with the square
of the robot's own, and by then no shortening keeps the wheels together. `FlipLimit` has slowed the robot before.

On a straight path at speed c the chassis obeys tan(gamma/2) = t, t' = -t c/d1 (science 1.3), and the wheels want
    (c/R) (cos gamma -+ k sin gamma), changing by (c^2/(R d1)) sin gamma (sin gamma +- k cos gamma), k = d2/(2 d1);
the joint wants -(c/d1) sin gamma, changing by (c^2/d1^2) sin gamma cos gamma. So each t allows some c^2; and since the
way until t has fallen by a factor is known, d1 ln(factor), it also allows what braking can take away until a later t.
"""

from bisect import bisect_right
from collections.abc import Sequence
from math import inf, sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import sin_cos

# t from 0.1 mrad off push to 0.03 mrad off pull, in steps of 5 %: of d1 times 0.05 of way each.
_FACTOR: Final = 1.05
_LOG_FACTOR: Final = 0.04879016416943204  # ln 1.05
_FIRST: Final = 5e-5
_STEPS: Final = 435
BRAKING_SHARE: Final = 0.25  # of a wheel's acceleration, kept for slowing down while the chassis flips


_NOTHING: Final = 1e-9  # of a wheel's change: no share of so small a speed makes a difference


class Pace(NamedTuple):
    """`share` of the motion that the wheels can follow, 0 to 1; `kept`: every wheel can, so the direction is kept."""

    share: float
    kept: bool


def pace(wanted: Sequence[float], before: Sequence[float], most: Sequence[float]) -> Pace:
    """Largest share of the wanted speeds that no wheel has to change for by more than `most`; all rad/s.

    Where no share will do, for instance because a wheel has to turn round while another must go on, it is the one
    that asks least of the wheels beyond what they can.
    """
    low, high = 0.0, 1.0
    for speed, last, change in zip(wanted, before, most):
        if abs(speed) <= _NOTHING * change:
            if abs(last) > change:
                high = -inf
            continue
        ends = (last - change) / speed, (last + change) / speed
        low, high = max(low, min(ends)), min(high, max(ends))
    if low <= high:
        return Pace(high, kept=True)
    return Pace(_least_strain(wanted, before, most), kept=False)


def within(wanted: Sequence[float], before: Sequence[float], most: Sequence[float]) -> list[float]:
    """The wanted speeds, each as near as its wheel can come in this cycle."""
    return [max(last - change, min(last + change, speed)) for speed, last, change in zip(wanted, before, most)]


def _least_strain(wanted: Sequence[float], before: Sequence[float], most: Sequence[float]) -> float:
    """The share in 0 to 1 with the smallest worst change, in units of what each wheel can."""
    candidates = [0.0, 1.0]
    lines = [
        (sign * speed / change, -sign * last / change)
        for speed, last, change in zip(wanted, before, most)
        for sign in (1.0, -1.0)
    ]
    for at, (slope, start) in enumerate(lines):
        for other_slope, other_start in lines[:at]:
            if slope != other_slope:
                candidates.append((other_start - start) / (slope - other_slope))
    return min(
        (share for share in candidates if 0.0 <= share <= 1.0),
        key=lambda share: max(slope * share + start for slope, start in lines),
    )


class FlipLimit:
    """Speed at which the wheels can follow a flip of the chassis that is coming, on a path that goes straight on."""

    def __init__(
        self,
        *,
        wheel_radius: float,
        axle_offset: float,
        track: float,
        wheel_acceleration: float,
        joint_acceleration: float,
        braking: float,
    ) -> None:
        """m, and rad/s^2 of the slower wheel and of the joint; `braking`: m/s^2 by which the body slows down."""
        lever = track / (2.0 * axle_offset)
        slant = sqrt(1.0 + lever * lever)
        # Slowing down asks the wheels for braking slant/R and the joint for braking/d1 at the same time.
        self.braking = min(
            braking,
            BRAKING_SHARE * wheel_acceleration * wheel_radius / slant,
            BRAKING_SHARE * joint_acceleration * axle_offset,
        )
        wheel = (wheel_acceleration - self.braking * slant / wheel_radius) * wheel_radius * axle_offset
        joint = (joint_acceleration - self.braking / axle_offset) * axle_offset * axle_offset
        gained = 2.0 * self.braking * axle_offset * _LOG_FACTOR  # of c^2 on the way of one step
        self._tangents: list[float] = []
        self._squares: list[float] = []
        tangent, allowed = _FIRST, inf
        for _ in range(_STEPS):
            allowed = min(allowed + gained, _square(tangent, lever, wheel, joint))
            self._tangents.append(tangent)
            self._squares.append(allowed)
            tangent *= _FACTOR

    def speed_towards(self, vx: float, vy: float, joint: float) -> float:
        """The same for a motion in the platform frame above a chassis at this joint angle, rad."""
        s, c = sin_cos(joint)
        return self.speed(c * vx - s * vy, s * vx + c * vy)

    def speed(self, along: float, across: float) -> float:
        """Largest speed for a motion in this direction of the chassis, m/s: `along` its axis, `across` to its left."""
        tangents, squares = self._tangents, self._squares
        size = sqrt(along * along + across * across)
        tangent = min(abs(across) / (size + along), tangents[-1]) if size + along > 0.0 else tangents[-1]
        after = max(1, min(bisect_right(tangents, tangent), _STEPS - 1))
        share = (tangent - tangents[after - 1]) / (tangents[after] - tangents[after - 1])
        return sqrt(squares[after - 1] + max(share, 0.0) * (squares[after] - squares[after - 1]))


def _square(tangent: float, lever: float, wheel: float, joint: float) -> float:
    """c^2 at which the wheels just follow the chassis at this tan(gamma/2)."""
    square = tangent * tangent
    sine, cosine = 2.0 * tangent / (1.0 + square), (1.0 - square) / (1.0 + square)
    of_wheel = sine * max(abs(sine + lever * cosine), abs(sine - lever * cosine))
    return min(wheel / of_wheel, joint / (sine * abs(cosine)) if cosine != 0.0 else inf)
