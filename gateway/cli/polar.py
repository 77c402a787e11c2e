"""A small polar picture in plain characters, as the robot is seen from above: forward is up, left is left."""

from collections.abc import Sequence
from math import cos, sin
from typing import Final

HALF_WIDTH: Final = 20  # columns from the middle to the largest value
HALF_HEIGHT: Final = 8  # rows; a character is about two and a half times as high as wide
_RING: Final = "o"


def polar(directions: Sequence[float], values: Sequence[float]) -> list[str]:
    """Lines of a closed curve. `values` of at least 0 in these `directions`, rad from forward to the left."""
    most = max(values, default=0.0) or 1.0
    grid = [[" "] * (2 * HALF_WIDTH + 1) for _ in range(2 * HALF_HEIGHT + 1)]
    for row in range(1, 2 * HALF_HEIGHT):
        grid[row][HALF_WIDTH] = "|"
    for column in range(1, 2 * HALF_WIDTH):
        grid[HALF_HEIGHT][column] = "-"
    grid[HALF_HEIGHT][HALF_WIDTH] = "+"
    for direction, value in zip(directions, values, strict=True):
        share = value / most
        row = HALF_HEIGHT - round(HALF_HEIGHT * share * cos(direction))
        grid[row][HALF_WIDTH - round(HALF_WIDTH * share * sin(direction))] = _RING
    return ["".join(row).rstrip() for row in grid]
