"""Which wheel it is that slips: each is suspected in turn, and has to fit everything else that is known.

How this works
--------------
If wheel k slips, the others tell the motion v_k = v - s_k D+ e_k, s_k = r_k / P_kk (`gateway.kinematics.redundancy`).
That motion is held against what knows nothing of wheel speeds, from the moment on at which all still gripped:
| evidence | what wheel k has to fit | where there is none |
|---|---|---|
| residual | the other wheels fit each other: what P e_k does not explain of the residual is noise | four wheels |
| torque | v_k is where the torques have driven the body, by Newton's law | a torque that is not measured |
| gyro | v_k has turned as far as the gyro | no gyro |
Each is told as a misfit: 1 is what noise and everything unknown (a slope, friction, mass, torque constants) may make.
It is wheel k if it alone fits all of them within 1 and every other misses one by CLEAR. Slip changes its sign many
times in a second where a wheel that is stiffly held at its speed crosses oil: its sign proves nothing.
What a joint gives to the ground is its torque less its friction and less what turns the joint itself, whether or not it
slips; M^-1 R' of the integral, less that of w x v, is the change of the body's motion.
"""

from collections.abc import Sequence
from math import copysign, remainder, sqrt, tau
from typing import Final, NamedTuple

from gateway.arithmetic import dot
from gateway.core.sensors import Heading
from gateway.core.slip_model import SlipModel
from gateway.kinematics.redundancy import BLIND, Check
from gateway.types import Rates

CLEAR: Final = 2.0
SLOPE: Final = 1.0  # m/s^2 that a floor (0.1 rad) or a light touch may add along x and y
TORQUE_DOUBT: Final = 0.1  # of a joint's torque: torque constant, gear; and of the mass
GYRO_NOISE: Final = 0.003  # rad
GYRO_DELAY: Final = 0.02  # s by which it may be older than the wheels: counts where the turning changes
GYRO_SCALE: Final = 0.01  # of a turn
NEVER: Final = 1e9  # the misfit of a wheel that cannot be it

# Of a twist: m/s^2, m/s^2, rad/s^2; a floor does not turn a body whose weight is in the middle.
_FLOOR: Rates = (SLOPE, SLOPE, 0.0)

Numbers = Sequence[float | None]


class Sight(NamedTuple):
    """What is seen in one cycle. Per wheel in chassis order, but `residuals`: of the measured ones.

    `rates`: of the body, as all measured wheels have it; `noise`: m/s to which rim speeds are known.
    """

    check: Check
    residuals: Sequence[float]  # m/s
    rates: Rates
    speeds: Numbers  # rad/s
    torques: Numbers  # N m
    heading: Heading | None
    noise: float
    dt: float

    @property
    def slips(self) -> list[float]:
        """M/s by which each measured wheel runs ahead if it is the only one that slips."""
        return [r / own if own > BLIND else 0.0 for r, own in zip(self.residuals, self.check.own)]


