"""Follows a path with a velocity over the floor, and merges back after whatever pushed the robot off it.

How this works
--------------
The robot is to be n beside the path at its way s (n to the left). From time to time the way ahead is planned anew: n is
a polynomial of fifth degree over a stretch of the path, from where the robot is, in the direction and with the
curvature that it is being sent already, to the path itself. So a new plan changes neither direction nor curvature at
once, whatever pushed the robot. Planned anew all the time over a stretch L, n''' = -60 n/L^3 - 36 n'/L^2 - 9 n''/L: of
a small deviation 36 % are left after 0.7 L and 9 % after L. The stretch is the longer the further off the robot is, so
that merging turns no tighter than is allowed.

Between plans the robot goes blind along its plan. The frame of the path turns into velocities by the geometry of curves
beside curves (Werling et al., ICRA 2010, appendix I).
"""

from math import sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import angle_of, sin_cos
from gateway.paths.path import Path, PathPoint

_SEARCH: Final = 1.0  # m, either side of where the robot should be, in which its nearest point is looked for
_NEAREST_CENTRE: Final = 0.2  # of the path's radius: closer to its centre there is no way beside the path
_SLOPE: Final = 4.0  # m of stretch per m of deviation: the plan leaves the path's direction by 0.44 rad at most
_LONGER: Final = 1.25  # a stretch that turns too tight is planned so much longer,
_ATTEMPTS: Final = 16  # so often
_SAMPLES: Final = 24  # points of a plan at which its curvature is looked at
_LAST: Final = 0.1  # of the stretch, before the end: over less way a robot that takes corners does not merge
_ARRIVED: Final = 1e-3  # m
_LEAST_COSINE: Final = 0.5  # of a direction off the path's: more no plan makes, but a corner does


class Plan(NamedTuple):
    """Deviation n over the way from `start`, over `length`: six coefficients of (way/length); zero behind it."""

    start: float = 0.0
    length: float = 1.0
    coefficients: tuple[float, ...] = (0.0,) * 6


class FollowerState(NamedTuple):
    """Plain data: way along the path, what is planned, how old that is (s), and the speed, m/s."""

    way: float = 0.0
    plan: Plan = Plan()
    age: float = 0.0
    speed: float = 0.0


class Order(NamedTuple):
    """What the robot is told: velocity over the floor, m/s, the rate at which its direction turns, rad/s.

    `way`: m along the path; `left`: m to its end; `deviation`: measured, m to the left of the path; `curvature`: of the
    way planned, 1/m. `lost`: so far off that no way leads back; the robot is told to stand, and whether it goes on
    when it is put back is the caller's decision.
    """

    vx: float
    vy: float
    path_rate: float
    way: float
    left: float
    deviation: float
    curvature: float
    lost: bool = False

    @property
    def arrived(self) -> bool:
        """At the end of the path, or as good as."""
        return self.left <= _ARRIVED


class _Beside(NamedTuple):
    """Of a curve beside the path: direction, curvature, and way of the path per way of the curve."""

    heading: float
    curvature: float
    progress: float


