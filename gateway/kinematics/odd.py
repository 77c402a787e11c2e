"""Four mecanum wheels in line whose two pairs go apart while driving (ODD; arXiv 2407.10127, equations 12 to 14).

How this works
--------------
Wheels 1 to 4 stand from left to right on the line across the body, pair L (1, 2) around +d/2 and pair R (3, 4) around
-d/2, the wheels of a pair w apart. Each rolls at r thetadot = (vx - wz y) + T vy of its pair, T the tangent of its
roller's angle, and vy_L, vy_R = vy +- d'/2. Four rows, four unknowns: forward kinematics is their solution in closed
form by Cramer's rule, at any width d. Its determinant, up to sign

    sigma1 = d (T1 - T2)(T3 - T4) + w (T1 T4 - T2 T3),

is a straight line over d, so it is zero nowhere between two widths where it has one sign.
"""

from collections.abc import Sequence
from math import inf
from typing import Final, NamedTuple

from gateway.kinematics.contract import Estimate, GeometryError, Reach
from gateway.kinematics.linear import Matrix
from gateway.kinematics.mecanum import roller_tangent
from gateway.kinematics.reach import ReachTable
from gateway.kinematics.undriven import Beyond, doubt, refusal
from gateway.types import PLANAR, Rates, Twist

AXES: Final = (*PLANAR, "width_rate")
MIN_SIGMA: Final = 1e-6  # m
WHEELS: Final = 4
_BEYOND: Final = (Beyond("open or close", "opening or closing"),)
Tangents = tuple[float, float, float, float]  # of the roller angles, wheels from left to right


class Sides(NamedTuple):
    """How the middles of the two pairs move, m/s along the body."""

    left: tuple[float, float]
    right: tuple[float, float]


def sigma1(tangents: Tangents, *, width: float, spacing: float) -> float:
    """What the solution is divided by, m: not zero wherever four wheels tell the motion."""
    one, two, three, four = tangents
    return width * (one - two) * (three - four) + spacing * (one * four - two * three)


class OddGeometry:
    """Both directions at any width between `narrowest` and `widest`, m. It never changes.

    `roller_angles`: of the wheels from left to right, rad from forward; `radius`, and `spacing` of the wheels of a
    pair, m. Raises GeometryError for what cannot be driven at every width of the range.
    """

    def __init__(
        self, roller_angles: Sequence[float], *, radius: float, spacing: float, narrowest: float, widest: float
    ) -> None:
        if len(roller_angles) != WHEELS:
            message = f"{len(roller_angles)} roller angles: must be {WHEELS}, of the wheels from left to right"
            raise GeometryError(message)
        first, second, third, fourth = [roller_tangent(angle) for angle in roller_angles]
        self.tangents: Final[Tangents] = (first, second, third, fourth)
        self.radius: Final = radius
        self.spacing: Final = spacing
        self.narrowest: Final = narrowest
        self.widest: Final = widest
        self._check_range()

    def sigma(self, width: float) -> float:
        """sigma1 at this width, m."""
        return sigma1(self.tangents, width=width, spacing=self.spacing)

    def places(self, width: float) -> tuple[float, float, float, float]:
        """Of the wheels, m to the left of the middle."""
        far, near = 0.5 * (width + self.spacing), 0.5 * (width - self.spacing)
        return far, near, -near, -far

    def rim_rows(self, width: float) -> Matrix:
        """One for each wheel: m/s at the rim per unit of each axis."""
        halves = (0.5, 0.5, -0.5, -0.5)
        return tuple(
            (1.0, tangent, -place, half * tangent)
            for tangent, place, half in zip(self.tangents, self.places(width), halves, strict=True)
        )

    def wheel_speeds(self, rates: Rates, width: float) -> list[float] | None:
        """Inverse kinematics, rad/s; None at a width where the wheels do not tell the motion."""
        if not self._determined(width):
            return None
        vx, vy, wz, rate = rates
        left, right = vy + 0.5 * rate, vy - 0.5 * rate
        return [
            (vx - wz * place + tangent * side) / self.radius
            for place, tangent, side in zip(self.places(width), self.tangents, (left, left, right, right), strict=True)
        ]

    def rates(self, speeds: Sequence[float | None], width: float) -> Rates | None:
        """Forward kinematics from rad/s of all four wheels; None while one is unknown, or width does not let them."""
        found = self._solved(speeds, width)
        if found is None:
            return None
        vx, left, right, wz = found
        return vx, 0.5 * (left + right), wz, left - right

    def sides(self, speeds: Sequence[float | None], width: float) -> Sides | None:
        """How the pairs move; None as above."""
        found = self._solved(speeds, width)
        if found is None:
            return None
        vx, left, right, wz = found
        lag = 0.5 * width * wz
        return Sides((vx - lag, left), (vx + lag, right))

    def _solved(self, speeds: Sequence[float | None], width: float) -> tuple[float, float, float, float] | None:
        """vx, vy of both pairs, and wz."""
        known = [speed * self.radius for speed in speeds if speed is not None]
        if len(known) != WHEELS or not self._determined(width):
            return None
        one, two, three, four = known
        t1, t2, t3, t4 = self.tangents
        p, q, w, e = t1 - t2, t3 - t4, self.spacing, width - self.spacing
        a, b, c = one - two, three - four, two - three
        sigma = self.sigma(width)
        wz = (a * q * t2 - b * p * t3 - c * p * q) / sigma
        left = (a * (w * t3 + q * e) - b * w * t3 - c * w * q) / sigma
        right = (a * w * t2 + b * (p * e - w * t2) - c * w * p) / sigma
        vx = 0.25 * ((one + two + three + four) - (t1 + t2) * left - (t3 + t4) * right)
        return vx, left, right, wz

    def _determined(self, width: float) -> bool:
        return MIN_SIGMA <= abs(self.sigma(width)) < inf

    def _check_range(self) -> None:
        if not 0.0 < self.spacing <= self.narrowest <= self.widest < inf:
            message = (
                f"width from {self.narrowest:g} to {self.widest:g} m: must begin at the spacing of the wheels of a"
                f" pair, {self.spacing:g} m, or above, where they touch, and end above its beginning"
            )
            raise GeometryError(message)
        if not self.radius > 0.0:
            message = f"radius = {self.radius:g} m: must be above zero"
            raise GeometryError(message)
        at_narrowest, at_widest = self.sigma(self.narrowest), self.sigma(self.widest)
        if not (min(abs(at_narrowest), abs(at_widest)) >= MIN_SIGMA and (at_narrowest > 0.0) == (at_widest > 0.0)):
            width = self._singular(at_narrowest, at_widest)
            message = (
                f"these roller angles do not drive all four axes at every width from {self.narrowest:g} to"
                f" {self.widest:g} m: sigma1 = {at_narrowest:.3g} to {at_widest:.3g} m, must keep its sign and be"
                f" {MIN_SIGMA:g} m at least; the rollers of a pair must differ, like 45 and -45 degrees. At a width of"
                f" {width:.4g} m {refusal(self.rim_rows(width), 0.5 * width, beyond=_BEYOND)}"
            )
            raise GeometryError(message)

    def doubt(self) -> str | None:
        """A motion that the wheels hardly drive at one end of the range."""
        for width in (self.narrowest, self.widest):
            found = doubt(self.rim_rows(width), 0.5 * (width + self.spacing), beyond=_BEYOND)
            if found is not None:
                return f"at a width of {width:g} m {found}"
        return None

    def _singular(self, at_narrowest: float, at_widest: float) -> float:
        """The width at which sigma1, a straight line, is nothing; else the end at which it is hardly more."""
        if abs(at_narrowest) < MIN_SIGMA or abs(at_widest) < MIN_SIGMA:
            return self.narrowest if abs(at_narrowest) <= abs(at_widest) else self.widest
        share = at_narrowest / (at_narrowest - at_widest)
        return self.narrowest + share * (self.widest - self.narrowest)


