"""Wheels that slip are led back to speeds that fit the motion of the body, on top of their speed control.

How this works
--------------
Rojas 2005, section 10: what no rigid motion explains of the wheels' speeds only wastes energy, so it is taken off the
speeds that they are told. Of a wheel that is known to slip that is all by which it is ahead of the body; where it is
not known which one, the residual of each, which together are the nearest speeds that fit. The correction comes and
goes with a time constant and at a bounded rate, so that neither its beginning nor its end is a step, and it is never
more than SHARE of what a wheel is told: it turns no wheel round and moves none that is to stand. On the way to rest it
speeds nothing up.
A speed loop that is right for a wheel which carries its share of the robot is much too stiff for one that turns freely:
it throws that to and fro with all its torque. So while the robot drives, the torque of a wheel that is known to slip is
bounded as well, by what moves its rim by STEP in a cycle. Not of one that stands where it is to turn: what holds it may
be no lack of grip, and a stall is seen by its torque.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from drivers.setpoint import CommandKind
from gateway.control.drive_law import JointCommand

TIME_CONSTANT: Final = 0.05  # s; source: ours, five periods of a slow loop, so that the speed loop is the faster one
RATE: Final = 2.0  # top speeds per second
SHARE: Final = 0.5
NOTHING: Final = 1e-3  # rad/s below which a correction that ends is over
STEP: Final = 0.05  # m/s
RELEASE: Final = 0.1  # s in which the bound of the torque goes up to all that there is
STANDS: Final = 0.1  # of what it is told, below which a wheel stands ...
STANDS_TIME: Final = 0.05  # ... for so long, s
_VELOCITY: Final = CommandKind.VELOCITY


class Wheel(NamedTuple):
    """`radius`: m; `top_speed`: rad/s; `torque`: N m, None where its speed loop takes no bound; `inertia`: kg m^2."""

    radius: float
    top_speed: float
    torque: float | None
    inertia: float


class SlipCorrection:
    """One writer, the engine. `period`: of its cycles, s."""

    def __init__(self, wheels: Sequence[Wheel], period: float) -> None:
        self._wheels = tuple(wheels)
        self._bounds = tuple([wheel.inertia * STEP / (wheel.radius * period) for wheel in wheels])  # N m
        self._taken = [0.0] * len(self._wheels)  # rad/s off what each wheel is told
        self._limits: list[float | None] = [None] * len(self._wheels)  # N m
        self._stood = [0.0] * len(self._wheels)  # s
        self.active = False

    def corrected(
        self,
        commands: tuple[JointCommand, ...],
        ahead: Sequence[float],
        slipping: Sequence[int],
        speeds: Sequence[float | None],
        *,
        braking: bool,
        dt: float,
    ) -> tuple[JointCommand, ...]:
        """The commands with the correction. `ahead`: m/s at the rim of each wheel, empty while none slips.

        `slipping`: places of the wheels that are known to; `speeds`: rad/s that are measured.
        """
        told: list[JointCommand] = []
        for place, (wheel, command) in enumerate(zip(self._wheels, commands)):
            if command.kind is not _VELOCITY:
                self._taken[place], self._limits[place] = 0.0, None
                told.append(command)
                continue
            taken = self._take(place, command.value, ahead[place] if ahead else 0.0, braking=braking, dt=dt)
            limit = self._limit(place, command.value, speeds[place], slips=place in slipping and not braking, dt=dt)
            if taken == 0.0 and limit is None:
                told.append(command)
                continue
            top = wheel.top_speed
            value = max(-top, min(top, command.value - taken))
            told.append(JointCommand(_VELOCITY, value, command.feed_forward, _less(command.limit, limit)))
        self.active = any(self._taken) or self._limits.count(None) < len(self._limits)
        return tuple(told)

    def _take(self, place: int, speed: float, ahead: float, *, braking: bool, dt: float) -> float:
        """Rad/s off this speed."""
        wheel, before = self._wheels[place], self._taken[place]
        wanted, most = ahead / wheel.radius, RATE * wheel.top_speed * dt
        taken = before + max(-most, min(most, (wanted - before) * min(1.0, dt / TIME_CONSTANT)))
        bound = SHARE * abs(speed)
        taken = max(-bound, min(bound, taken))
        if (braking and taken * speed < 0.0) or (wanted == 0.0 and -NOTHING < taken < NOTHING):
            taken = 0.0
        self._taken[place] = taken
        return taken

    def _limit(self, place: int, told: float, speed: float | None, *, slips: bool, dt: float) -> float | None:
        """N m that the wheel may use; None: all that it has."""
        stands = speed is None or abs(speed) < STANDS * abs(told)
        self._stood[place] = self._stood[place] + dt if stands else 0.0
        slips = slips and self._stood[place] < STANDS_TIME
        most, before, bound = self._wheels[place].torque, self._limits[place], self._bounds[place]
        if most is None or bound == 0.0 or (before is None and not slips):
            return None
        limit: float | None = bound if slips or before is None else before + most * dt / RELEASE
        if limit is not None and limit >= most:
            limit = None
        self._limits[place] = limit
        return limit


def _less(one: float | None, other: float | None) -> float | None:
    if one is None or other is None:
        return one if other is None else other
    return min(one, other)
