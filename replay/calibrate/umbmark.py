"""UMBmark: what squares both ways tell of a differential drive (Borenstein and Feng 1996, IEEE T-RA 12(6), 869-880).

How this works
--------------
Where ends of counter-clockwise and of clockwise squares lie against where the odometry says that they are has two
causes. Type A, a wrong track: in each corner the robot turns `alpha` less than it should, whichever way round. Type B,
unequal wheels: on each side it turns `beta` to the left. To first order the centres of gravity of the ends are

    left (ccw):  x = -2 L (alpha - beta)   y = +2 L (alpha - beta)
    right (cw):  x = -2 L (alpha + beta)   y = -2 L (alpha + beta)

An offset-differential robot whose platform keeps its heading drives the same squares: its chassis turns a quarter in
every corner, and the joint hands the chassis' errors on to the platform.
"""

from collections.abc import Sequence
from math import hypot, pi, sin
from typing import NamedTuple

Point = tuple[float, float]


class Umbmark(NamedTuple):
    """`error`: m, E max,syst, the larger distance of both centres of gravity; `left`, `right`: these.

    `alpha`, `beta`: rad; `track_ratio`: Eb, of the true track to that of the robot file; `wheel_ratio`: Ed, of the
    right wheel's diameter to the left one's; None of a robot that is no differential drive.
    """

    error: float
    left: Point
    right: Point
    alpha: float | None = None
    beta: float | None = None
    track_ratio: float | None = None
    wheel_ratio: float | None = None


def umbmark(left: Sequence[Point], right: Sequence[Point], *, length: float, track: float | None) -> Umbmark:
    """`left`, `right`: measured less told ends of squares of this side, counter-clockwise and clockwise; m.

    `track`: of a differential drive, None: it is none.
    """
    ccw, cw = _centre(left), _centre(right)
    error = max(hypot(*ccw), hypot(*cw))
    if track is None:
        return Umbmark(error, ccw, cw)
    # Each of x and y tells both; the mean of both is used, as both have errors of their own.
    alpha = 0.5 * ((cw[0] + ccw[0]) + (cw[1] - ccw[1])) / (-4.0 * length)
    beta = 0.5 * ((cw[0] - ccw[0]) + (cw[1] + ccw[1])) / (-4.0 * length)
    corner = pi / 2.0
    lever = track * sin(beta / 2.0) / length  # b/2 over the radius of the arc that a side has become
    return Umbmark(error, ccw, cw, alpha, beta, corner / (corner - alpha), (1.0 + lever) / (1.0 - lever))


def _centre(points: Sequence[Point]) -> Point:
    xs, ys = zip(*points, strict=True)
    return sum(xs) / len(xs), sum(ys) / len(ys)
