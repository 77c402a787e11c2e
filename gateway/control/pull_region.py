"""How an offset-differential chassis lies in its direction of motion: pushed, pulled, or about to flip.

How this works
--------------
The platform joint moves at v; gamma is the angle from the chassis axis to v, counter-clockwise. With cos gamma > 0 the
axle pushes the joint, and any error dies out along the way; with cos gamma < 0 the axle pulls it, an unstable balance:
an error grows e-fold every d1 of way until the chassis has flipped (preprints202312.1327, section 4; science 1.3).
On a path that turns at omega the balance in the pull region is at gamma_goal = pi - asin(d1 omega/c), which exists as
long as the turn is no tighter than d1.
"""

from enum import Enum
from math import isinf, pi, sqrt
from typing import Final, NamedTuple

from drivers.records import maker
from gateway.arithmetic import angle_of, arcsine, logarithm, sin_cos

LEAST_SPEED: Final = 1e-3  # m/s; a slower motion has no direction to speak of (science 1.3)
_NEARLY: Final = 1e-6  # of a turn as tight as d1, where the formulas of both sides lose their digits
_NEUTRAL: Final = 1e-12  # |cos gamma| up to which steering is neutral: the chassis turns about the axle's middle
_BEYOND_NEUTRAL: Final = 0.05  # |cos gamma|, by which another region must be entered to be told


class Region(Enum):
    """Which side of the axle leads."""

    PUSH = "push"
    NEUTRAL = "neutral"
    PULL = "pull"


# Members of an enumeration, each looked up once: where every cycle does, it takes a tenth of its time.
_PUSH: Final = Region.PUSH
PULLED: Final = Region.PULL


class Pull(NamedTuple):
    """Where the chassis is and what it moves along.

    `goal`: gamma of balance on the path, pulled; `saturated`: the path turns tighter than d1, and it has none.
    """

    gamma: float  # rad, -pi to pi
    region: Region
    goal: float  # rad, pi/2 to 3 pi/2
    saturated: bool
    error: float  # rad, of gamma from the goal, -pi to pi
    speed: float  # m/s
    path_rate: float  # rad/s


_pull: Final = maker(Pull)


class FlipSpeeds(NamedTuple):
    """The fastest that wheels and joint turn while the chassis flips, rad/s."""

    wheel: float
    joint: float


def wrapped(angle: float) -> float:
    """The same direction within -pi to pi, rad."""
    while angle > pi:
        angle -= 2.0 * pi
    while angle < -pi:
        angle += 2.0 * pi
    return angle


def goal_of(path_rate: float, speed: float, axle_offset: float) -> tuple[float, bool]:
    """gamma_goal = pi - asin(d1 omega/c) (Eq. 22), and whether it had to be clamped at a radius of d1."""
    tightness = axle_offset * path_rate / speed
    if -1.0 <= tightness <= 1.0:
        return pi - arcsine(tightness), False
    return (0.5 * pi if tightness > 0.0 else 1.5 * pi), True


def examine(vx: float, vy: float, *, angle: float, path_rate: float, axle_offset: float) -> Pull | None:
    """Of a joint that moves at (vx, vy), m/s in the platform frame, above a chassis at this joint angle, rad.

    `path_rate`: rad/s by which the direction of motion turns over the ground. None below LEAST_SPEED.
    """
    speed = sqrt(vx * vx + vy * vy)
    if speed < LEAST_SPEED:
        return None
    s, c = sin_cos(angle)
    along, across = c * vx - s * vy, s * vx + c * vy
    gamma = angle_of(across, along)
    goal, saturated = goal_of(path_rate, speed, axle_offset)
    return _pull((gamma, _region(along / speed), goal, saturated, wrapped(gamma - goal), speed, path_rate))


def turn_radius(speed: float, path_rate: float) -> float | None:
    """Of the path, m; None: it goes straight on, or as good as that."""
    if path_rate == 0.0:
        return None
    radius = speed / abs(path_rate)
    return None if isinf(radius) else radius


def flip_way(gamma: float, error: float, *, speed: float, path_rate: float, axle_offset: float) -> float | None:
    """Until the chassis lies across, m, on a path that goes on as it is and uncorrected; None: no flip is to come.

    Until cos gamma = 0, of d gamma/ds = (sigma - sin gamma)/d1 with sigma = sin p = d1 over the radius, signed.
    sin(e/2)/cos(e/2 - p) grows by e^(cos p) every d1, and is 1 or -1 in the end: exact, and on a straight path the
    tan(gamma/2) law of Eq. 20 (science 1.3; the curved path ours).
    """
    if abs(wrapped(gamma - pi)) >= 0.5 * pi:
        return None
    tightness = axle_offset * path_rate / speed
    if abs(tightness) >= 1.0 - _NEARLY:
        return axle_offset * _tight_way(gamma if tightness > 0.0 else -gamma, abs(tightness))
    sine, cosine = sin_cos(0.5 * error)
    if sine == 0.0:
        return None  # in balance
    slowness = sqrt((1.0 - tightness) * (1.0 + tightness))
    return axle_offset * max(0.0, logarithm(abs((cosine * slowness + sine * tightness) / sine))) / slowness


def settled(before: Region | None, pull: Pull | None) -> Region | None:
    """The region to be told, which noise does not toggle: push and pull hold until 3 degrees beyond neutral steering.

    `before`: what was told the cycle before. None at rest.
    """
    if pull is None:
        return None
    if before is None or pull.region is before:
        return pull.region
    _, along = sin_cos(pull.gamma)
    return pull.region if abs(along) > _BEYOND_NEUTRAL else before


def flip_speeds(speed: float, *, wheel_radius: float, axle_offset: float, track: float) -> FlipSpeeds:
    """(c/R) sqrt(1 + (d2/2 d1)^2) of the outer wheel, c/d1 of the joint: extremes of Eq. 12 over gamma."""
    lever = track / (2.0 * axle_offset)
    return FlipSpeeds(speed / wheel_radius * sqrt(1.0 + lever * lever), speed / axle_offset)


def _region(cosine: float) -> Region:
    if abs(cosine) <= _NEUTRAL:
        return Region.NEUTRAL
    return _PUSH if cosine > 0.0 else PULLED


def _tight_way(gamma: float, tightness: float) -> float:
    """Until gamma = 3 pi/2, in units of d1, turning tighter than d1 to the left: there is no balance.

    2/r atan((sigma tan(gamma/2) - 1)/r), r^2 = sigma^2 - 1, grows by 1 every d1.
    """
    sigma = max(tightness, 1.0 + _NEARLY)
    begin = gamma if gamma > 0.0 else gamma + 2.0 * pi
    return max(0.0, _turned(1.5 * pi, sigma) - _turned(begin, sigma))


def _turned(gamma: float, sigma: float) -> float:
    r = sqrt((sigma - 1.0) * (sigma + 1.0))
    sine, cosine = sin_cos(0.5 * gamma)
    return 2.0 / r * angle_of(sigma * sine - cosine, r * cosine)
