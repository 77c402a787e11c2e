"""Whether wheels slip, which, and what that does to the motion they tell.

How this works
--------------
Two signs. The residual: what no rigid motion explains of a wheel's speed is more than noise and skew can make
(`gateway.core.slip_model`). The spin: a wheel speeds up, along its own torque, faster than all measured torques drive
the body and than the limits of the body ask for; that is for a start in which opposite wheels spin alike, to which the
residual is nearly blind. Either has to last TIME; slip is over when neither was seen, at half the threshold, for QUIET:
on oil a wheel that is held at its speed swings about it, and passes through zero each time.
Which wheel is found by `gateway.core.slip_isolation`. Until then the motion told by all wheels is wrong by s D+ e_k of
one of those that may be it: along these directions the odometry grows uncertain (`spread`).
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.control.drive_law import Measured
from gateway.core.odometry import Spread
from gateway.core.sensors import Heading
from gateway.core.slip_isolation import CLEAR, Isolation, Sight
from gateway.core.slip_model import SPEED_TOLERANCE, SlipModel
from gateway.kinematics.contract import Estimate
from gateway.kinematics.redundancy import Check
from gateway.types import SlipStatus

TIME: Final = 0.02  # s for which more than noise has to be seen; source: ours, a blow is over by then
CYCLES: Final = 3  # and in so many of them
QUIET: Final = 0.1  # s; source: ours, the wheels of the simulated omni4 swing at about 20 Hz on oil
RELEASE: Final = 0.5  # of the threshold
AGREED: Final = 2  # cycles in which the same wheel is found and no other
AFRESH: Final = 0.3  # s after which the evidence begins anew, from the wheels that grip: what is unknown adds up
NAME_DOUBT: Final = 0.1  # of its slip, by which the motion without a wheel that was found is taken to err

Numbers = Sequence[float | None]


class Slip(NamedTuple):
    """What is known in one cycle.

    `wheels`: places of those that slip, where that is known, and by what `evidence`; `ahead`: m/s at the rim by which
    each wheel is off the motion of the body, as far as that can be told; `spread`: of the error of the motion that is
    told without these wheels, or where they cannot be left out with them, body frame; m/s and rad/s.
    """

    slipping: bool = False
    wheels: tuple[int, ...] = ()
    evidence: tuple[str, ...] = ()
    ahead: tuple[float, ...] = ()
    spread: Spread | None = None


NO_SLIP: Final = Slip()


class SlipDetector:
    """One writer, the engine."""

    def __init__(self, names: Sequence[str], model: SlipModel) -> None:
        self._names = tuple(names)
        self._model = model
        self._floor, self._slope = _least_bound(model)
        self._spin = _SpinWatch(model)
        self._isolation = Isolation(model)
        self._last: tuple[Numbers, Estimate | None] = ((), None)
        self._suspect = False
        self._time = self._quiet = 0.0
        self._cycles = 0
        self._candidate: int | None = None  # the wheel that was found last, in how many cycles on end
        self._agreed = 0
        self._named: int | None = None
        self._evidence: tuple[str, ...] = ()
        self.now = NO_SLIP  # as of the last look
        self.threshold: float | None = None  # m/s at the rim, of the wheel that is nearest to it or beyond it

    def look(self, measured: Measured, speeds: Numbers, estimate: Estimate | None, heading: Heading | None) -> Slip:
        """One cycle. `speeds`: those that are believed; `estimate`: the motion that all of these tell together."""
        last, self._last = self._last, (speeds, estimate)
        spinning = self._spin.look(speeds, measured)
        if estimate is None or estimate.residual is None or estimate.residuals is None:
            return self._forget()
        if not (self._suspect or spinning) and self._is_noise(estimate.residual, speeds):
            return NO_SLIP
        check = self._model.redundancy.of(tuple([speed is not None for speed in speeds]))
        if check is None:
            return self._forget()
        residuals = [one for one in estimate.residuals if one is not None]
        noise, ratio = self._beyond(check, residuals, speeds, measured.ages_ns)
        if not self._suspect:
            if ratio <= 1.0 and not spinning:
                return NO_SLIP
            self._begin(last)
        self._count(seen=ratio > 1.0 or bool(spinning), quiet=ratio < RELEASE and not spinning, dt=measured.dt)
        if self._quiet >= QUIET:
            return self._forget()
        sight = Sight(check, residuals, estimate.rates, speeds, measured.torques, heading, noise, measured.dt)
        self.now = self._told(sight, self._isolate(sight, spinning), spinning)
        return self.now

    @property
    def suspects(self) -> bool:
        """Whether something is seen that noise does not explain, however short."""
        return self._suspect

    def named(self) -> tuple[str, ...]:
        """Names of the wheels that slip, none where that is not known."""
        return tuple([self._names[place] for place in self.now.wheels])

    def describe(self, measured: Measured) -> SlipStatus:
        """In words and numbers, with what could be told now."""
        now = self.now
        return SlipStatus(
            slipping=now.slipping,
            wheels=self.named() if now.slipping else (),
            evidence=now.evidence if now.slipping else (),
            threshold=self.threshold,
            tells=self._tells(measured.speeds, measured.torques, measured.heading),
        )

    # the residual against its threshold

    def _is_noise(self, residual: float, speeds: Numbers) -> bool:
        """Whether all of it is within the threshold of each wheel, whatever the ages: almost always, so asked first."""
        if residual <= self._floor:
            return None not in speeds
        total = 0.0
        for speed in speeds:
            if speed is None:
                return False
            total += speed if speed > 0.0 else -speed
        return residual <= self._floor + self._slope * total

    def _beyond(
        self, check: Check, residuals: Sequence[float], speeds: Numbers, ages_ns: Sequence[int | None]
    ) -> tuple[float, float]:
        """M/s to which rim speeds are known in a usual drive, and the worst residual in thresholds."""
        model = self._model
        skew = _skew(ages_ns)
        bounds = [model.steps[place] + skew * model.gripping[place] for place in check.places]
        errors = [
            bound + SPEED_TOLERANCE * model.radii[place] * abs(speeds[place] or 0.0)
            for bound, place in zip(bounds, check.places)
        ]
        worst, self.threshold = 0.0, None
        for residual, sizes in zip(residuals, check.sizes):
            bound = 0.0
            for size, error in zip(sizes, errors):
                bound += size * error
            if bound > 0.0 and (abs(residual) > worst * bound or self.threshold is None):
                worst, self.threshold = abs(residual) / bound, bound
        noise = max([model.steps[place] + skew * model.radii[place] * model.usual[place] for place in check.places])
        return noise, worst

    def _begin(self, last: tuple[Numbers, Estimate | None]) -> None:
        self._suspect = True
        self._time = self._quiet = 0.0
        self._cycles = self._agreed = 0
        self._candidate = self._named = None
        self._evidence = ()
        speeds, estimate = last
        if estimate is not None:
            self._isolation.begin(estimate.rates, speeds)

    def _count(self, *, seen: bool, quiet: bool, dt: float) -> None:
        if seen:
            self._time += dt
            self._cycles += 1
        self._quiet = self._quiet + dt if quiet else 0.0

    def _forget(self) -> Slip:
        self._suspect = False
        self._named = self._candidate = None
        self.threshold = None
        self.now = NO_SLIP
        return NO_SLIP

    # which wheel

    def _isolate(self, sight: Sight, spinning: dict[int, float]) -> list[float]:
        """Misfit of each measured wheel; keeps the name of the one that slips, and drops it where it fits no more."""
        check, isolation = sight.check, self._isolation
        misfits = isolation.look(sight)
        found, evidence = _only(check, misfits), isolation.evidence
        young = isolation.time < AFRESH
        if found is None and len(spinning) == 1:
            (spins,) = spinning
            found, evidence = spins if _misfit(check, misfits, spins) <= 1.0 else None, ("spin",)
        if found is not None:
            self._agreed = self._agreed + 1 if found == self._candidate else 1
            self._candidate = found
        if found is not None and self._agreed >= AGREED:
            self._named, self._evidence = found, evidence
        elif self._named is not None and _misfit(check, misfits, self._named) > (CLEAR if young else 1.0):
            self._named, self._evidence = None, ()  # nothing begins anew from the motion without a wheel in doubt
        if self._named in check.places and not young:
            place = check.places.index(self._named)
            slip, (x, y, z) = sight.slips[place], check.shares[place]
            vx, vy, wz, *more = sight.rates
            isolation.begin((vx - slip * x, vy - slip * y, wz - slip * z, *more), sight.speeds)
        return misfits

    def _told(self, sight: Sight, misfits: Sequence[float], spinning: dict[int, float]) -> Slip:
        check = sight.check
        slips = dict(zip(check.places, sight.slips)) | spinning
        wheels, evidence = self._wheels(spinning)
        ahead = {place: slips[place] for place in wheels} if wheels else dict(zip(check.places, sight.residuals))
        return Slip(
            self._time >= TIME and self._cycles >= CYCLES,
            wheels,
            evidence,
            tuple([ahead.get(place, 0.0) for place in range(len(self._names))]),
            _spread(check, slips, _doubts(check, misfits, wheels)),
        )

    def _wheels(self, spinning: dict[int, float]) -> tuple[tuple[int, ...], tuple[str, ...]]:
        """Places of those that slip, and by what.

        While one swings its neighbours are driven otherwise than if all gripped: the spin names only where the motion
        of the body itself fits no single wheel.
        """
        if self._named is not None:
            return (self._named,), self._evidence
        return tuple(spinning), ("spin",) if spinning else ()

    def _tells(self, speeds: Numbers, torques: Numbers, heading: float | None) -> str:
        check = self._model.redundancy.of(tuple([speed is not None for speed in speeds]))
        count = len([speed for speed in speeds if speed is not None])
        if check is None:
            return f"nothing: any speeds of the {count} wheels that are measured fit some motion"
        told = [self._names[place] for place, alone in zip(check.places, check.told, strict=True) if alone]
        if len(told) == count:
            return "that a wheel slips, and which one"
        helpers = ["the torques"] if None not in torques else []
        helpers += ["the gyro"] if heading is not None else []
        which = (
            f"which one of {', '.join(told)} alone" if told else f"not which one by the speeds of {count} wheels alone"
        )
        more = f", but with {' and '.join(helpers)} as a rule" if helpers else ""
        return f"that a wheel slips, {which}{more}"


class _SpinWatch:
    """Wheels that speed up along their torque faster than all torques drive the body, and than its limits ask for."""

    def __init__(self, model: SlipModel) -> None:
        self._model = model
        size = len(model.radii)
        self._nothing: dict[int, float] = {}
        self._before: Numbers = (None,) * size
        self._ages_ns: Sequence[int | None] = (None,) * size
        self._driven: list[float] = [0.0] * size  # rad/s^2 that the torques of the cycle before explained
        self._gained = [0.0] * size  # rad/s beyond what is explained
        self._counts = False

    def look(self, speeds: Numbers, measured: Measured) -> dict[int, float]:
        """Places of those wheels, and m/s at the rim by which they are ahead. `speeds`: those that are believed."""
        before, self._before = self._before, speeds
        ages_ns, self._ages_ns = self._ages_ns, measured.ages_ns
        if not self._counts and self._usual(before, speeds, measured.dt):
            return self._nothing
        return self._count(before, speeds, ages_ns, measured)

    def _usual(self, before: Numbers, speeds: Numbers, dt: float) -> bool:
        for old, new, most in zip(before, speeds, self._model.usual):
            if old is not None and new is not None and not -most * dt <= new - old <= most * dt:
                return False
        return True

    def _count(
        self,
        before: Numbers,
        speeds: Numbers,
        ages_before: Sequence[int | None],
        measured: Measured,
    ) -> dict[int, float]:
        model, torques, ages_ns, dt = self._model, measured.torques, measured.ages_ns, measured.dt
        if None in torques or None in speeds or None in before:
            self._counts, self._gained = False, [0.0] * len(self._gained)
            return self._nothing
        known = [torque or 0.0 for torque in torques]
        skew = _skew(ages_ns)
        spinning: dict[int, float] = {}
        for place, row in enumerate(model.spun):
            driven = 0.0
            for part, torque in zip(row, known):
                driven += part * torque
            old, self._driven[place] = self._driven[place], driven
            elapsed = max(0.0, dt + 1e-9 * ((ages_before[place] or 0) - (ages_ns[place] or 0)))
            speed = speeds[place] or 0.0
            usual = model.usual[place] * elapsed
            most, least = max(driven, old, 0.0) * elapsed + usual, min(driven, old, 0.0) * elapsed - usual
            change = speed - (before[place] or 0.0)
            gained = _nearer_zero(self._gained[place], usual)
            beyond = change - max(least, min(most, change))
            if beyond * known[place] > 0.0 or beyond * gained < 0.0:
                gained += beyond
            self._gained[place] = gained
            ahead = model.radii[place] * gained
            exact = model.steps[place] + skew * model.gripping[place]
            if abs(ahead) > 2.0 * exact + SPEED_TOLERANCE * model.radii[place] * abs(speed):
                spinning[place] = ahead
        self._counts = any(self._gained)
        return spinning


def _nearer_zero(value: float, by: float) -> float:
    return max(0.0, value - by) if value > 0.0 else min(0.0, value + by)


def _only(check: Check, misfits: Sequence[float]) -> int | None:
    """The wheel that fits, where every other clearly does not."""
    likely = [(place, misfit) for place, misfit in zip(check.places, misfits) if misfit <= CLEAR]
    return likely[0][0] if len(likely) == 1 and likely[0][1] <= 1.0 else None


def _misfit(check: Check, misfits: Sequence[float], place: int) -> float:
    return misfits[check.places.index(place)] if place in check.places else CLEAR + 1.0


def _doubts(check: Check, misfits: Sequence[float], wheels: tuple[int, ...]) -> dict[int, float]:
    """How much of the slip of each wheel may be in the motion that is told, as a share of its variance.

    Without one wheel the others suffice, or there were nothing to hold it against; without two they may not.
    """
    if len(wheels) == 1:
        return {wheels[0]: NAME_DOUBT * NAME_DOUBT}
    if wheels:
        return dict.fromkeys(wheels, 1.0)
    may = [place for place, misfit in zip(check.places, misfits) if misfit <= CLEAR] or list(check.places)
    return dict.fromkeys(may, 1.0 / len(may))


def _spread(check: Check, slips: dict[int, float], doubts: dict[int, float]) -> Spread:
    xx = xy = xt = yy = yt = tt = 0.0
    for place, (x, y, t) in zip(check.places, check.shares):
        if place in doubts:
            slip = slips.get(place, 0.0)
            variance = doubts[place] * slip * slip
            xx, xy, xt = xx + variance * x * x, xy + variance * x * y, xt + variance * x * t
            yy, yt, tt = yy + variance * y * y, yt + variance * y * t, tt + variance * t * t
    return xx, xy, xt, yy, yt, tt


def _skew(ages_ns: Sequence[int | None]) -> float:
    """S between the oldest and the newest measurement."""
    known = [age for age in ages_ns if age is not None]
    return 1e-9 * (max(known) - min(known)) if known else 0.0


def _least_bound(model: SlipModel) -> tuple[float, float]:
    """The least of the thresholds of all wheels: m/s at rest, and m by which it grows with the sum of their speeds."""
    check = model.redundancy.of((True,) * len(model.radii))
    if check is None:
        return 0.0, 0.0
    floors, slopes = [], []
    for sizes in check.sizes:
        floor = 0.0
        for size, place in zip(sizes, check.places):
            floor += size * model.steps[place]
        floors.append(floor)
        slopes.append(min([size * model.radii[place] for size, place in zip(sizes, check.places)]))
    return min(floors), SPEED_TOLERANCE * min(slopes)
