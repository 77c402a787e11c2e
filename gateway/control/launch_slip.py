"""Whether a launch slips all the same, told by torques: speeds alone show little of it.

How this works
--------------
Wheels that slip under speed control turn about as they are told. But the floor then pushes a wheel back by less than
its share of the push, though it is not behind its setpoint, as one would be whose motor cannot. Where no torque is told
the wheel must run ahead. A motor that is told nothing but its speed brings its torque late, and how such wheels share a
push is up to their speed loops: of those only the push of all of them tells, against what the wheels have gained.
What the floor gave is the impulse of the motors less what the wheels took for themselves: a speed loop that has lost
the inertia of the robot swings, so that no single torque tells.
Only while the robot speeds up straight on: in a curve shares change all the time, and of one that is braked it is not
known as well what resists it. And once the friction is taken for less the wheels have time to grip again, or the end of
one slip would be taken for another. Nor after a late cycle, which is no slip either.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Final, NamedTuple

from gateway.control.drive_law import Measured
from gateway.control.grip import Grip, Push, Three

SHORT: Final = 0.2  # of its grip, by which a wheel that slips is pushed back less than it is to push
BEHIND: Final = 0.01  # of top speed: a wheel further behind its setpoint lacks torque
AHEAD: Final = 0.01  # of top speed, by which a wheel that slips runs ahead, where no torque is told
LOOK_TIME: Final = 0.04  # s, from one look to the next
TOLD: Final = 0.4  # of the cycles in which a torque must be a new one: many tell it more seldom than speed
PAUSE: Final = 0.12  # s, after one that found slip, and after a late cycle
LATE: Final = 2.0  # periods of the loop, in which the motors went on with what they were told before
MOTOR_SHARE: Final = 0.98  # of a motor's torque that a launch takes; the rest is for its speed control and friction
_LEAST: Final = 1e-3  # N m
BACK_OFF: Final = 0.85  # of the friction, where what the floor gave is not known
_FULL: Final = 0.8  # of what a wheel bears: with less, a look says nothing of the floor


class Losses(NamedTuple):
    """What a motor's torque goes into before the floor feels it: kg m^2, N m s/rad and N m at its output."""

    inertia: float
    friction: float
    drag: float

    def push(self, torque: float, radius: float) -> Push:
        """What is left of a motor's torque, N m, at the rim of a wheel that does not turn fast yet."""
        return Push(max(_LEAST, MOTOR_SHARE * torque - self.drag) / radius, self.inertia / (radius * radius))


class Told(NamedTuple):
    """Of a cycle that pushed: N m of each wheel, the acceleration that the body feels and, rad/s^2, of the wheels.

    `bears`: N m with which each wheel would slip.
    `launch`: the floor is what limits it, and not a stop that nobody commanded.
    """

    torques: tuple[float, ...]
    felt: Three
    rates: tuple[float, ...]
    bears: tuple[float, ...]
    launch: bool


