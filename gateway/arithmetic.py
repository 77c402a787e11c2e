"""Elementary functions with the same bits on every CPU. Pure: only + - * /, square roots, comparisons, whole numbers.

IEEE 754 fixes + - * / and the square root to the last bit, and nothing else: the C library's sine differs between
processors with and without fused multiply-add, and between versions. A session must verify on another machine, so the
core (everything that `tests/test_architecture.py` calls pure) takes its trigonometry from here, and uses neither `**`
(the C library's pow) nor the built-in `sum` of floats (it compensates from Python 3.12 on, and does not before).

How this works
--------------
x is reduced to x = k pi/2 + r with |r| <= pi/4, r carried as the sum of two floats; Taylor's polynomials give sine and
cosine of r; k says which of the two is which. The reduction subtracts k times pi/2 in three parts, of which the first
two have 33 bits, so that their products with a k of 20 bits are exact (Cody and Waite). Where this is not sure to be
enough (|x| beyond 1e6, or r so small that most of x has cancelled) r is computed in whole numbers instead, slowly.
The angle of a vector is guessed to 4 mrad and put right by sine and cosine of the guess: turned back by it, the vector
points along its small error, whose series is short.
"""

from collections.abc import Sequence
from math import copysign, floor, frexp, isinf, isnan, pi, sqrt
from typing import Final

REVISION: Final = "own, 1"  # told in every session; another one when a bit of a result changes, here or in `linear`

_EIGHTH: Final = 0.7853981633974483  # pi/4: nothing to reduce up to here
_TINY: Final = 7.450580596923828e-09  # 2^-27: the sine is its argument and the cosine 1, to less than half a last bit
_FAR: Final = 1e6  # k has 20 bits up to here
_CANCELLED: Final = 0.0009765625  # 2^-10: below it a remainder has lost more bits than three parts of pi/2 can replace

_QUARTERS_PER_RADIAN: Final = 0.6366197723675814  # 2/pi
_WHOLE: Final = 6755399441055744.0  # 1.5 * 2^52: floats there are whole numbers, so adding it rounds to the nearest one
_QUARTER_1: Final = float.fromhex("0x1.921fb544p+0")  # pi/2 = these three, to 119 bits
_QUARTER_2: Final = float.fromhex("0x1.0b4611a6p-34")
_QUARTER_3: Final = float.fromhex("0x1.3198a2e037073p-69")

# pi/2 times 2^1184. Of the largest float k has 1024 bits, and no float is nearer than 2^-62 to a multiple of pi/2, so
# 98 bits are left for the remainder.
_BITS: Final = 1184
_QUARTER: Final = int(
    "1921fb54442d18469898cc51701b839a252049c1114cf98e804177d4c76273644a29410f31c6809bbdf2a33679a74863"
    "6605614dbe4be286e9fc26adadaa3848bc90b6aecc4bcfd8de89885d34c6fdad617feb96de80d6fdbdc70d7f6b5133f4"
    "b5d3e4822f8963fcc9250cca3d9c8b67b8400f97142c77e0b31b4906c38aba734d22c7f51fa499ebf06caba47b9475b2"
    "c38c5e6ac",
    16,
)
_ONE: Final = 1 << _BITS


_HALF_ROOT: Final = 0.7071067811865476
_LN2_HIGH: Final = 0.6931471803691238  # 33 bits: its product with an exponent is exact
_LN2_LOW: Final = 1.9082149292705877e-10
_PER_LN2: Final = 1.4426950408889634


