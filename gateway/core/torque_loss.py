"""Which motor's torque does not reach the floor: what all motors tell that they push, against what the body gains.

How this works
--------------
A motor that has lost its torque is dragged along at just the speed the others have, and its own speed tells nothing.
But the momentum of the body does not answer to what its controller reports. Over each BLOCK the impulses of all the
motors, friction as the robot file has it taken off, minus the momentum gained are what is missing: nothing of a sound
robot, and of one that has lost motor i just the impulse of motor i, along row i of the wheel matrix (De Luca and
Mattone, Actuator failure detection and isolation using generalized momenta, ICRA 2003). Forces are compared in the
measure of the accelerations they give (F' M^-1 F, W when over time), so that nobody weighs newtons against newton
metres. A memory of some blocks holds how much is missing, and how much would be if motor i had pushed nothing.

A load, a slope, a push, a wheel on ice: something is missing then as well, but not along one wheel and not as much as
that wheel tells. What another mass and another inertia than the robot file's would explain is taken off before.
A robot that stands tells nothing either: what a speed loop still pushes then, dry friction may hold.
Not seen: a motor that is asked for nothing (so none of its torque can be missing), and which of two it is where both
are lost at once. Not told apart: a wheel that is braked by just as much as its motor pushes.
"""

from collections.abc import Sequence
from typing import Final

from gateway.arithmetic import dot
from gateway.kinematics.linear import Matrix, Vector, pseudo_inverse
from gateway.types import Twist

BLOCK: Final = 0.02  # s; speeds are told in steps, and of a shorter time their difference would be mostly those
MEMORY: Final = 0.2  # s
EXPLAINED: Final = 0.15  # of what is missing, that may be left once one motor is taken for dead; 0.4 and more on
# sound robots in 96 random drives: 17 to 150 kg of 25 kg, slopes to 0.3 rad, pushes to 206 N, friction down to 0.05
OTHERS: Final = 0.4  # of what is left with the next best motor taken for dead instead
LEAST_TORQUE: Final = 0.1  # of the torque limit, missing for ...
LEAST_TIME: Final = 0.1  # ... so long, s: less may be anything
DRAG_SPEED: Final = 0.5  # rad/s from which dry friction is taken to be full
_NOTHING: Final = 1e-6  # W; far below what the steps of measured speeds make of it


class Mechanics:
    """What resists and carries the motors. Nobody changes it.

    `rows`: rad/s of each wheel per unit of the twist; `body`: kg, kg m, kg m^2 without rotors; `rotor`: kg m^2 of each;
    `friction`: N m s/rad and `drag`: N m of dry friction, at each.
    """

    __slots__ = ("body", "drag", "friction", "inertia", "inverse", "rows")

    def __init__(self, rows: Matrix, body: Matrix, *, rotor: float, friction: float, drag: float) -> None:
        self.rows: Final = rows
        self.body: Final = body
        self.friction: Final = friction
        self.drag: Final = drag
        columns = tuple(zip(*rows, strict=True))
        self.inertia: Final[Matrix] = tuple(
            tuple(part + rotor * dot(column, other) for part, other in zip(line, columns, strict=True))
            for line, column in zip(body, columns, strict=True)
        )
        self.inverse: Final = pseudo_inverse(self.inertia)

    def gained(self, before: Twist, after: Twist, dt: float) -> Vector:
        """Impulse (N s, N s, N m s) that it took to come from one twist to another; rotors feel no turning."""
        vx, vy, wz = ((a + b) / 2.0 for a, b in zip(before, after, strict=True))
        along, across, _ = _image(self.body, (vx, vy, wz))
        x, y, turn = _image(self.inertia, tuple([b - a for a, b in zip(before, after, strict=True)]))
        return x - wz * across * dt, y + wz * along * dt, turn + (vx * across - vy * along) * dt

    def resisted(self, before: Twist, after: Twist, dt: float) -> list[float]:
        """Impulse of the friction at each wheel, N m s."""
        mean = [(a + b) / 2.0 for a, b in zip(before, after, strict=True)]
        speeds = [dot(row, mean) for row in self.rows]
        return [(self.friction * speed + self.drag * max(-1.0, min(1.0, speed / DRAG_SPEED))) * dt for speed in speeds]