class Follower:
    """Of one path. Everything that changes is in the state.

    `speed`: m/s; `acceleration`: m/s^2 along the path, for its start and its end; `period`: s between plans;
    `stretch`: m, the shortest over which it merges (for a pulled robot `rules.least_stretch`); `least_radius`: m, of
    the way planned (None: no matter).
    """

    def __init__(
        self,
        path: Path,
        *,
        speed: float,
        acceleration: float,
        period: float,
        stretch: float,
        least_radius: float | None,
    ) -> None:
        self._path = path
        self._speed = speed
        self._acceleration = acceleration
        self._period = period
        self._stretch = stretch
        self._last = stretch if least_radius is not None else _LAST * stretch
        self._sharpest = None if least_radius is None else 1.0 / least_radius

    def step(self, state: FollowerState, x: float, y: float, dt: float) -> tuple[Order, FollowerState]:
        """The order for the next dt seconds, for a robot measured at (x, y), and the state after it."""
        path = self._path
        if state.age + 0.5 * dt >= self._period and path.length - state.way > self._last:
            state = self._planned(state, x, y)
        point, (ahead, deviation) = path.at(state.way), path.beside(x, y, state.way)
        left = path.length - state.way
        beside = _beside(point, *_values(state.plan, state.way))
        if beside is None or abs(ahead) > _SEARCH or 1.0 - point.curvature * deviation <= _NEAREST_CENTRE:
            return Order(0.0, 0.0, 0.0, state.way, left, deviation, 0.0, lost=True), state._replace(speed=0.0)
        speed = self._speed_at(state, left, dt)
        s, c = sin_cos(beside.heading)
        order = Order(speed * c, speed * s, speed * beside.curvature, state.way, left, deviation, beside.curvature)
        way = min(state.way + speed * dt * beside.progress, path.length)
        return order, FollowerState(way, state.plan, state.age + dt, speed)

    def _speed_at(self, state: FollowerState, left: float, dt: float) -> float:
        """Grows and falls evenly; no further than the end within this step."""
        if left <= _ARRIVED:
            return 0.0
        rising = state.speed + self._acceleration * dt
        return min(self._speed, rising, sqrt(2.0 * self._acceleration * left), left / dt if dt > 0.0 else self._speed)

    def _planned(self, state: FollowerState, x: float, y: float) -> FollowerState:
        """A plan from where the robot is, in the direction and with the curvature of the plan before."""
        old = _beside(self._path.at(state.way), *_values(state.plan, state.way))
        way = self._path.nearest(x, y, between=(state.way - _SEARCH, min(state.way + _SEARCH, self._path.length)))
        point, deviation = self._path.at(way), self._path.beside(x, y, way)[1]
        if old is None or 1.0 - point.curvature * deviation <= _NEAREST_CENTRE:
            return state
        plan = self._merging(way, _as_seen(point, deviation, old), abs(old.curvature))
        return state._replace(way=way, plan=plan, age=0.0)

    def _merging(self, way: float, begin: tuple[float, float, float], already: float) -> Plan:
        """The shortest plan of those tried that turns no tighter than allowed, or else the longest."""
        left = max(self._last, self._path.length - way)
        length = max(min(self._stretch, left), _SLOPE * abs(begin[0]))
        plan = _quintic(way, length, *begin)
        for _ in range(_ATTEMPTS):
            if self._gentle(plan, already):
                break
            length *= _LONGER
            plan = _quintic(way, length, *begin)
        return plan

    def _gentle(self, plan: Plan, already: float) -> bool:
        """No tighter than allowed, as far as the path itself is not, nor the way that the robot is already on."""
        if self._sharpest is None:
            return True
        for number in range(1, _SAMPLES):
            way = plan.start + plan.length * number / _SAMPLES
            point = self._path.at(way)
            beside = _beside(point, *_values(plan, way))
            if beside is None or abs(beside.curvature) > max(self._sharpest, abs(point.curvature), already):
                return False
        return True


def _quintic(way: float, length: float, n: float, slope: float, bend: float) -> Plan:
    """From these values and derivatives to zero with zero derivatives."""
    one, two = slope * length, 0.5 * bend * length * length
    return Plan(
        way,
        length,
        (
            n,
            one,
            two,
            -10.0 * n - 6.0 * one - 3.0 * two,
            15.0 * n + 8.0 * one + 3.0 * two,
            -6.0 * n - 3.0 * one - two,
        ),
    )


def _values(plan: Plan, way: float) -> tuple[float, float, float]:
    """n and its first two derivatives over the way."""
    t = (way - plan.start) / plan.length
    if t >= 1.0:
        return 0.0, 0.0, 0.0
    n, slope, bend = 0.0, 0.0, 0.0
    for coefficient in reversed(plan.coefficients):
        bend = bend * t + 2.0 * slope
        slope = slope * t + n
        n = n * t + coefficient
    return n, slope / plan.length, bend / (plan.length * plan.length)


def _beside(point: PathPoint, n: float, slope: float, bend: float) -> _Beside | None:
    """Of the curve that lies n beside the path; None too near to the path's centre."""
    room = 1.0 - point.curvature * n
    if room <= 0.5 * _NEAREST_CENTRE:
        return None
    along = sqrt(room * room + slope * slope)
    cosine, tangent = room / along, slope / room
    turning = bend + (point.slope * n + point.curvature * slope) * tangent
    curvature = (turning * cosine * cosine / room + point.curvature) * cosine / room
    return _Beside(point.heading + angle_of(slope, room), curvature, 1.0 / along)


def _as_seen(point: PathPoint, n: float, going: _Beside) -> tuple[float, float, float]:
    """n and its derivatives here for a curve with this direction and curvature; the inverse of `_beside`.

    On the other side of a corner it begins along the path.
    """
    room = 1.0 - point.curvature * n
    s, c = sin_cos(going.heading - point.heading)
    if c < _LEAST_COSINE:
        return n, 0.0, 0.0
    slope = room * s / c
    turning = (going.curvature * room / c - point.curvature) * room / (c * c)
    return n, slope, turning - (point.slope * n + point.curvature * slope) * s / c
