"""What a motor's own numbers say against it: five detectors, each blind to what the others see.

How this works
--------------
Each cycle a motor is a `Sample`; each detector looks at the samples of one motor and answers in words once it is sure.
| detector | sees | does not mistake for it |
|---|---|---|
| stall | torque at its limit, and no motion: a wall, a jam | a slow motor, a heavy robot |
| frozen encoder | the very same position again and again, where the wheel must be turning | a wheel at rest |
| runaway | moves on beyond its setpoint, faster and faster: a wrong sign | an impact, a slope, a lag |
| reversed | a wheel goes against all its torque, with the others in tow: a wrong sign | a push, a slope, a load |
| following | far from its setpoint with torque to spare | torque at its limit: that is overload, no fault |
Slip is no fault of a motor and is seen from all wheels together (`gateway.core.slip`).
Only samples that are new count where a position is compared: a lost frame is no standing wheel.
"""

from collections.abc import Callable, Sequence
from math import copysign, inf
from typing import Final

AT_LIMIT: Final = 0.8  # of the torque limit, from which a motor is taken to give all it has

STALL_TIME: Final = 0.25  # s
STALL_WAY: Final = 0.02  # s at top speed: the way that was commanded and not gone
STALL_BLIND_FACTOR: Final = 2.0  # times that, where the controller does not tell its torque
STALL_SPEED: Final = 0.1  # of the setpoint; slower counts as no motion
CRAWL_SPEED: Final = 0.05  # of top speed: slower, with all its torque for CRAWL_TIME, is no driving either
CRAWL_TIME: Final = 1.0  # s
LEAST_SETPOINT: Final = 0.01  # of top speed; below it nothing is asked of the motor

FREEZE_FROM: Final = 0.1  # of top speed: from there no brake stops a wheel within FREEZE_TIME ...
FREEZE_FROM_DRIVING: Final = 0.03  # ... and from there no ramp does
FREEZE_TIME: Final = 0.012  # s
FREEZE_SAMPLES: Final = 3
FREEZE_STRAIN: Final = 0.3  # of the torque limit, which no wheel bears without the slightest motion ...
FREEZE_STRAIN_TIME: Final = 0.15  # ... for so long, s
FREEZE_DRIFT: Final = 0.02  # of the torque limit, by which none that is to stand changes its torque without motion ...
FREEZE_DRIFT_TIME: Final = 0.3  # ... for so long, s
FREEZE_EXPECTED: Final = 0.05  # of top speed, by which the other wheels say that it turns ...
FREEZE_EXPECTED_TIME: Final = 0.04  # ... for so long, s

RUNAWAY_TIME: Final = 0.05  # s; an impact is over by then
RUNAWAY_SAMPLES: Final = 6  # in a row; after a pause of the loop a single one may cover much time
RUNAWAY_GROWTH: Final = 0.05  # of top speed, beyond the setpoint
RUNAWAY_RATE: Final = 0.8  # top speeds per second; a slope or a push is slower

REVERSED_WORK: Final = 0.015  # of torque limit times top speed, that went into slowing down against the torque ...
REVERSED_TIME: Final = 0.1  # ... within about so long, s
REVERSED_STRAIN_TIME: Final = 0.05  # s with all its torque, moving against it all the while; an impact is over by then
REVERSED_NOISE: Final = 0.0005  # of top speed, by which two measurements may differ the other way
REVERSED_ERROR: Final = 0.04  # of top speed, by which the wheel is off its setpoint by then
REVERSED_MEMORY: Final = 1.0  # s, in which no other wheel strained for longer ...
REVERSED_BURDEN: Final = 0.15  # s ... nor the wheel itself for so long: an overload goes round as the robot turns
REVERSED_RATIO: Final = 2.0  # times the work of any other wheel; what acts on the body acts on two wheels alike

FOLLOWING_TOLERANCE: Final = 0.3  # of top speed
FOLLOWING_TIME: Final = 0.5  # s


class Sample:
    """One motor in one cycle, at its output. Nobody changes it.

    `setpoint`: rad/s that it was last asked for, None: released. `torque`: N m; None: the controller does not tell.
    `fresh`: whether a measurement arrived since the last cycle. `driving`: whether the robot is meant to move; else it
    brakes or is released. `expected`: its speed as the other wheels have it.
    No named tuple: compiled, each is made and read in a third of the time, and every cycle reads a hundred fields.
    """

    __slots__ = ("driving", "dt", "expected", "fresh", "position", "setpoint", "speed", "torque")

    def __init__(
        self,
        setpoint: float | None,
        speed: float | None,
        position: float | None,
        torque: float | None,
        *,
        fresh: bool,
        driving: bool,
        dt: float,
        expected: Callable[[], float | None],
    ) -> None:
        self.setpoint: Final = setpoint
        self.speed: Final = speed
        self.position: Final = position
        self.torque: Final = torque
        self.fresh: Final = fresh
        self.driving: Final = driving
        self.dt: Final = dt
        self.expected: Final = expected


