"""A body that leans over the axle of its wheels, and whether gains keep it upright.

How this works
--------------
About the upright, pitch th (forward is positive) and the speed v of the axle, with wheels of radius r that push the
floor back with what they push the body back:

    a th'' = c th - b v',   a = I + m l^2 + r m l,   b = m l + r m,   c = m g l

m, l and I are mass, height above the axle and inertia of the robot (rotors turn against the body: theirs is within).
The wheels are told

    v = v0 + Kp (th - th0) + Kd th' + kv (v - v0) + ki (integral of v - v0),   th0 = (b / c) v0'

which has its poles where ((1 - kv) s - ki)(a s^2 - c) + b s^2 (Kp + Kd s) = 0. By Routh they are stable if and only if

    kv > 1,   ki > 0,   b Kd > a (kv - 1),   b Kp > a ki,   (b Kp - a ki)(kv - 1) > (b Kd - a (kv - 1)) ki:

the speed must be fed back positively. Source: arXiv 2407.10127 (balance by PD of the pitch and PI of the velocity); the
conditions are derived, there are none in print. The torques of the wheels on the body are ours to add.
"""

from math import sqrt
from typing import Final, NamedTuple

GRAVITY: Final = 9.80665  # m/s^2
_LONGEST: Final = 5.0  # s that are looked at
_SETTLED: Final = 1.0  # s of them, at their end, in which it has to stand
_STEPS: Final = 8  # of each cycle
_QUICK: Final = 0.25  # of the longest lag
_FAR: Final = 1.5  # rad: it has fallen, whatever comes after


class BalanceError(ValueError):
    """A robot that would not stay upright; the text names key, value and range."""


class Pendulum(NamedTuple):
    """a, kg m^2; b, kg m; c, N m/rad: as above."""

    inertia: float
    coupling: float
    gravity: float

    def lean(self, acceleration: float) -> float:
        """Pitch at which it speeds up by so many m/s^2 without falling, rad."""
        return self.coupling / self.gravity * acceleration


def pendulum(*, mass: float, height: float, pitch_inertia: float, radius: float) -> Pendulum:
    """Of a body, kg, m and kg m^2 about its centre of mass, on wheels of this radius, m."""
    moment = mass * height
    return Pendulum(
        inertia=pitch_inertia + moment * height + radius * moment,
        coupling=moment + radius * mass,
        gravity=moment * GRAVITY,
    )


class BalanceGains(NamedTuple):
    """m/s per rad; m per rad; 1; 1/s."""

    pitch: float
    pitch_rate: float
    velocity: float
    position: float


def objection(gains: BalanceGains, body: Pendulum) -> str | None:
    """Why these gains do not balance this body, with the range of what is wrong; None: they do, on ideal wheels."""
    a, b, _ = body
    kp, kd, kv, ki = gains
    if kv <= 1.0:
        return f"velocity = {kv:g}: must be above 1: only a speed that is fed back positively balances"
    if ki <= 0.0:
        return f"position = {ki:g}: must be above 0"
    if b * kd <= a * (kv - 1.0):
        return f"pitch_rate = {kd:g}: must be above {a * (kv - 1.0) / b:.4g} for this body and this velocity"
    if b * kp <= a * ki:
        return f"pitch = {kp:g}: must be above {a * ki / b:.4g} for this body and this position"
    least = (a * ki + (b * kd - a * (kv - 1.0)) * ki / (kv - 1.0)) / b
    if kp <= least:
        return f"pitch = {kp:g}: must be above {least:.4g} for this body and the other gains"
    return None


class Standing(NamedTuple):
    """A body, kg, that is kept upright by wheels of this radius, m, from a pitch of `catch`, rad.

    `lag`: time constant by which the wheels follow, s; `delay`: age of what is known of its pitch, s; both at worst.
    """

    gains: BalanceGains
    body: Pendulum
    radius: float
    mass: float
    catch: float
    lag: float
    delay: float

    def reserve(self, acceleration: float) -> float:
        """M/s by which the wheels must be able to outrun what is commanded.

        To catch it, and to lean it from speeding up to slowing down by so many m/s^2 in the time it takes to fall.
        """
        return max(self.gains.pitch * self.catch, 2.0 * acceleration * sqrt(self.body.inertia / self.body.gravity))


def unfit(
    robot: Standing, *, speed: float, acceleration: float, wheel_speed: float, push: float, period: float, delay: float
) -> str | None:
    """Why it cannot catch itself, with the range of what is wrong; None: it can.

    `speed`, m/s, and `acceleration`, m/s^2: that may be commanded; `wheel_speed`: rad/s that the wheels can turn;
    `push`: N of all together.
    """
    most = robot.radius * wheel_speed - robot.reserve(acceleration)
    if speed > most:
        return (
            f"limits.velocity.vx = {speed:g}: must be at most {max(most, 0.0):.3g} m/s, so that the wheels can"
            f" outrun it by {robot.reserve(acceleration):.3g} m/s to catch it"
        )
    needed = robot.mass * robot.catch * robot.body.gravity / robot.body.coupling
    if push < needed:
        return (
            f"catch = {robot.catch:g}: must be at most {robot.catch * push / needed:.3g}: the wheels push with"
            f" {push:.3g} N, and to catch it takes {needed:.3g} N"
        )
    for lag in (robot.lag, _QUICK * robot.lag):  # quick wheels answer what is old too soon
        if recovery(robot, lag=lag, period=period, delay=delay) is None:
            return (
                f"these gains do not catch it from catch = {robot.catch:g} rad, with a loop of {1.0 / period:g} Hz,"
                f" wheels that follow by {lag:g} s and a pitch that is delay = {robot.delay:g} s old: weaker gains, a"
                " faster loop or sensor, or less to catch"
            )
    return None


def recovery(robot: Standing, *, lag: float, period: float, delay: float) -> float | None:
    """Seconds until it leans for good a tenth of what it was let go at, at rest; None: it falls, or swings on.

    `lag`: time constant by which the wheels follow, s; `delay`: age of their speed, s; `period`: of the loop, s.
    """
    step = period / _STEPS
    leaning_late, rolling_late = int(robot.delay / step + 0.5), int(delay / step + 0.5)
    now, way, left = _State(robot.catch, 0.0, 0.0), 0.0, 0.0
    past = [now]  # of each step
    for cycle in range(int(_LONGEST / period)):
        last = len(past) - 1
        leaning, speed = past[max(last - leaning_late, 0)], past[max(last - rolling_late, 0)].speed
        way += speed * period
        told = _told(robot.gains, _State(leaning.pitch, leaning.rate, speed), way)
        for _ in range(_STEPS):
            now = _after(robot.body, now, told, lag, step)
            past.append(now)
        if abs(now.pitch) > _FAR:
            return None
        if abs(now.pitch) >= 0.1 * robot.catch:
            left = (cycle + 1) * period
    return left if left < _LONGEST - _SETTLED else None


class _State(NamedTuple):
    pitch: float
    rate: float
    speed: float


def _told(gains: BalanceGains, seen: _State, way: float) -> float:
    """M/s that the wheels are told at rest."""
    kp, kd, kv, ki = gains
    return kp * seen.pitch + kd * seen.rate + kv * seen.speed + ki * way


def _after(body: Pendulum, now: _State, told: float, lag: float, step: float) -> _State:
    """A step later."""
    change = (told - now.speed) / lag
    rate = now.rate + step * (body.gravity * now.pitch - body.coupling * change) / body.inertia
    return _State(now.pitch + step * rate, rate, now.speed + step * change)
