"""How an offset-differential robot turns its chassis round before it drives: by which pieces, how far out, how long.

How this works
--------------
The chassis turns only while its joint moves across it, v_perp = d1 omega (preprints202312.1327, Eq. 12; science 1.3),
so turning the chassis first is a manoeuvre. Two motions have wheel speeds that do not depend on any angle: the joint
straight across the chassis (neutral steering: the axle's middle A stays where it is, the joint P goes round it on an
arc of radius d1), and straight along it. Every manoeuvre is a chain of these two; the platform keeps its heading above.

arc: turn by D. P ends 2 d1 sin(|D|/2) from its place.
closed: P ends in its place. A has to get from P - d1 e(0) to P - d1 e(D), by 2 d1 sin(|D|/2), which lies along the
chassis once that has turned back by (pi - |D|)/2: turn so far back, go so far ahead, turn by (pi + |D|)/2. Half a turn
is just straight ahead by 2 d1, and half a circle.

Speeds rise by a at most, which comes and goes with the jerk of the body, stay within one top speed and fall along
v(s) = sqrt(2 b s + (b T)^2) - b T over the way s that is left: by b at most, and like s/T at the end, where motors that
follow late still do.
"""

from collections.abc import Sequence
from enum import Enum
from math import inf, pi, sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import angle_of, logarithm, sin_cos

REACHED: Final = 0.01  # of d1: way that is left when a piece is done
LANDING_TIME: Final = 0.15  # s, T; several times by what motors are late. Source: ours
SETTLE_TIME: Final = 0.1  # s, until it stands between two pieces. Source: ours
_NONE: Final = 1e-6  # rad: no turn at all
_HALVINGS: Final = 40


class Form(Enum):
    """The two manoeuvres."""

    ARC = "arc"
    CLOSED = "closed"


class Way(Enum):
    """The two motions that they are made of."""

    TURN = "turning"  # the joint straight across the chassis
    DRIVE = "driving"  # and along it


class Piece(NamedTuple):
    """`size`: rad by which the chassis turns, counter-clockwise, or m along its axis, ahead."""

    way: Way
    size: float


class Pace(NamedTuple):
    """What a manoeuvre may use of the joint; m/s, m/s^2, and m/s^3 on its way up."""

    speed: float
    acceleration: float
    braking: float
    jerk: float = inf


class Plan(NamedTuple):
    """`footprint`: m by which the joint, and the platform with it, leaves its place at most; `duration`: s."""

    pieces: tuple[Piece, ...]
    footprint: float
    duration: float
    pace: Pace


def plan(form: Form, turn: float, pace: Pace, *, axle_offset: float) -> Plan:
    """Turns the chassis by `turn`, rad within a turn and a half; `pace.speed` above zero."""
    pieces = pieces_of(form, turn, axle_offset)
    duration = 0.0
    for piece in pieces:
        duration += _time(length(piece, axle_offset), pace, axle_offset) + SETTLE_TIME
    return Plan(pieces, footprint(pieces, axle_offset), duration, pace)


def pieces_of(form: Form, turn: float, axle_offset: float) -> tuple[Piece, ...]:
    """What it is made of."""
    if form is Form.ARC:
        return (Piece(Way.TURN, turn),)
    half = 0.5 * pi if turn > 0.0 else -0.5 * pi
    sine, _ = sin_cos(0.5 * abs(turn))
    back, onward = 0.5 * turn - half, 0.5 * turn + half
    ahead = Piece(Way.DRIVE, 2.0 * axle_offset * sine)
    swings = Piece(Way.TURN, back), ahead, Piece(Way.TURN, onward)
    return swings if abs(back) > _NONE else swings[1:]


def length(piece: Piece, axle_offset: float) -> float:
    """Way of the joint, m."""
    return abs(piece.size) * (axle_offset if piece.way is Way.TURN else 1.0)


def footprint(pieces: Sequence[Piece], axle_offset: float) -> float:
    """How far the joint gets from where it was, m."""
    x, y, heading = -axle_offset, 0.0, 0.0  # of the axle's middle; the joint begins in the middle of the world
    farthest = 0.0
    for way, size in pieces:
        if way is Way.TURN:
            away = angle_of(y, x)  # where the joint is farthest, if it gets there
            low, high = min(heading, heading + size), max(heading, heading + size)
            while away > low:
                away -= 2.0 * pi
            if away + 2.0 * pi <= high:
                farthest = max(farthest, sqrt(x * x + y * y) + axle_offset)
            heading += size
            s, c = sin_cos(heading)
        else:
            s, c = sin_cos(heading)
            x, y = x + size * c, y + size * s
        joint_x, joint_y = x + axle_offset * c, y + axle_offset * s
        farthest = max(farthest, sqrt(joint_x * joint_x + joint_y * joint_y))
    return farthest


def landing_speed(left: float, braking: float) -> float:
    """Speed with this much way left, m/s."""
    if left <= 0.0:
        return 0.0
    tail = braking * LANDING_TIME
    return sqrt(2.0 * braking * left + tail * tail) - tail


def _time(way: float, pace: Pace, axle_offset: float) -> float:
    """Of one piece, from rest until its way is done but for REACHED, s."""
    end = landing_speed(REACHED * axle_offset, pace.braking)
    way -= REACHED * axle_offset
    if way <= 0.0:
        return 0.0
    top = pace.speed
    if _rising(top, pace) + _falling(top, end, pace) > way:
        top = _top_within(way, end, pace)
    steady = max(0.0, way - _rising(top, pace) - _falling(top, end, pace))
    slowing = (top - end) / pace.braking + LANDING_TIME * logarithm(top / end) if top > end else 0.0
    return _rise_time(top, pace) + steady / top + slowing


def _top_within(way: float, end: float, pace: Pace) -> float:
    """The speed up to which it rises before it has to fall again; the way grows with it, so halving finds it."""
    low, high = 0.0, pace.speed
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _rising(middle, pace) + _falling(middle, end, pace) > way:
            high = middle
        else:
            low = middle
    return high


def _rise_time(top: float, pace: Pace) -> float:
    """s, with full acceleration in the middle where there is time for it."""
    if top * pace.jerk >= pace.acceleration * pace.acceleration:
        return top / pace.acceleration + pace.acceleration / pace.jerk
    return 2.0 * sqrt(top / pace.jerk)


def _rising(top: float, pace: Pace) -> float:
    """Way on which it rises to this speed, m: symmetric about its middle."""
    return 0.5 * top * _rise_time(top, pace)


def _falling(top: float, end: float, pace: Pace) -> float:
    """Way on which landing takes it from one speed to the other, m."""
    if top <= end:
        return 0.0
    return (top * top - end * end) / (2.0 * pace.braking) + LANDING_TIME * (top - end)


class Limits(NamedTuple):
    """What bounds a manoeuvre: of the body per axis of the floor, and of the motors at the joint; m/s, m/s^2, m/s^3."""

    velocity: float
    acceleration: float
    motor_speed: float
    motor_acceleration: float = inf
    jerk: float = inf

    def pace(self, asked: float, axle_offset: float) -> Pace:
        """For a command of this speed, m/s. On the arc half of the acceleration is left for changing speed."""
        steady = sqrt(0.5 * self.acceleration * axle_offset)
        changing = min(0.5 * self.acceleration, 0.5 * self.motor_acceleration)
        return Pace(min(asked, self.velocity, self.motor_speed, steady), changing, changing, self.jerk)
