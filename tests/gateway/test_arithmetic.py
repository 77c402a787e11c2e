"""Sine and cosine against 1300-bit arithmetic, to the last bit, where rounding is hardest too."""

import math
import random
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpf

from gateway.arithmetic import angle_of, arcsine, dot, exponential, logarithm, sin_cos

# Of all floats the one nearest to a multiple of pi/2 (Muller, Elementary Functions, 2nd ed., section 11.3.2).
HARDEST = 6381956970095103.0 * 2.0**797
finite = st.floats(allow_nan=False, allow_infinity=False)
angles = st.floats(-1e6, 1e6)


def ulps(got: float, exact: mpf) -> float:
    """The error in units of the last place of the exact value's nearest float."""
    return abs(float((mpf(got) - exact) / mpf(math.ulp(float(exact)))))


def errors(x: float) -> tuple[float, float]:
    with mp.workprec(1300):
        sine, cosine = sin_cos(x)
        return ulps(sine, mp.sin(mpf(x))), ulps(cosine, mp.cos(mpf(x)))


def around(x: float) -> Iterator[float]:
    yield from (math.nextafter(x, -math.inf), x, math.nextafter(x, math.inf))


def hard_arguments() -> Iterator[float]:
    """Multiples of pi/4, the edges between the ways of reduction, and the worst float of all."""
    generator = random.Random(7)
    with mp.workprec(200):
        multiples = [*range(1, 400), *generator.sample(range(400, 1_273_000), 400)]
        for multiple in multiples:
            yield from around(float(multiple * mp.pi / 4))
        for multiple in generator.sample(range(1, 636_000), 300):
            yield from around(float(multiple * mp.pi / 2 + mpf(2) ** -10))
    for edge in (2.0**-27, 1e6, 5e-324, 1.7976931348623157e308):
        yield from (x for x in around(edge) if x < math.inf)
    yield HARDEST


def random_arguments() -> Iterator[float]:
    generator = random.Random(3)
    for widest in (0.7853981633974483, 7.0, 1e3, 1e6):
        yield from (generator.uniform(-widest, widest) for _ in range(800))
    yield from (2.0 ** generator.uniform(-60.0, 1023.0) for _ in range(400))


@pytest.mark.parametrize("arguments", [hard_arguments, random_arguments])
def test_below_one_ulp(arguments: object) -> None:
    assert callable(arguments)
    worst = max((max(errors(x)), x) for x in arguments())
    assert worst[0] < 0.8, worst  # 1 is promised; this is what it is


@given(finite)
def test_below_one_ulp_for_every_float(x: float) -> None:
    assert max(errors(x)) < 1.0


@given(finite)
def test_odd_and_even_to_the_bit(x: float) -> None:
    (sine, cosine), (other_sine, other_cosine) = sin_cos(x), sin_cos(-x)
    assert (other_sine.hex(), other_cosine.hex()) == ((-sine).hex(), cosine.hex())


@given(finite)
def test_on_the_unit_circle(x: float) -> None:
    sine, cosine = sin_cos(x)
    assert abs(sine * sine + cosine * cosine - 1.0) <= 5e-16
    assert max(abs(sine), abs(cosine)) <= 1.0


@given(angles, angles)
def test_addition_theorem(a: float, b: float) -> None:
    """Within what rounding the sum of both angles may move it."""
    (sine_a, cosine_a), (sine_b, cosine_b) = sin_cos(a), sin_cos(b)
    sine, cosine = sin_cos(a + b)
    assert sine == pytest.approx(sine_a * cosine_b + cosine_a * sine_b, abs=2e-10)
    assert cosine == pytest.approx(cosine_a * cosine_b - sine_a * sine_b, abs=2e-10)


def test_values_known_by_heart() -> None:
    assert [part.hex() for part in (*sin_cos(0.0), *sin_cos(-0.0))] == [
        *("0x0.0p+0", "0x1.0000000000000p+0"),
        *("-0x0.0p+0", "0x1.0000000000000p+0"),
    ]
    assert sin_cos(math.pi / 2) == (1.0, 6.123233995736766e-17)  # the float pi/2 is short of pi/2 by as much
    assert sin_cos(math.pi) == (1.2246467991473532e-16, -1.0)
    assert sin_cos(-math.pi / 2) == (-1.0, 6.123233995736766e-17)
    assert sin_cos(HARDEST)[1] == pytest.approx(-4.687165924254624e-19, rel=1e-15)


def test_what_is_no_angle() -> None:
    assert all(math.isnan(part) for part in sin_cos(math.nan))
    for infinite in (math.inf, -math.inf):
        with pytest.raises(ValueError, match="inf"):
            sin_cos(infinite)


def test_sum_is_taken_in_order() -> None:
    """Not compensated, as the built-in sum is from Python 3.12 on: 1e16 swallows each 1."""
    assert dot((1e16, 1.0, 1.0, -1e16), (1.0, 1.0, 1.0, 1.0)) == 0.0


ordinary = st.floats(-1e6, 1e6) | st.floats(-1e-6, 1e-6) | st.sampled_from([0.0, -0.0, 1.0, -1.0])


@settings(max_examples=1000, deadline=None)
@given(ordinary, ordinary)
def test_angles_within_what_is_promised(y: float, x: float) -> None:
    with mp.workprec(200):
        exact = mp.atan2(mpf(y), mpf(x)) if x != 0.0 or y != 0.0 else mpf(math.atan2(y, x))
        if exact == 0 or abs(exact) == mp.pi:  # the signs of zeros, which mpmath does not know
            assert math.copysign(1.0, angle_of(y, x)) == math.copysign(1.0, math.atan2(y, x))
            exact = mpf(math.atan2(y, x))
        assert abs(angle_of(y, x) - exact) <= 4e-16


@settings(max_examples=1000, deadline=None)
@given(st.floats(-1.0, 1.0) | st.sampled_from([1.0, -1.0, 0.0, math.nextafter(1.0, 0.0)]))
def test_arcsines_within_what_is_promised(x: float) -> None:
    with mp.workprec(200):
        assert abs(arcsine(x) - mp.asin(mpf(x))) <= 4e-16


def test_no_arcsine_beyond_one() -> None:
    for x in (1.0000000000000002, -2.0):
        with pytest.raises(ValueError, match="math domain error"):
            arcsine(x)


@settings(max_examples=1000, deadline=None)
@given(st.floats(5e-324, 1.7e308) | st.floats(0.5, 2.0))
def test_logarithms_within_what_is_promised(x: float) -> None:
    with mp.workprec(200):
        exact = mp.log(mpf(x))
        assert abs(logarithm(x) - exact) <= 2e-16 + 2.0 * math.ulp(float(exact))


@pytest.mark.parametrize("x", [0.0, -1.0, math.inf, math.nan])
def test_no_logarithm_of_what_has_none(x: float) -> None:
    with pytest.raises(ValueError, match="must be finite and above zero"):
        logarithm(x)


@settings(max_examples=1000, deadline=None)
@given(st.floats(-700.0, 700.0) | st.floats(-1.0, 1.0))
def test_exponentials_within_what_is_promised(x: float) -> None:
    with mp.workprec(200):
        assert ulps(exponential(x), mp.exp(mpf(x))) <= 3.0
    assert exponential(0.0) == 1.0


@pytest.mark.parametrize("x", [700.1, -700.1, math.inf, -math.inf, math.nan])
def test_no_exponential_beyond_its_range(x: float) -> None:
    with pytest.raises(ValueError, match="must be within -700 to 700"):
        exponential(x)