class Limits:
    """What the motor can: rad/s and N m at its output. Nobody changes it; no named tuple, see `Sample`."""

    __slots__ = ("speed", "torque")

    def __init__(self, speed: float, torque: float) -> None:
        self.speed: Final = speed
        self.torque: Final = torque

    def strained(self, torque: float | None) -> bool:
        """Whether the motor gives all it has; None is not known to."""
        return torque is not None and abs(torque) >= AT_LIMIT * self.torque


class Detector:
    """One of those that look at one motor. No protocol: compiled, a call by one takes twice as long."""

    def look(self, x: Sample) -> str | None:
        """Take the sample of a cycle; what is wrong, in words, once that is sure."""
        raise NotImplementedError


class StallDetector(Detector):
    """Torque at its limit, and no motion, or for long hardly any: then wheels may work against each other."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._time = self._way = 0.0
        self._crawl = 0.0

    def look(self, x: Sample) -> str | None:
        limits, setpoint, speed = self._limits, x.setpoint, x.speed
        if (
            not x.driving
            or setpoint is None
            or speed is None
            or abs(setpoint) < LEAST_SETPOINT * limits.speed
            or not (x.torque is None or limits.strained(x.torque))
        ):
            self._time = self._way = self._crawl = 0.0
            return None
        if x.torque is not None and self._crawls(speed, x.dt):
            return f"hardly moves, {speed:.2f} rad/s, with {x.torque:.1f} N m for {CRAWL_TIME:g} s"
        return self._stands(setpoint, speed, x.torque, x.dt)

    def _crawls(self, speed: float, dt: float) -> bool:
        self._crawl = self._crawl + dt if abs(speed) < CRAWL_SPEED * self._limits.speed else 0.0
        return self._crawl >= CRAWL_TIME

    def _stands(self, setpoint: float, speed: float, torque: float | None, dt: float) -> str | None:
        if abs(speed) > STALL_SPEED * abs(setpoint):
            self._time = self._way = 0.0
            return None
        self._time += dt
        self._way += abs(setpoint) * dt
        patience = STALL_BLIND_FACTOR if torque is None else 1.0
        if self._time < patience * STALL_TIME or self._way < patience * STALL_WAY * self._limits.speed:
            return None
        if torque is None:
            return f"stands still where {setpoint:.2f} rad/s is commanded"
        return f"stands still against {torque:.1f} N m where {setpoint:.2f} rad/s is commanded"


class FrozenEncoderDetector(Detector):
    """The very same position again and again, where the wheel must be turning."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._position: float | None = None
        self._torque: float | None = None  # N m when the position last changed
        self._speed = self._speed_before = 0.0  # rad/s at the last two changes of position: the last may be frozen
        self._samples = 0
        self._time = 0.0
        self._strained = self._drifted = self._contradicted = 0.0

    def look(self, x: Sample) -> str | None:
        if x.position is None or x.speed is None or x.setpoint is None:
            self._position = None
            return None
        self._time += x.dt
        if not x.fresh:
            return None
        if x.position != self._position:
            self._position, self._speed_before, self._speed = x.position, self._speed, x.speed
            self._torque = x.torque
            self._time = 0.0
            if self._samples:  # else none of these was counted
                self._samples = 0
                self._strained = self._drifted = self._contradicted = 0.0
            return None
        self._samples += 1
        return self._judge(x)

    def _judge(self, x: Sample) -> str | None:
        top, moved = self._limits.speed, max(self._speed_before, self._speed, key=abs)
        fast = abs(moved) > (FREEZE_FROM_DRIVING if x.driving else FREEZE_FROM) * top
        if fast and self._samples >= FREEZE_SAMPLES and self._time >= FREEZE_TIME:
            return f"stopped dead from {moved:.2f} rad/s: its encoder is frozen, or the robot hit something"
        asked = abs(x.setpoint or 0.0) >= LEAST_SETPOINT * top
        text = self._rigid(x, asked=asked)
        if text is not None:
            return text
        if not asked or self._samples < FREEZE_SAMPLES:
            self._contradicted = 0.0
            return None
        expected = x.expected()
        if expected is None or abs(expected) < FREEZE_EXPECTED * top:
            self._contradicted = 0.0
            return None
        self._contradicted += x.dt
        if self._contradicted < FREEZE_EXPECTED_TIME:
            return None
        return f"encoder frozen: by the other wheels it turns at {expected:.2f} rad/s"

    def _rigid(self, x: Sample, *, asked: bool) -> str | None:
        """Whether it does not move at all under its torque, or while a joint that is to stand winds its torque up."""
        if x.torque is None:
            self._strained = self._drifted = 0.0
            return None
        strains = asked and abs(x.torque) >= FREEZE_STRAIN * self._limits.torque
        self._strained = self._strained + x.dt if strains else 0.0
        if self._strained >= FREEZE_STRAIN_TIME:
            return f"encoder frozen: not the slightest motion under {x.torque:.1f} N m"
        known = x.driving and not asked and self._torque is not None
        drifts = known and abs(x.torque - (self._torque or 0.0)) >= FREEZE_DRIFT * self._limits.torque
        self._drifted = self._drifted + x.dt if drifts else 0.0
        if self._drifted >= FREEZE_DRIFT_TIME:
            return (
                f"no motion while its torque went to {x.torque:.1f} N m: its encoder is frozen, or that does not arrive"
            )
        return None


