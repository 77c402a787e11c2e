"""What wheels say of each other, where there are more than ways to move: the geometry of slip (Rojas 2005, section 9).

How this works
--------------
A wheel k that slips by s (m/s at its rim, positive where it runs ahead) makes the rim speeds m = D v + s e_k. What no
rigid motion explains of them is P m = s P e_k with P = I - D D+, and the motion that fits best is wrong by s D+ e_k.
So from the residual of wheel k alone s = r_k / P_kk, and the directions P e_k tell the wheels apart: of four wheels all
of them are one line, so that the residual never says which; of five and more they differ.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import dot
from gateway.kinematics.linear import Matrix, kernel, pseudo_inverse, transpose

BLIND: Final = 1e-9  # of P_kk: below it the wheel's slip leaves no residual at all
# Of the sine between two directions P e_k: below it a residual of one wheel passes for one of the other within the
# noise of any real wheel.
_ALIKE: Final = 0.1


class Check(NamedTuple):
    """Of one set of measured wheels. All but `places` are per measured wheel, in their order.

    `sizes`: how much of an error of each wheel is in the residual of this one. `own`: P_kk. `shares`: m/s, m/s and
    rad/s of the body by which a slip of 1 m/s puts the motion wrong that fits best. `told`: whether its slip can be
    told from that of every other wheel by the residuals alone. `together`: by which 1 m/s of all
    wheels puts it wrong at most.
    """

    places: tuple[int, ...]
    sizes: Matrix
    own: tuple[float, ...]
    shares: tuple[tuple[float, float, float], ...]
    told: tuple[bool, ...]
    together: tuple[float, float, float]


class Redundancy:
    """Checks of every set of wheels, found when first asked for. `rim_rows`: m/s at the rim per unit of each axis."""

    def __init__(self, rim_rows: Matrix) -> None:
        self._rows = rim_rows
        self._known: dict[tuple[bool, ...], Check | None] = {}

    def of(self, measured: tuple[bool, ...]) -> Check | None:
        """What these wheels can be held against each other by; None: any speeds of theirs fit some motion."""
        if measured not in self._known:
            self._known[measured] = self._compute(measured)
        return self._known[measured]

    def _compute(self, measured: tuple[bool, ...]) -> Check | None:
        places = tuple([place for place, known in enumerate(measured) if known])
        rows = tuple([self._rows[place] for place in places])
        if len(rows) <= len(self._rows[0]):
            return None
        basis = kernel(transpose(rows))
        size = len(rows)
        projector = [[_entry(basis, i, j) for j in range(size)] for i in range(size)]
        inverse = pseudo_inverse(rows)
        x, y, turn = [dot([abs(part) for part in row], [1.0] * size) for row in inverse[:3]]
        return Check(
            places=places,
            sizes=tuple([tuple([abs(part) for part in row]) for row in projector]),
            own=tuple([projector[i][i] for i in range(size)]),
            shares=tuple([(inverse[0][i], inverse[1][i], inverse[2][i]) for i in range(size)]),
            told=tuple([_stands_alone(projector, i) for i in range(size)]),
            together=(x, y, turn),
        )


def _entry(basis: Matrix, i: int, j: int) -> float:
    return dot([vector[i] for vector in basis], [vector[j] for vector in basis])


def _stands_alone(projector: Sequence[Sequence[float]], place: int) -> bool:
    """Whether the direction P e_k of this wheel is that of no other; |P e_k|^2 = P_kk and P e_k . P e_l = P_kl."""
    own = projector[place][place]
    if own <= BLIND:
        return False
    for other, row in enumerate(projector):
        if other != place and row[other] > BLIND:
            cosine = row[place] / sqrt(own * row[other])
            if 1.0 - cosine * cosine < _ALIKE * _ALIKE:
                return False
    return True