class TorqueLossDetector:
    """Looks at all wheels together; for robots whose geometry no joint angle changes."""

    def __init__(self, mechanics: Mechanics, torques: Sequence[float]) -> None:
        """`torques`: N m that each motor has."""
        self._mechanics = mechanics
        inverse = mechanics.inverse
        self._least = tuple(
            [
                LEAST_TIME * LEAST_TORQUE * LEAST_TORQUE * torque * torque * _product(row, row, inverse)
                for row, torque in zip(mechanics.rows, torques, strict=True)
            ]
        )
        self.forget()

    def forget(self) -> None:
        """What was before says nothing about now."""
        self._before: Twist | None = None
        self._time = 0.0
        self._impulses = [0.0] * len(self._least)
        self._missing = _Missing()
        self._left = [0.0] * len(self._least)  # W: of what is missing with this motor taken for dead

    def look(self, twist: Twist | None, torques: Sequence[float | None], dt: float) -> tuple[int, str] | None:
        """Take a cycle: how the body moves (None: not known, or not to be judged by) and N m told of each motor.

        Which motor it is and what is wrong, in words, once that is sure.
        """
        if twist is None:
            self.forget()
            return None
        impulses = self._impulses
        for index, torque in enumerate(torques):
            if torque is None:
                self.forget()
                return None
            impulses[index] += torque * dt
        self._time += dt
        before = self._before
        if before is None:
            self._begin(twist)
            return None
        if self._time < BLOCK:
            return None
        stood = self._stands(before, twist)
        if not stood:
            self._take(before, twist)
        self._begin(twist)
        suspect = None if stood else self._suspect()
        if suspect is None:
            return None
        told = torques[suspect] or 0.0
        return suspect, f"the robot does not move by its torque (now {told:.1f} N m): it does not arrive"

    def _begin(self, twist: Twist) -> None:
        self._before = twist
        self._time = 0.0
        self._impulses = [0.0] * len(self._least)

    def _stands(self, before: Twist, after: Twist) -> bool:
        """Whether no wheel turns as fast as is needed to know what dry friction does."""
        for twist in (before, after):
            for row in self._mechanics.rows:
                if abs(dot(row, twist)) >= DRAG_SPEED:
                    return False
        return True

    def _take(self, before: Twist, after: Twist) -> None:
        """The balance of a block."""
        mechanics, time = self._mechanics, self._time
        gained = mechanics.gained(before, after, time)
        resisted = mechanics.resisted(before, after, time)
        missing = tuple([-part for part in gained])
        for row, impulse, friction in zip(mechanics.rows, self._impulses, resisted):
            missing = _plus(missing, row, impulse - friction)
        kept, inverse = max(0.0, 1.0 - time / MEMORY), mechanics.inverse
        self._missing.take(missing, gained, inverse, kept=kept, time=time)
        for index, (row, impulse) in enumerate(zip(mechanics.rows, self._impulses)):
            left = _plus(missing, row, -impulse)
            self._left[index] = kept * self._left[index] + _product(left, left, inverse) / time

    def _suspect(self) -> int | None:
        left = self._left
        index = min(range(len(left)), key=left.__getitem__)
        missing = self._missing.unexplained()
        if missing < self._least[index] or left[index] > EXPLAINED * missing:
            return None
        for other, much in enumerate(left):
            if other != index and left[index] > OTHERS * much:
                return None
        return index


class _Missing:
    """Products of what is missing with itself and with what moves translation and turn have gained, W."""

    def __init__(self) -> None:
        self._square = self._along = self._around = 0.0
        self._way = self._turn = self._both = 0.0

    def take(self, missing: Vector, gained: Vector, inverse: Matrix, *, kept: float, time: float) -> None:
        """One block, its impulses in N s."""
        way, turn = (gained[0], gained[1], 0.0), (0.0, 0.0, gained[2])
        self._square = kept * self._square + _product(missing, missing, inverse) / time
        self._along = kept * self._along + _product(missing, way, inverse) / time
        self._around = kept * self._around + _product(missing, turn, inverse) / time
        self._way = kept * self._way + _product(way, way, inverse) / time
        self._turn = kept * self._turn + _product(turn, turn, inverse) / time
        self._both = kept * self._both + _product(way, turn, inverse) / time

    def unexplained(self) -> float:
        """Of what is missing, what no other mass and no other inertia would explain (least squares)."""
        way = self._way + _NOTHING
        turn = self._turn + _NOTHING - self._both * self._both / way
        around = self._around - self._along * self._both / way
        return self._square - self._along * self._along / way - around * around / turn


def _image(matrix: Matrix, vector: Sequence[float]) -> Vector:
    return tuple([dot(row, vector) for row in matrix])


def _product(a: Sequence[float], b: Sequence[float], inverse: Matrix) -> float:
    return dot(a, _image(inverse, b))


def _plus(vector: Vector, other: Vector, factor: float) -> Vector:
    return tuple([one + factor * two for one, two in zip(vector, other)])