class Isolation:
    """Evidence of one slip, from its beginning on; one writer, the detector."""

    def __init__(self, model: SlipModel) -> None:
        self._model = model
        self.evidence: tuple[str, ...] = ()  # of the last look
        self.begin((0.0, 0.0, 0.0), ())

    def begin(self, rates: Rates, speeds: Numbers) -> None:
        """All wheels grip, or those that do tell this motion. `speeds`: rad/s of all wheels now."""
        size = len(self._model.radii)
        self.time = 0.0
        self._rates = rates
        self._speeds = speeds
        self._told = True  # every torque was, ever since
        self._given = [0.0] * size  # N m s that each joint was given, less its friction
        self._turning = (0.0, 0.0, 0.0)  # m/s that the rates have changed by because the body turns
        self._heading: float | None = None
        self._turned = self._yaw = 0.0  # rad since the first heading, by the gyro and by all wheels together
        self._shares = [0.0] * size  # rad of the latter that the slip of each wheel would have made
        self._first_rate = 0.0

    def look(self, sight: Sight) -> list[float]:
        """Misfit of each measured wheel."""
        self.time += sight.dt
        slips = sight.slips
        misfits = [0.0 if own > BLIND else NEVER for own in sight.check.own]
        evidence: list[str] = []
        for name, found in (
            ("residual", self._by_residual(sight)),
            ("torque", self._by_torque(sight, slips)),
            ("gyro", self._by_gyro(sight, slips)),
        ):
            if found is not None:
                evidence.append(name)
                misfits = [max(a, b) for a, b in zip(misfits, found)]
        self.evidence = tuple(evidence)
        return misfits

    def _by_residual(self, sight: Sight) -> list[float] | None:
        """|r|^2 less what lies along P e_k, r_k^2 / P_kk."""
        check, residuals = sight.check, sight.residuals
        if not any(check.told):
            return None
        square, bound = dot(residuals, residuals), sight.noise * sqrt(float(len(residuals)))
        return [
            sqrt(max(0.0, square - (r * r / own if own > BLIND else 0.0))) / bound
            for r, own in zip(residuals, check.own)
        ]

    def _by_torque(self, sight: Sight, slips: Sequence[float]) -> list[float] | None:
        """The motion without each wheel against that into which the torques have driven the body."""
        self._told = self._told and None not in sight.torques and None not in sight.speeds and None not in self._speeds
        if not self._told:
            return None
        given = self._impulses(sight)
        vx, vy, wz, *_ = sight.rates
        turning_x, turning_y, _ = self._turning
        self._turning = (turning_x + sight.dt * wz * vy, turning_y - sight.dt * wz * vx, 0.0)
        misfits = [0.0] * len(slips)
        for axis, (row, still, floor) in enumerate(zip(self._model.pushed, self._model.resting, _FLOOR)):
            pushed = size = 0.0
            for part, impulse in zip(row, given):
                push = part * impulse
                pushed += push
                size += push if push > 0.0 else -push
            doubt = TORQUE_DOUBT * size + self.time * (still + floor) + 2.0 * sight.noise * sight.check.together[axis]
            ahead = sight.rates[axis] - self._rates[axis] - self._turning[axis] - pushed
            for place, (slip, share) in enumerate(zip(slips, sight.check.shares)):
                misfits[place] = max(misfits[place], abs(ahead - slip * share[axis]) / doubt)
        return misfits

    def _impulses(self, sight: Sight) -> list[float]:
        """N m s that each joint gave to the ground: what it was given less its friction, and less what turned it."""
        model, given = self._model, []
        for index, (torque, speed, first) in enumerate(zip(sight.torques, sight.speeds, self._speeds)):
            turned = speed or 0.0
            drag = model.friction * turned + (copysign(model.drag, turned) if turned else 0.0)
            self._given[index] += sight.dt * ((torque or 0.0) - drag)
            given.append(self._given[index] - model.inertia * (turned - (first or 0.0)))
        return given

    def _by_gyro(self, sight: Sight, slips: Sequence[float]) -> list[float] | None:
        """The turn without each wheel against that of the gyro, since its first sample."""
        heading, rate = sight.heading, sight.rates[2]
        if heading is None or heading.anew:
            self._heading = None
        if heading is None:
            return None
        before = self._heading
        if heading.fresh:
            self._heading = heading.angle
        if before is None:
            self._turned, self._yaw, self._first_rate = 0.0, 0.0, rate
            self._shares = [0.0] * len(self._shares)
            return None
        self._yaw += sight.dt * rate
        places = sight.check.places
        for place, slip, share in zip(places, slips, sight.check.shares):
            self._shares[place] += sight.dt * slip * share[2]
        if heading.fresh:
            self._turned += remainder(heading.angle - before, tau)
        # Between two samples the gyro is behind by what the body turns meanwhile: that is not held against a wheel.
        behind = 0.0 if heading.fresh else GYRO_DELAY * abs(rate)
        doubt = GYRO_NOISE + behind + GYRO_DELAY * abs(rate - self._first_rate) + GYRO_SCALE * abs(self._turned)
        return [abs(self._yaw - self._shares[place] - self._turned) / doubt for place in places]
