"""Two bodies on slides: forces that each pair of an ODD needs, in the axes of the body (arXiv 2407.10127, corrected).

The printed equations 9 to 11 have other Coriolis terms and another sign of the width; these follow from Newton's law
of a mass at y = +d/2 (L) or -d/2 (R) in axes that turn, with B their middle.
"""

from typing import NamedTuple


class PairForces(NamedTuple):
    """N on each pair, along and to the left of the body."""

    left: tuple[float, float]
    right: tuple[float, float]


class TwoBodies(NamedTuple):
    """Masses of the pairs, kg, each at its middle."""

    left: float
    right: float

    def centre(self, width: float) -> float:
        """Of mass, m to the left of the middle."""
        return 0.5 * width * (self.left - self.right) / (self.left + self.right)

    def inertia(self, width: float) -> float:
        """About the vertical through the centre of mass, kg m^2."""
        return self.left * self.right / (self.left + self.right) * width * width

    def forces(
        self,
        width: float,
        rates: tuple[float, float, float, float],
        changes: tuple[float, float, float, float],
    ) -> PairForces:
        """For these rates of the four axes, changing so: derivatives of the numbers, in axes that turn."""
        return PairForces(
            _force(self.left, 0.5 * width, 0.5, rates, changes), _force(self.right, -0.5 * width, -0.5, rates, changes)
        )


def _force(
    mass: float,
    place: float,
    share: float,
    rates: tuple[float, float, float, float],
    changes: tuple[float, float, float, float],
) -> tuple[float, float]:
    """Of a mass at `place`, m to the left, which moves by this share of the width."""
    (vx, vy, wz, rate), (ax, ay, wz_change, rate_change) = rates, changes
    along = ax - wz_change * place - wz * (vy + 2.0 * share * rate)
    across = ay + share * rate_change + wz * (vx - wz * place)
    return mass * along, mass * across