def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of x (rad), each with an error below 1 ulp for every finite x, odd and even to the bit.

    Up to 1e6 rad fast, beyond (and very near to a multiple of pi/2) some times slower, never less exact. Infinite x
    raises ValueError, as with `math.sin`; not-a-number gives two of its kind.
    """
    if -_EIGHTH <= x <= _EIGHTH:
        return (x, 1.0) if -_TINY < x < _TINY else _of_remainder(x, 0.0)
    quarters, r, tail = _reduced(x)
    sine, cosine = _of_remainder(r, tail)
    quadrant = quarters & 3
    if quadrant == 0:
        return sine, cosine
    if quadrant == 1:
        return cosine, -sine
    return (-sine, -cosine) if quadrant == 2 else (-cosine, sine)


def angle_of(y: float, x: float) -> float:
    """Angle of the vector (x, y), rad in -pi to pi, within 4e-16: `math.atan2` of finite numbers, zeros included."""
    height, width = abs(y), abs(x)
    if height > width:
        angle = 0.5 * pi - _of_slope(width / height)
    else:
        angle = _of_slope(height / width) if width > 0.0 else 0.0
    if x < 0.0 or (x == 0.0 and copysign(1.0, x) < 0.0):
        angle = pi - angle
    return angle if y > 0.0 else copysign(angle, y)


def arcsine(x: float) -> float:
    """Angle whose sine is x, rad in -pi/2 to pi/2, within 4e-16. Raises ValueError beyond -1 to 1."""
    return angle_of(x, sqrt((1.0 - x) * (1.0 + x)))


def logarithm(x: float) -> float:
    """Natural logarithm of a finite number above zero, within 2e-16 and 2 ulp. Raises ValueError for others."""
    if not x > 0.0 or isinf(x):
        message = f"logarithm of {x}: must be finite and above zero"
        raise ValueError(message)
    mantissa, exponent = frexp(x)
    if mantissa < _HALF_ROOT:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    z = (mantissa - 1.0) / (mantissa + 1.0)  # ln m = 2 (z + z^3/3 + z^5/5 ...), |z| below 0.172
    square = z * z
    series = 1.0 / 17.0 + square * (1.0 / 19.0 + square * (1.0 / 21.0 + square * (1.0 / 23.0)))
    series = 1.0 / 9.0 + square * (1.0 / 11.0 + square * (1.0 / 13.0 + square * (1.0 / 15.0 + square * series)))
    series = square * (1.0 / 3.0 + square * (1.0 / 5.0 + square * (1.0 / 7.0 + square * series)))
    return exponent * _LN2_HIGH + (2.0 * z + (2.0 * z * series + exponent * _LN2_LOW))


def exponential(x: float) -> float:
    """e^x for x within -700 to 700, within 3 ulp. Raises ValueError for others."""
    if not -700.0 <= x <= 700.0:
        message = f"exponential of {x}: must be within -700 to 700"
        raise ValueError(message)
    power = floor(x * _PER_LN2 + 0.5)
    rest = (x - power * _LN2_HIGH) - power * _LN2_LOW  # up to 0.347: the series ends below a last bit
    series = 0.0
    for step in range(14, 0, -1):
        series = rest / step * (1.0 + series)
    scale = float(1 << abs(power))
    return (1.0 + series) * scale if power >= 0 else (1.0 + series) / scale


def _of_slope(slope: float) -> float:
    """Angle of a vector in the first eighth."""
    guess = slope * (_EIGHTH + 0.273 * (1.0 - slope))  # within 4 mrad
    sine, cosine = _of_remainder(guess, 0.0)
    left = (slope * cosine - sine) / (cosine + slope * sine)
    square = left * left
    return guess + left * (1.0 - square * (1.0 / 3.0 - square * (1.0 / 5.0)))


def dot(vector: Sequence[float], other: Sequence[float]) -> float:
    """The scalar product, summed from the first to the last."""
    total = 0.0
    for one, two in zip(vector, other):
        total += one * two
    return total


def _of_remainder(r: float, tail: float) -> tuple[float, float]:
    """Sine and cosine of r + tail, |r| <= pi/4 and |tail| <= 1 ulp of r: of the tail only what the last bit feels."""
    z = r * r
    odd = -1 / 39916800 + z * (1 / 6227020800 + z * (-1 / 1307674368000 + z * (1 / 355687428096000)))
    odd = z * (-1 / 6 + z * (1 / 120 + z * (-1 / 5040 + z * (1 / 362880 + z * odd))))
    even = -1 / 3628800 + z * (1 / 479001600 + z * (-1 / 87178291200 + z * (1 / 20922789888000)))
    even = z * (z * (1 / 24 + z * (-1 / 720 + z * (1 / 40320 + z * even))))
    half = 0.5 * z
    near = 1.0 - half  # what this rounding takes away is given back below
    return r + (r * odd + tail * near), near + (((1.0 - near) - half) + (even - r * tail))


def _reduced(x: float) -> tuple[int, float, float]:
    """x = k pi/2 + r + tail, for |x| > pi/4: k, r and the tail below r's last bit."""
    if -_FAR <= x <= _FAR:
        quarters = (x * _QUARTERS_PER_RADIAN + _WHOLE) - _WHOLE
        rest = x - quarters * _QUARTER_1  # exact
        part = quarters * _QUARTER_2  # exact
        near = rest - part
        if near > _CANCELLED or near < -_CANCELLED:
            low = ((rest - near) - part) - quarters * _QUARTER_3  # where x is large, more than the last bit of `near`
            r = near + low
            return int(quarters), r, (near - r) + low
    return _reduced_exactly(x)


def _reduced_exactly(x: float) -> tuple[int, float, float]:
    """The same for every finite x, in whole numbers of 2^-1184."""
    if isnan(x):
        return 0, x, x
    if isinf(x):
        message = f"sine and cosine of {x}"
        raise ValueError(message)
    scaled = _scaled(x)
    quarters = (2 * scaled + _QUARTER) // (2 * _QUARTER)
    rest = scaled - quarters * _QUARTER
    r = rest / _ONE
    return quarters, r, (rest - _scaled(r)) / _ONE


def _scaled(x: float) -> int:
    """x times 2^1184; exact for everything that comes here."""
    numerator, denominator = x.as_integer_ratio()
    return numerator * _ONE // denominator