class Width:
    """How far apart the pairs are, m. One writer, the drive law; the kinematics reads it."""

    def __init__(self, metres: float) -> None:
        self.metres = metres


class OddKinematics:
    """Kinematics at the width that is known now; it begins with `start`, m, and no joint angle changes it."""

    steered: tuple[int, ...] = ()
    axes: tuple[str, ...] = AXES

    def __init__(self, geometry: OddGeometry, *, start: float) -> None:
        if not geometry.narrowest <= start <= geometry.widest:
            message = f"width = {start:g} m: must be from {geometry.narrowest:g} to {geometry.widest:g} m"
            raise GeometryError(message)
        self.geometry: Final = geometry
        self.width: Final = Width(start)
        rows = geometry.rim_rows(start)
        self._reach: Final = ReachTable(rows)
        self._rows: Final[Matrix] = tuple(tuple([part / geometry.radius for part in row]) for row in rows)

    def wheel_speeds(self, rates: Rates, positions: Sequence[float | None] = ()) -> list[float] | None:
        """Inverse kinematics, rad/s."""
        return self.geometry.wheel_speeds(rates, self.width.metres)

    def twist(self, speeds: Sequence[float | None], positions: Sequence[float | None] = ()) -> Estimate | None:
        """Forward kinematics; four wheels and four axes leave nothing unexplained."""
        rates = self.geometry.rates(speeds, self.width.metres)
        if rates is None:
            return None
        vx, vy, wz, rate = rates
        return Estimate(Twist(vx, vy, wz), None, None, (rate,))

    def motion(self, speeds: Sequence[float | None], positions: Sequence[float | None] = ()) -> Twist | None:
        """The twist alone."""
        rates = self.geometry.rates(speeds, self.width.metres)
        return None if rates is None else Twist(rates[0], rates[1], rates[2])

    def reach(self, usable: Sequence[bool]) -> Reach:
        """Every wheel is needed; what is lost without one, at the width of the start."""
        return self._reach.of(usable)

    def matrix(self, positions: Sequence[float] | None = None) -> Matrix:
        """Wheel matrix at the width of the start, rad/s per unit of each axis."""
        return self._rows
