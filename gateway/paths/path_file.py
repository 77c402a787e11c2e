"""The path file: TOML, SI, unknown keys refused.

    joints = "tangent"     # left out: tangent; or "on_axle", of lines and arcs only, for a pulled robot: see `rules`

    [start]                # where the path begins and which way it goes; left out: 0, 0, 0
    x = 1.0
    y = 0.0
    heading = 0.5

    [[piece]]
    kind = "arc"           # line (length), arc (radius, angle), clothoid (length), corner (angle)
    radius = 5.0
    angle = 1.0472         # rad, positive to the left

A clothoid leads from the curvature of the piece before it to that of the piece after it, evenly; a path begins and ends
straight.
"""

from collections.abc import Iterator, Sequence
from math import copysign
from typing import Annotated, Literal

from pydantic import Field

from gateway.config import ConfigError, parse_as
from gateway.paths.path import Path, Piece
from gateway.sections import Section
from gateway.types import Pose

Way = Annotated[float, Field(ge=1e-3, le=1e3, description="m")]
Place = Annotated[float, Field(ge=-1e5, le=1e5, description="m")]
Turn = Annotated[float, Field(ge=-65.0, le=65.0, description="rad")]
MOST_PIECES = 1000


class Start(Section):
    """Where the path begins, and its direction there."""

    x: Place = 0.0
    y: Place = 0.0
    heading: Annotated[float, Field(ge=-6.3, le=6.3, description="rad")] = 0.0


class Line(Section):
    """Straight on."""

    kind: Literal["line"]
    length: Way


class Arc(Section):
    """Part of a circle."""

    kind: Literal["arc"]
    radius: Way
    angle: Turn


class Clothoid(Section):
    """From the curvature before it to the one after it."""

    kind: Literal["clothoid"]
    length: Way


class Corner(Section):
    """A turn at once: for robots that can."""

    kind: Literal["corner"]
    angle: Annotated[float, Field(ge=-3.2, le=3.2, description="rad")]


AnyPiece = Annotated[Line | Arc | Clothoid | Corner, Field(discriminator="kind")]


class PathFile(Section):
    """What a path file says."""

    joints: Literal["tangent", "on_axle"] = "tangent"
    start: Start = Start()
    piece: Annotated[list[AnyPiece], Field(min_length=1, max_length=MOST_PIECES)]


def parse(text: str, origin: str) -> Path:
    """The path that a file describes. Raises ConfigError."""
    file = parse_as(PathFile, text, origin)
    on_axle = file.joints == "on_axle"
    problems = [*_problems(file.piece), *(_problems_on_axle(file.piece) if on_axle else ())]
    if problems:
        raise ConfigError(origin, problems)
    pieces = [_made(file.piece, number) for number in range(len(file.piece))]
    return Path(Pose(file.start.x, file.start.y, file.start.heading), pieces, on_axle=on_axle)


def _problems(pieces: Sequence[AnyPiece]) -> Iterator[str]:
    for number, piece in enumerate(pieces):
        if isinstance(piece, Arc) and piece.angle == 0.0:
            yield f"piece[{number}].angle = 0.0: an arc must turn; write a line"
        if isinstance(piece, Clothoid) and number and isinstance(pieces[number - 1], Clothoid):
            yield f"piece[{number}]: a clothoid behind a clothoid: which curvature is between them is not told"


def _problems_on_axle(pieces: Sequence[AnyPiece]) -> Iterator[str]:
    for number, piece in enumerate(pieces):
        if not isinstance(piece, Line | Arc):
            yield f"piece[{number}] ({piece.kind}): must be a line or an arc where joints are on_axle"


def _made(pieces: Sequence[AnyPiece], number: int) -> Piece:
    piece, words = pieces[number], f"piece[{number}] ({pieces[number].kind})"
    match piece:
        case Line():
            return Piece(words, piece.length, 0.0, 0.0)
        case Arc():
            curvature = copysign(1.0 / piece.radius, piece.angle)
            return Piece(words, abs(piece.angle) * piece.radius, curvature, curvature)
        case Clothoid():
            return Piece(words, piece.length, _curvature(pieces, number - 1), _curvature(pieces, number + 1))
        case Corner():
            return Piece(words, 0.0, 0.0, 0.0, piece.angle)


def _curvature(pieces: Sequence[AnyPiece], number: int) -> float:
    """Of a neighbour, 1/m; zero for what is straight, and before and behind the path."""
    neighbour = pieces[number] if 0 <= number < len(pieces) else None
    return copysign(1.0 / neighbour.radius, neighbour.angle) if isinstance(neighbour, Arc) else 0.0
