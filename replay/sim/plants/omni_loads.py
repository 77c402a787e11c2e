"""What each wheel of a rigid robot carries.

How this works
--------------
Three equations (the weight, and its moments about two axes of the floor) do not determine the loads of four wheels. Of
all solutions the one with the least sum of squares is taken: that of wheels, or of tyres, of equal stiffness under a
rigid body, which makes the load an affine function of the wheel's place. No wheel pulls: one that would is lifted, and
the others share anew. Where those left stand in one line the robot would tip over; it does not here, they carry
its weight as if they stood as they do.
"""

from collections.abc import Sequence

Place = tuple[float, float]
_Shares = tuple[tuple[float, float, float], ...]  # per wheel: N per N of weight, per N m of each moment
_LINE = 1e-9  # of the product of its diagonal: a determinant below it is none


class Standing:
    """Wheels at these places (m). Raises ValueError where all stand in one line."""

    def __init__(self, places: Sequence[Place]) -> None:
        self._places = tuple(places)
        every = tuple([True] * len(self._places))
        shares = _shares(self._places, every)
        if shares is None:
            raise ValueError("all wheels stand in one line: the robot would fall over")
        self._known: dict[tuple[bool, ...], _Shares | None] = {every: shares}
        self._every = every

    def loads(self, weight: float, along: float = 0.0, across: float = 0.0) -> tuple[float, ...]:
        """N per wheel, none below zero, with sum = weight, sum of x load = along, of y load = across (N m)."""
        standing, loads = self._every, (0.0,) * len(self._places)
        while any(standing):
            shares = self._shares_of(standing)
            if shares is None:
                break
            loads = tuple([weight * one + along * two + across * three for one, two, three in shares])
            if min(loads) >= 0.0:
                return loads
            standing = tuple([load > 0.0 for load in loads])
        return _scaled([max(0.0, load) for load in loads], weight)

    def _shares_of(self, standing: tuple[bool, ...]) -> _Shares | None:
        if standing not in self._known:
            self._known[standing] = _shares(self._places, standing)
        return self._known[standing]


def _shares(places: Sequence[Place], standing: Sequence[bool]) -> _Shares | None:
    """Of those that stand, G' (G G')^-1 with the columns (1, x, y) of G; None where they are in one line."""
    n = sx = sy = sxx = sxy = syy = 0.0
    for (x, y), stands in zip(places, standing, strict=True):
        if stands:
            n, sx, sy = n + 1.0, sx + x, sy + y
            sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
    c11, c12, c13 = sxx * syy - sxy * sxy, sy * sxy - sx * syy, sx * sxy - sy * sxx
    c22, c23, c33 = n * syy - sy * sy, sx * sy - n * sxy, n * sxx - sx * sx
    determinant = n * c11 + sx * c12 + sy * c13
    if not abs(determinant) > _LINE * n * sxx * syy:
        return None
    scale = 1.0 / determinant
    return tuple(
        [
            (
                scale * (c11 + c12 * x + c13 * y),
                scale * (c12 + c22 * x + c23 * y),
                scale * (c13 + c23 * x + c33 * y),
            )
            if stands
            else (0.0, 0.0, 0.0)
            for (x, y), stands in zip(places, standing, strict=True)
        ]
    )


def _scaled(loads: Sequence[float], weight: float) -> tuple[float, ...]:
    total = 0.0
    for load in loads:
        total += load
    return tuple([load * weight / total for load in loads])
