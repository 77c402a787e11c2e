"""Forces of two bodies on slides: against numeric differentiation of where they are; the printed terms fail."""

from collections.abc import Callable

import mpmath as mp
import pytest
from mpmath import cos, sin

from replay.sim.plants.odd_equations import TwoBodies

BODIES = TwoBodies(3.5, 2.5)  # kg
# x, y, heading and width over time, all moving and none at an even rate
Course = Callable[[mp.mpf], mp.mpf]
COURSE: tuple[Course, ...] = (
    lambda t: 0.3 * t + 0.2 * sin(2 * t),
    lambda t: 0.1 * t * t - 0.3 * cos(t),
    lambda t: 0.8 * sin(1.5 * t) + 0.2 * t,
    lambda t: 0.4 + 0.1 * sin(3 * t),
)
T = 0.7


def body_rates(t: mp.mpf) -> list[mp.mpf]:
    vx, vy, wz, rate = (mp.diff(course, t) for course in COURSE)
    c, s = cos(COURSE[2](t)), sin(COURSE[2](t))
    return [c * vx + s * vy, c * vy - s * vx, wz, rate]


def newton(mass: float, side: float) -> tuple[float, float]:
    """Mass times the second derivative of where it is, turned into the body's axes."""
    ax = mp.diff(lambda t: COURSE[0](t) - side * COURSE[3](t) * sin(COURSE[2](t)), T, 2)
    ay = mp.diff(lambda t: COURSE[1](t) + side * COURSE[3](t) * cos(COURSE[2](t)), T, 2)
    c, s = cos(COURSE[2](T)), sin(COURSE[2](T))
    return float(mass * (c * ax + s * ay)), float(mass * (c * ay - s * ax))


def state() -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    rates = tuple(map(float, body_rates(T)))
    changes = tuple(float(mp.diff(lambda t, axis=axis: body_rates(t)[axis], T)) for axis in range(4))
    return float(COURSE[3](T)), rates, changes


def test_forces_are_those_of_newton() -> None:
    width, rates, changes = state()
    forces = BODIES.forces(width, rates, changes)  # type: ignore[arg-type]
    assert forces.left == pytest.approx(newton(3.5, 0.5), abs=1e-6)
    assert forces.right == pytest.approx(newton(2.5, -0.5), abs=1e-6)


def test_the_printed_coriolis_terms_are_not_those_of_newton() -> None:
    """Printed: -+ m wz (2 vy -+ rate) along the body (L and R), for - m wz (vy +- rate) of both."""
    width, (_, vy, wz, rate), (ax, _, wz_change, _) = state()
    for mass, sign in ((3.5, 1.0), (2.5, -1.0)):
        rest = mass * (ax - sign * wz_change * width / 2.0)
        right = newton(mass, 0.5 * sign)[0]
        assert rest - mass * wz * (vy + sign * rate) == pytest.approx(right, abs=1e-6)
        assert abs(rest - sign * mass * wz * (2.0 * vy - sign * rate) - right) > 0.1


def test_centre_and_inertia_by_hand() -> None:
    """3.5 and 2.5 kg, 0.6 m apart: 0.05 m to the left, and 3.5 x 0.25^2 + 2.5 x 0.35^2 kg m^2."""
    assert BODIES.centre(0.6) == pytest.approx(0.05)
    assert BODIES.inertia(0.6) == pytest.approx(3.5 * 0.0625 + 2.5 * 0.1225)


def test_standing_still_needs_no_force() -> None:
    still = (0.0, 0.0, 0.0, 0.0)
    assert BODIES.forces(0.4, still, still) == ((0.0, 0.0), (0.0, 0.0))
