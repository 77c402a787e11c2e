"""Pull-region compensation: turn the velocity of the joint against the chassis' error, at the same speed.

How this works
--------------
v_corr = Rot(-k e) v, where e is the error of gamma from its goal and |e| is within a region (Eqs. 22-25 of
preprints202312.1327; science 1.4). On a straight path de/dt = -(c/d1) sin((k - 1) e): k = 0 lets the chassis flip,
k = 1 freezes the error, k = 2 makes it decay as it would in the push region (the mirror image, Eq. 23). Everything is
in the platform frame, so no heading is needed, and the speed stays what the limits made it.

It acts behind the limits of the body: a stabiliser that has to wait for a ramp is none. It is bounded by itself: the
angle of correction moves at most so fast that the wheels can follow, so that switching it on and off, another gain, and
an error that leaves the region turn the velocity without a step.

On a tight path the balances of push and pull lie close together, and a region about the one holds the other as well: a
chassis that is pushed round a bend would be turned the other way, or to and fro at the edge of the region. So who does
not ask to be pulled is corrected from when it is pulled on, and who asks to be pushed never.
"""

from collections.abc import Sequence
from math import inf, pi, sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import angle_of, exponential, logarithm, sin_cos
from gateway.control.pull_region import LEAST_SPEED, PULLED, Pull, examine
from gateway.types import Region as WayRound

WHOLE_CIRCLE: Final = 3.142  # rad, a region with every error in it: pi as people write it
_FOUR_DIGITS: Final = 5e-4  # a bound is told with so many: the most that they are off by
_ACROSS: Final = 0.5 * pi * (1.0 + _FOUR_DIGITS)  # rad; a larger region has errors of a pushed chassis in it on purpose
_PUSH: Final = WayRound.PUSH
_PULL: Final = WayRound.PULL
_DELAY_SLOPE: Final = 1.9  # a twentieth below the slope of the limit where it ends
_LEAST_SQUARE: Final = LEAST_SPEED * LEAST_SPEED
_PATH_RATE_TIME: Final = 0.1  # s, over which the rate of a path that nobody tells is averaged


class RegionAt(NamedTuple):
    """Largest error that is corrected at this speed, m/s and rad."""

    speed: float
    region: float


def largest_region(gain: float) -> float:
    """pi/(2 (k - 1)), rad: beyond it the correction gets weaker again; half way to where it turns the other way."""
    return min(WHOLE_CIRCLE, pi / (2.0 * (gain - 1.0))) if gain > 1.0 else WHOLE_CIRCLE


def region_refusal(gain: float, region: float) -> str | None:
    """Why this region, rad, does not go with this gain; None: it does, as far as four digits tell."""
    largest = largest_region(gain)
    if region <= largest * (1.0 + _FOUR_DIGITS):
        return None
    return (
        f"region = {region:g}: allowed up to {largest:.4g} rad with gain = {gain:g}, pi/(2 (gain - 1)); "
        "beyond it the correction gets weaker again"
    )


def longest_period(gain: float, *, axle_offset: float, speed: float, delay: float = 0.0) -> float:
    """Period of the loop, s, from which on the sampled correction swings; 0.0 where the delay alone makes it swing.

    `delay`: s, by which the joint angle is old at most. In units of d1/c, with h the period: without delay stable for
    e^h < (k + 1)/(k - 1) (science 1.4); up to a delay of one period also e^h < 1/(k (1 - e^-delay)) (the poles are
    those of z^2 + (k (e^(h - delay) - 1) - e^h) z + k e^h (1 - e^-delay)); for a longer delay the limit falls to zero
    where the continuous loop swings, at acos(1/k)/sqrt(k^2 - 1), with a slope of 2, of which 1.9 is taken.
    Source: ours, from de/dt = (c/d1)(e - k e_measured) (science 1.4).
    """
    if gain <= 1.0:
        return inf
    unit = axle_offset / speed
    late = delay / unit
    if late > logarithm(1.0 + 1.0 / gain):  # the limit with a delay of just one period
        root = sqrt((gain - 1.0) * (gain + 1.0))
        return unit * max(0.0, _DELAY_SLOPE * (angle_of(root, 1.0) / root - late))
    growth = (gain + 1.0) / (gain - 1.0)
    old = gain * (1.0 - exponential(-late))
    return unit * logarithm(growth if old * growth <= 1.0 else 1.0 / old)


def region_at(regions: Sequence[RegionAt], speed: float) -> float:
    """Between the speeds of the table in proportion, beyond its ends as at them, rad."""
    before = regions[0]
    for after in regions:
        if speed < after.speed:
            if after is before:
                break
            share = (speed - before.speed) / (after.speed - before.speed)
            return before.region + share * (after.region - before.region)
        before = after
    return before.region


class PathRate:
    """How fast the direction of a commanded motion turns over the ground, from the motion itself."""

    def __init__(self) -> None:
        self._direction: tuple[float, float] | None = None  # unit vector in the platform frame
        self._turning = 0.0  # rad/s against the platform, averaged

    def of(self, vx: float, vy: float, wz: float, dt: float) -> float:
        """rad/s: the platform's own rate and that of the direction within it. Starts anew from rest."""
        if vx * vx + vy * vy < _LEAST_SQUARE or dt <= 0.0:
            if dt > 0.0:
                self._direction, self._turning = None, 0.0
            return wz
        before, self._direction = self._direction, (vx, vy)
        turning = self._turning
        if before is not None:
            x, y = before
            along = x * vx + y * vy
            if along > 0.0:  # else it has turned back, which is no turn at any rate
                share = dt / _PATH_RATE_TIME
                rate = (x * vy - y * vx) / along / dt
                self._turning = turning = turning + (share if share < 1.0 else 1.0) * (rate - turning)
        return wz + turning


class Compensation:
    """State: the angle by which the velocity is turned, rad, and whether an error is being corrected."""

    def __init__(self, *, gain: float, regions: Sequence[RegionAt], axle_offset: float, authority: float) -> None:
        """`authority`: m/s^2 across the direction of motion with which the correction may turn the velocity."""
        self.gain = gain
        self.regions = tuple(regions)
        self._axle_offset = axle_offset
        self._authority = authority
        self.angle = 0.0
        self.holds = False

    def turn(
        self,
        vx: float,
        vy: float,
        *,
        joint: float | None,
        path_rate: float,
        dt: float,
        asked: WayRound = WayRound.ANY,
    ) -> tuple[float, float, Pull | None]:
        """The velocity turned, and where the chassis is before it; `joint`: its angle, rad, None: unknown.

        `asked`: the way round that it is to go. At rest, and while the angle is unknown, nothing is corrected and what
        was is let go.
        """
        pull = None
        if joint is not None:
            pull = examine(vx, vy, angle=joint, path_rate=path_rate, axle_offset=self._axle_offset)
        if pull is None:
            self.release()
            return vx, vy, None
        speed, error, angle = pull.speed, pull.error, self.angle
        most = self._authority * dt / speed
        region = region_at(self.regions, speed)
        if abs(error) > region or asked is _PUSH:
            self.holds = False
        elif pull.region is PULLED or asked is _PULL or region > _ACROSS:
            self.holds = True
        wanted = -self.gain * error if self.holds else 0.0
        change = wanted - angle
        if not -most <= change <= most:
            change = most if change > 0.0 else -most
        self.angle = angle = angle + change
        s, c = sin_cos(angle)
        return c * vx - s * vy, s * vx + c * vy, pull

    def release(self) -> None:
        """Correct nothing."""
        self.angle = 0.0
        self.holds = False
