"""Whether a launch slips all the same, told by torques: speeds alone show little of it.

How this works
--------------
Wheels that slip under speed control turn about as they are told. But the floor then pushes a wheel back by less than
its share of the push, though it is not behind its setpoint, as one would be whose motor cannot. Where no torque is told
the wheel must run ahead. What the floor gave is the impulse of the motors less what the wheels took for themselves: a
speed loop that has lost the inertia of the robot swings, so that no single torque tells.
Only while the robot speeds up straight on: in a curve shares change all the time, and of one that is braked it is not
known as well what resists it. And once the friction is taken for less the wheels have time to grip again, or the end of
one slip would be taken for another. Nor after a late cycle, which is no slip either.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.control.drive_law import Measured
from gateway.control.grip import Grip, Push, Three

SHORT: Final = 0.2  # of its grip, by which a wheel that slips is pushed back less than it is to push
BEHIND: Final = 0.01  # of top speed: a wheel further behind its setpoint lacks torque
AHEAD: Final = 0.01  # of top speed, by which a wheel that slips runs ahead, where no torque is told
LOOK_TIME: Final = 0.04  # s, from one look to the next
TOLD: Final = 0.4  # of the cycles in which a torque must be another one: many tell it more seldom than speed
PAUSE: Final = 0.12  # s, after one that found slip, and after a late cycle
LATE: Final = 1.5  # periods of the loop: meanwhile the motors went on with what they were told before
MOTOR_SHARE: Final = 0.98  # of a motor's torque that a launch takes; the rest is for its speed control and friction
_LEAST: Final = 1e-3  # N m
BACK_OFF: Final = 0.85  # of the friction, where what the floor gave is not known


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
        self, grip: Grip, *, radii: Sequence[float], losses: Losses, top_speeds: Sequence[float], period: float
    ) -> None:
        """`radii` m; `top_speeds` rad/s; `period` s, of the loop."""
        self._grip = grip
        self._radii = tuple(radii)
        self._losses = losses
        self._top_speeds = tuple(top_speeds)
        self._longest = LATE * period
        self._looking = False
        self._pause = 0.0  # s, until the next look
        self._given: list[float] = []  # N m s meant for wheel and floor
        self._ahead: list[float] = []  # rad
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
        given, ahead = self._given, self._ahead
        for place, (torque, is_, due) in enumerate(zip(told.torques, measured.speeds, expected)):
            given[place] += dt * torque
            if is_ is not None:
                ahead[place] += dt * (is_ - due)
        return self._judge(told, measured, expected, friction) if self._time >= LOOK_TIME else None

    def _begin(self, speeds: Sequence[float | None], expected: Sequence[float]) -> None:
        """Nothing has been yet. The sums are over time."""
        count = len(self._radii)
        self._time = 0.0  # s
        self._begun = tuple(speeds), tuple(expected)  # rad/s that the wheels turned, and were to
        self._torques: list[tuple[float | None, ...]] = []  # N m told
        self._given, self._ahead = [0.0] * count, [0.0] * count

    def forget(self) -> None:
        """There is no launch."""
        self._looking = False

    def _judge(self, told: Told, measured: Measured, expected: Sequence[float], friction: float) -> float | None:
        self._looking = False
        if not _speeds_up(told.rates, measured.speeds):
            return None
        begun, due = self._begun
        pushed = [self._pushed(index, first, now) for index, (first, now) in enumerate(zip(begun, measured.speeds))]
        felt = self._driven(pushed, told.felt)
        slips, most, given = measured.slipping, 0.0, 0.0
        for index, (first, now, torque) in enumerate(zip(begun, measured.speeds, pushed)):
            push = (self._given[index] - self._losses.inertia * (expected[index] - due[index])) / self._time
            if first is None or now is None or push * now < 0.0 or push * first < 0.0:
                continue
            sign = 1.0 if push > 0.0 else -1.0
            ahead = sign * self._ahead[index] / self._time / self._top_speeds[index]
            if torque is None:
                slips = slips or ahead > AHEAD
                continue
            pressed = self._pressed(index, felt)
            most = max(most, sign * torque / pressed)
            if ahead > -BEHIND and sign * (push - torque) > SHORT * friction * pressed:
                slips, given = True, max(given, sign * torque / pressed)
        if not slips:
            return None
        self._pause = PAUSE
        given = given or most
        return min(given, friction) if given > 0.0 else BACK_OFF * friction

    def _pushed(self, index: int, first: float | None, now: float | None) -> float | None:
        """N m that came to the floor, in the mean; None: the torque is not told, or not often enough."""
        told, anew, last = 0.0, 0, None
        for torques in self._torques:
            torque = torques[index]
            if torque is None:
                return None
            told, anew, last = told + torque, anew + (torque != last), torque
        count = len(self._torques)
        if first is None or now is None or anew < TOLD * count:
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

    def _pressed(self, index: int, gained: Three) -> float:
        """N m with which a wheel would slip per unit of friction; a trifle for one that lifts."""
        x, y, _ = gained
        shift_x, shift_y = self._grip.shifts[index]
        load = self._grip.resting[index] + shift_x * x + shift_y * y
        return self._radii[index] * max(load, 0.01 * self._grip.resting[index])


def _speeds_up(rates: Sequence[float], speeds: Sequence[float | None]) -> bool:
    """Whether wheels of these speeds, rad/s, gain by such rates, rad/s^2, taken together."""
    gained = 0.0
    for rate, speed in zip(rates, speeds):
        if speed is not None:
            gained += rate * speed
    return gained >= 0.0
