"""Whether a launch slips all the same, told by torques: speeds alone show little of it.

How this works
--------------
Wheels that slip under speed control turn about as they are told. But the floor then pushes a wheel back by less than
its share of the push, though it is not behind its setpoint, as one would be whose motor cannot. Where no torque is told
the wheel must run ahead. What the floor gave is the impulse of the motors less what the wheels took for themselves: a
speed loop that has lost the inertia of the robot swings, so that no single torque tells.
Only while the robot speeds up: of one that is braked it is not known as well what resists it. And once the friction is
taken for less the wheels have time to grip again, or the end of one slip would be taken for another.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.control.drive_law import Measured
from gateway.control.grip import Grip, Three

SHORT: Final = 0.15  # of its grip, by which a wheel that slips is pushed back less than it is to push
BEHIND: Final = 0.01  # of top speed: a wheel further behind its setpoint lacks torque
AHEAD: Final = 0.01  # of top speed, by which a wheel that slips runs ahead, where no torque is told
LOOK_TIME: Final = 0.04  # s, from one look to the next
PAUSE: Final = 0.12  # s, after one that found slip
BACK_OFF: Final = 0.85  # of the friction, where what the floor gave is not known


class Losses(NamedTuple):
    """What a motor's torque goes into before the floor feels it: kg m^2, N m s/rad and N m at its output."""

    inertia: float
    friction: float
    drag: float


class Told(NamedTuple):
    """Of a cycle that pushed: N m of each wheel, the acceleration of the body and, rad/s^2, of the wheels.

    `launch`: the floor is what limits it, and not a stop that nobody commanded.
    """

    torques: tuple[float, ...]
    gained: Three
    rates: tuple[float, ...]
    launch: bool


class _Wheel:
    """State owner: one wheel since the look began. The sums are over time."""

    __slots__ = ("ahead", "begun", "known", "push", "torque")

    def __init__(self) -> None:
        self.begun: float | None = None  # rad/s
        self.known = True  # its torque
        self.torque = self.push = self.ahead = 0.0  # N m s told and meant for the floor, rad

    def begin(self, speed: float | None) -> None:
        """Nothing has been yet."""
        self.begun, self.known = speed, True
        self.torque = self.push = self.ahead = 0.0


class LaunchSlip:
    """State owner: what the wheels did in this look at them, one after the other while there is a launch."""

    def __init__(self, grip: Grip, *, radii: Sequence[float], losses: Losses, top_speeds: Sequence[float]) -> None:
        """`radii` m; `top_speeds` rad/s."""
        self._grip = grip
        self._radii = tuple(radii)
        self._losses = losses
        self._top_speeds = tuple(top_speeds)
        self._wheels = tuple([_Wheel() for _ in radii])
        self._looking = False
        self._time = 0.0  # s, of this look
        self._pause = 0.0  # s, until the next

    def look(self, told: Told, expected: Sequence[float], measured: Measured, friction: float) -> float | None:
        """What friction the floor gave, where wheels slipped; `expected`: rad/s that they should turn."""
        dt, inertia = measured.dt, self._losses.inertia
        self._pause = max(0.0, self._pause - dt)
        if self._pause > 0.0 or not _speeds_up(told.rates, measured.speeds):
            self._looking = False
            return None
        if not self._looking:
            self._looking, self._time = True, 0.0
            for wheel, speed in zip(self._wheels, measured.speeds):
                wheel.begin(speed)
            return None
        self._time += dt
        for index, wheel in enumerate(self._wheels):
            speed, torque = measured.speeds[index], measured.torques[index]
            wheel.push += dt * (told.torques[index] - inertia * told.rates[index])
            if torque is None:
                wheel.known = False
            else:
                wheel.torque += dt * torque
            if speed is not None:
                wheel.ahead += dt * (speed - expected[index])
        return self._judge(told.gained, measured, friction) if self._time >= LOOK_TIME else None

    def forget(self) -> None:
        """There is no launch."""
        self._looking = False

    def _judge(self, gained: Three, measured: Measured, friction: float) -> float | None:
        slips, given = measured.slipping, 0.0
        for index, wheel in enumerate(self._wheels):
            speed, pressed = measured.speeds[index], self._pressed(index, gained)
            if wheel.begun is None or speed is None or wheel.push * speed < 0.0:
                continue
            sign = 1.0 if wheel.push > 0.0 else -1.0
            ahead = sign * wheel.ahead / self._time / self._top_speeds[index]
            if not wheel.known:
                slips = slips or ahead > AHEAD
                continue
            pushed = sign * (wheel.torque - self._losses.inertia * (speed - wheel.begun)) / self._time
            pushed -= self._losses.drag + self._losses.friction * abs(speed)
            given = max(given, pushed / pressed)
            short = sign * wheel.push / self._time - pushed
            slips = slips or (ahead > -BEHIND and short > SHORT * friction * pressed)
        self._looking = False
        if not slips:
            return None
        self._pause = PAUSE
        return min(given, friction) if given > 0.0 else BACK_OFF * friction

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
