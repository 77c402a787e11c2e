"""What a path must be so that an offset-differential robot can be pulled along it (section 5 of preprints202312.1327).

Rule 1: smooth, and at its start tangent to the direction in which the chassis is in balance, pulled (Eq. 22). Rule 2:
no turn tighter than d1. A robot without an offset axle has none of these rules.
The other strategy of that section gives up rule 1: where the curvature jumps, the direction jumps with it, so that the
instant centre of rotation stays on the axle. Then no error of gamma arises that would have to be corrected, and the
wheels have to change their speeds at once.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from gateway.control.pull_region import goal_of, wrapped
from gateway.paths.path import Path, Piece

START_TOLERANCE: Final = 0.05  # rad, of the chassis from its balance at the start
_LEAST_STRETCH: Final = 6.0  # axle offsets; with less than 3.3 merging and compensation swing against each other
_ROUNDING: Final = 1.0 + 1e-9


def problems(path: Path, axle_offset: float) -> list[str]:
    """Where the path breaks a rule; none: it can be driven."""
    return [
        f"{piece.words}, {start:.3f} m from the start: {problem}"
        for piece, start in zip(path.pieces, path.starts, strict=True)
        for problem in _problems(piece, axle_offset, corners=path.on_axle)
    ]


def _problems(piece: Piece, axle_offset: float, *, corners: bool) -> Iterator[str]:
    if piece.corner != 0.0 and not corners:
        yield f"turns by {piece.corner:g} rad at once: a chassis is pulled along smooth paths only"
    sharpest = max(abs(piece.before), abs(piece.after))
    if sharpest * axle_offset > _ROUNDING:
        yield f"radius {1.0 / sharpest:.4g} m: must be at least the axle offset, {axle_offset:g} m"


def start_error(path: Path, chassis_heading: float, axle_offset: float) -> float:
    """How far the path's start is from the balance of the chassis, pulled, rad: gamma - gamma_goal (Eq. 22)."""
    point = path.at(0.0)
    return wrapped(point.heading - chassis_heading - _balance(point.curvature, axle_offset))


def start_problem(path: Path, chassis_heading: float, axle_offset: float) -> str | None:
    """None where the chassis lies for the path as it stands."""
    error = start_error(path, chassis_heading, axle_offset)
    if abs(error) <= START_TOLERANCE:
        return None
    return (
        f"start: {error:+.3f} rad from the direction in which the chassis is pulled: must be within {START_TOLERANCE:g}"
    )


def least_stretch(axle_offset: float, blind_way: float) -> float:
    """Shortest stretch over which a pulled robot may merge, m; `blind_way`: m from plan to plan.

    A change of curvature makes an error of gamma, and correcting that shifts the robot: y' = psi - k e,
    e' = -(k - 1) e/d1 + d1 kappa'. With kappa' of the follower planning all the time the loop is stable from 3.3 d1 of
    stretch on for every k from 1 to 4 (Routh; source: ours); with 6 d1 half of the decay is left at k = 2.
    """
    return _LEAST_STRETCH * axle_offset + 2.0 * blind_way


def joined_on_axle(path: Path, axle_offset: float) -> Path:
    """The same pieces joined so that the instant centre of rotation stays on the axle where the curvature jumps.

    Between curvatures a and b the direction turns at once by asin(d1 a) - asin(d1 b) while the chassis does not turn.
    No piece may turn tighter than d1.
    """
    joined = [
        piece._replace(corner=_balance(piece.before, axle_offset) - _balance(before.after, axle_offset))
        for before, piece in pairwise(path.pieces)
    ]
    return Path(path.start, [*path.pieces[:1], *joined], on_axle=True)


def _balance(curvature: float, axle_offset: float) -> float:
    """gamma_goal, rad; a turn that is tighter than d1 by its rounding alone is one of d1."""
    return goal_of(curvature, 1.0, axle_offset)[0]