class RunawayDetector(Detector):
    """Moves on beyond its setpoint, faster and faster."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._speed = self._error = inf  # sizes of both in the last new sample; infinite: nothing grows beyond it
        self._begun = self._begun_speed = 0.0  # error and speed when they began to grow
        self._time = 0.0
        self._samples = 0

    def look(self, x: Sample) -> str | None:
        setpoint, speed = x.setpoint, x.speed
        if setpoint is None or speed is None:
            self._speed = self._error = inf
            return None
        self._time += x.dt
        if not x.fresh:
            return None
        beyond = (speed - setpoint) * speed > 0.0
        size, error = abs(speed), abs(speed - setpoint)
        grows = beyond and error > self._error and size > self._speed
        self._speed, self._error = size, error
        if not grows:
            self._begun, self._begun_speed, self._time, self._samples = error, size, 0.0, 0
            return None
        self._samples += 1
        if self._samples < RUNAWAY_SAMPLES:
            return None
        # Of both: an error that grows because the setpoint goes away, as into an emergency stop, is not the motor's.
        growth, top = min(size - self._begun_speed, error - self._begun), self._limits.speed
        if self._time < RUNAWAY_TIME or growth < max(RUNAWAY_GROWTH, RUNAWAY_RATE * self._time) * top:
            return None
        return f"runs away: {speed:.2f} rad/s and rising where {setpoint:.2f} rad/s is commanded"


class ReversedDetector:
    """One wheel moves against all its torque, far more than any other: looks at all wheels of the robot together.

    Only for wheels that carry redundancy: what pushes the body then shows on two wheels at least.
    """

    def __init__(self, limits: Sequence[Limits]) -> None:
        self._wheels = [_AgainstTorque(one) for one in limits]

    def look(self, samples: Sequence[Sample]) -> tuple[int, str] | None:
        """Take the samples of a cycle; which motor it is and what is wrong, once that is sure."""
        wheels = self._wheels
        known = True
        worst, most, other = 0, -inf, -inf  # the wheel with the most work, and the next most
        dt = samples[0].dt if samples else 0.0
        work_kept, burden_kept = max(0.0, 1.0 - dt / REVERSED_TIME), max(0.0, 1.0 - dt / REVERSED_MEMORY)
        for index, wheel in enumerate(wheels):
            known = wheel.take(samples[index], work_kept=work_kept, burden_kept=burden_kept) and known
            work = wheel.work
            if work > most:
                worst, most, other = index, work, most
            elif work > other:
                other = work
        if not known or most < REVERSED_WORK or most < REVERSED_RATIO * other:
            return None
        x, suspect = samples[worst], wheels[worst]
        if suspect.strained < REVERSED_STRAIN_TIME or suspect.error < REVERSED_ERROR:
            return None
        if suspect.burden > REVERSED_BURDEN:
            return None
        if any(wheel.burden >= suspect.burden for wheel in wheels if wheel is not suspect):
            return None
        return worst, f"turns at {x.speed:.2f} rad/s, away from its torque of {x.torque:.1f} N m: its sign is wrong"


class _AgainstTorque:
    """One wheel of those. `work` is of torque limit times top speed, `error` of top speed, the others are s."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._speed: float | None = None
        self.work = self.error = self.strained = self.burden = 0.0

    def take(self, x: Sample, *, work_kept: float, burden_kept: float) -> bool:
        """Whether everything is known that is needed. The shares are those that fading leaves in this cycle."""
        speed, torque = x.speed, x.torque
        if not x.driving or x.setpoint is None or speed is None or torque is None:
            self._speed, self.work, self.strained, self.burden = None, 0.0, 0.0, 0.0
            return False
        limits, strains = self._limits, self._limits.strained(torque)
        self.work *= work_kept
        self.strained += x.dt
        self.burden *= burden_kept
        if strains:
            self.burden += x.dt
        if not x.fresh:
            return True
        before, self._speed = self._speed, speed
        gained = 0.0 if before is None else (speed - before) / limits.speed
        self.work -= gained * torque / limits.torque
        self.error = abs(x.setpoint - speed) / limits.speed
        if not strains or gained * copysign(1.0, torque) > REVERSED_NOISE:
            self.strained = 0.0
        return True


class FollowingDetector(Detector):
    """Far from its setpoint, with torque to spare."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._time = 0.0

    def look(self, x: Sample) -> str | None:
        if (
            not x.driving
            or x.setpoint is None
            or x.speed is None
            or abs(x.setpoint - x.speed) <= FOLLOWING_TOLERANCE * self._limits.speed
            or self._limits.strained(x.torque)
        ):
            self._time = 0.0
            return None
        self._time += x.dt
        if self._time < FOLLOWING_TIME:
            return None
        return f"turns at {x.speed:.2f} rad/s where {x.setpoint:.2f} rad/s is commanded"
