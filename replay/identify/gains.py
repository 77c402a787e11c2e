"""Gains of the host's speed loop from how a motor answers, by a rule with a margin that is stated.

How this works
--------------
The loop is L(s) = (kp + ki / s) e^(-s D) / (J s), where D is the delay of the motor and half a period, for which a
torque is held on the average. J is anything between `light`, a wheel in the air, and `heavy`, one that carries its
share of the robot the heaviest way. Friction is left out: it only adds phase and takes gain. The phase margin is

    90 deg - atan(ki / (kp w)) - w D

at the crossover w, convex in w, so the least of it is at one of the two ends. ki / kp is a quarter of the heavy end's
crossover, kp / heavy, which takes 14 deg there; kp is what leaves PHASE_MARGIN at the light end. At the heavy end it is
at least as much, and the gain margin is at least pi / 2 over pi / 6, which is GAIN_MARGIN, with any delay (Astrom and
Murray, Feedback Systems, 2008, 9.3).
"""

from math import atan, atan2, degrees, hypot, pi, radians
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from replay.identify.fit import Array
from replay.identify.response import STEP_S, Response

PHASE_MARGIN = radians(60.0)
GAIN_MARGIN = 3.0
ZERO = 0.25  # of the heavy end's crossover: ki / kp
DIGITS = 3
_SLOWEST, _FASTEST = 1e-4, 1e5  # rad/s, between which crossovers are looked for


class Gains(NamedTuple):
    """At the output: N m per rad/s, N m per rad."""

    kp: float
    ki: float


class Margins(NamedTuple):
    """`phase`: deg at `crossover`, rad/s; `gain`: by so much kp and ki could be more."""

    phase: float
    gain: float
    crossover: float


def gains(light: float, heavy: float, *, delay: float, period: float) -> Gains:
    """By the rule, for kg m^2 at the output, s; `heavy` at least `light`."""
    ratio = ZERO * light / heavy
    crossover = (pi / 2.0 - PHASE_MARGIN - atan(ratio)) / total_delay(delay, period)
    kp = light * crossover / hypot(1.0, ratio)
    return Gains(_rounded(kp), _rounded(kp * crossover * ratio))


def total_delay(delay: float, period: float) -> float:
    """S, with the half period for which a torque that is held is late on the average."""
    return delay + 0.5 * period


def margins(loop: Gains, inertia: float, *, delay: float, period: float) -> Margins:
    """Of this loop with this inertia, kg m^2."""
    late = total_delay(delay, period)

    def size(w: float) -> float:
        return hypot(loop.kp, loop.ki / w) / (inertia * w) - 1.0

    def phase(w: float) -> float:
        return pi / 2.0 - atan2(loop.ki, loop.kp * w) - w * late

    crossover = float(brentq(size, _SLOWEST, _FASTEST))
    # From the most of it on the phase only falls.
    most = loop.ki / loop.kp if loop.ki > 0.0 else _SLOWEST
    turned = float(brentq(phase, most, _FASTEST)) if phase(most) > 0.0 else most
    return Margins(degrees(phase(crossover)), 1.0 / (1.0 + size(turned)), crossover)


def stepped(response: Response, loop: Gains, *, period: float, seconds: float) -> tuple[Array, Array]:
    """S and rad/s after a step to 1 rad/s from rest, as the loop makes it of a motor that answers so."""
    every, late = max(1, round(period / STEP_S)), round(response.delay / STEP_S)
    times = np.arange(0.0, seconds, STEP_S)
    speeds = np.zeros(len(times))
    speed = torque = integral = 0.0
    for at in range(1, len(times)):
        if (at - 1) % every == 0:
            error = 1.0 - (speeds[at - 1 - late] if at - 1 >= late else 0.0)
            integral += loop.ki * error * period
            torque = loop.kp * error + integral
        driven = speed + (torque - response.friction * speed) / response.inertia * STEP_S
        most = response.drag / response.inertia * STEP_S
        speed = driven - max(-most, min(most, driven))
        speeds[at] = speed
    return times, speeds


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