class LaunchSlip:
    """State owner: what the wheels did in this look at them, one after the other while there is a launch."""

    def __init__(
        self,
        grip: Grip,
        *,
        radii: Sequence[float],
        losses: Losses,
        top_speeds: Sequence[float],
        led: Sequence[bool],
        period: float,
    ) -> None:
        """`radii` m; `top_speeds` rad/s; `led`: motors that are told their share; `period` s, of the loop."""
        self._grip = grip
        self._led = tuple(led)
        self._radii = tuple(radii)
        self._losses = losses
        self._top_speeds = tuple(top_speeds)
        self._longest = LATE * period
        self.looks = 0  # at a full push, of which all torques were told: others would not show it
        self._looking = False
        self._pause = 0.0  # s, until the next look
        self._given: list[float] = []  # N m s meant for wheel and floor
        self._ahead: list[float] = []  # rad
        self._anew: list[int] = []  # cycles with a torque that was told since the one before
        self._begin((), ())

    def look(self, told: Told, expected: Sequence[float], measured: Measured, friction: float) -> float | None:
        """What friction the floor gave, where wheels slipped; `expected`: rad/s that they should turn."""
        if measured.dt > self._longest:
            self._looking, self._pause = False, PAUSE
            return None
        if self._pause > 0.0:
            self._pause -= measured.dt
            return None
        if not self._looking:
            if not _speeds_up(told.rates, measured.speeds):
                return None
            self._looking = True
            self._begin(measured.speeds, expected)
            return None
        dt = measured.dt
        self._time += dt
        self._torques.append(measured.torques)
        fresh_ns, given, ahead, anew = dt * 1e9, self._given, self._ahead, self._anew
        for place, (torque, is_, due, age_ns) in enumerate(
            zip(told.torques, measured.speeds, expected, measured.torque_ages_ns)
        ):
            given[place] += dt * torque
            if is_ is not None:
                ahead[place] += dt * (is_ - due)
            if age_ns is not None and age_ns <= fresh_ns:
                anew[place] += 1
        return self._judge(told, measured, expected, friction) if self._time >= LOOK_TIME else None

    def _begin(self, speeds: Sequence[float | None], expected: Sequence[float]) -> None:
        """Nothing has been yet. The sums are over time."""
        count = len(self._radii)
        self._time = 0.0  # s
        self._begun = tuple(speeds), tuple(expected)  # rad/s that the wheels turned, and were to
        self._torques: list[tuple[float | None, ...]] = []  # N m told
        self._given, self._ahead = [0.0] * count, [0.0] * count
        self._anew = [0] * count

    def forget(self) -> None:
        """There is no launch."""
        self._looking = False

    def _judge(self, told: Told, measured: Measured, expected: Sequence[float], friction: float) -> float | None:
        self._looking = False
        if not _speeds_up(told.rates, measured.speeds):
            return None
        begun, due = self._begun
        pushed = [self._pushed(index, first, now) for index, (first, now) in enumerate(zip(begun, measured.speeds))]
        self.looks += None not in pushed and _is_full(told)
        felt = self._driven(pushed, told.felt)
        slips, most, given = measured.slipping, 0.0, 0.0
        meant = [
            (impulse - self._losses.inertia * (then - before)) / self._time
            for impulse, then, before in zip(self._given, expected, due)
        ]
        for index, (first, now, torque, push) in enumerate(zip(begun, measured.speeds, pushed, meant)):
            if first is None or now is None or push * now < 0.0 or push * first < 0.0:
                continue
            sign = 1.0 if push > 0.0 else -1.0
            ahead = sign * self._ahead[index] / self._time / self._top_speeds[index]
            if torque is None:
                slips = slips or ahead > AHEAD
                continue
            pressed = self._pressed(index, felt)
            most = max(most, sign * torque / pressed)
            if self._led[index] and ahead > -BEHIND and sign * (push - torque) > SHORT * friction * pressed:
                slips, given = True, max(given, sign * torque / pressed)
        if not all(self._led) and None not in pushed:
            slips = slips or self._short(pushed, meant, told.felt, self._gained(measured.speeds, expected), friction)
        if not slips:
            return None
        self._pause = PAUSE
        given = given or most
        return min(given, friction) if given > 0.0 else BACK_OFF * friction

    def _pushed(self, index: int, first: float | None, now: float | None) -> float | None:
        """N m that came to the floor, in the mean; None: the torque is not told, or not often enough."""
        told, count = 0.0, len(self._torques)
        for torques in self._torques:
            torque = torques[index]
            if torque is None:
                return None
            told += torque
        if first is None or now is None or self._anew[index] < TOLD * count:
            return None
        mean, (inertia, friction, drag) = 0.5 * (first + now), self._losses
        drag = drag if mean > 0.0 else -drag if mean < 0.0 else 0.0
        return told / count - inertia * (now - first) / self._time - friction * mean - drag

    def _driven(self, torques: Sequence[float | None], told: Three) -> Three:
        """By which these sped the body up, m/s^2; what was told where one is not known."""
        ax = ay = 0.0
        for torque, radius, (x, y, _) in zip(torques, self._radii, self._grip.rows):
            if torque is None:
                return told
            ax, ay = ax + torque / radius * x, ay + torque / radius * y
        mass = self._grip.masses[0]
        return (ax / mass, ay / mass, told[2])

    def _gained(self, speeds: Sequence[float | None], expected: Sequence[float]) -> float:
        """Which part of what they were to gain the wheels have gained, taken together."""
        begun, due = self._begun
        along = square = 0.0
        for first, now, before, then in zip(begun, speeds, due, expected):
            if first is not None and now is not None:
                along += (now - first) * (then - before)
                square += (then - before) * (then - before)
        return along / square if square > 0.0 else 0.0

    def _short(
        self,
        pushed: Sequence[float | None],
        meant: Sequence[float],
        felt: Three,
        gained: float,
        friction: float,
    ) -> bool:
        """Whether all wheels together pushed less than it takes to gain so much of what was meant, by far."""
        size = sqrt(felt[0] * felt[0] + felt[1] * felt[1])
        if size == 0.0:
            return False
        x, y = felt[0] / size, felt[1] / size
        (ax, ay, _), (bx, by, _) = self._driven(meant, felt), self._driven(pushed, felt)
        most = 0.0
        for index, (radius, (row_x, row_y, _)) in enumerate(zip(self._radii, self._grip.rows)):
            most += friction * self._pressed(index, felt) / radius * abs(row_x * x + row_y * y)
        return gained * (ax * x + ay * y) - (bx * x + by * y) > SHORT * most / self._grip.masses[0]

    def _pressed(self, index: int, gained: Three) -> float:
        """N m with which a wheel would slip per unit of friction; a trifle for one that lifts."""
        x, y, _ = gained
        shift_x, shift_y = self._grip.shifts[index]
        load = self._grip.resting[index] + shift_x * x + shift_y * y
        return self._radii[index] * max(load, 0.01 * self._grip.resting[index])


def _is_full(told: Told) -> bool:
    """Whether a wheel pushes with nearly all that it bears."""
    return any(abs(torque) >= _FULL * bears for torque, bears in zip(told.torques, told.bears))


def _speeds_up(rates: Sequence[float], speeds: Sequence[float | None]) -> bool:
    """Whether wheels of these speeds, rad/s, gain by such rates, rad/s^2, taken together."""
    gained = 0.0
    for rate, speed in zip(rates, speeds):
        if speed is not None:
            gained += rate * speed
    return gained >= 0.0
