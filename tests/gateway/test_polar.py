"""The polar picture of `check`: where each direction lies, by hand."""

from math import pi

from gateway.cli.polar import HALF_HEIGHT, HALF_WIDTH, polar


def places(lines: list[str]) -> set[tuple[int, int]]:
    """Of the curve: rows up and columns to the left of the middle."""
    return {
        (HALF_HEIGHT - row, HALF_WIDTH - column)
        for row, line in enumerate(lines)
        for column, mark in enumerate(line)
        if mark == "o"
    }


def test_forward_is_up_and_left_is_left() -> None:
    assert places(polar((0.0, pi / 2, pi, -pi / 2), (2.0, 1.0, 1.0, 2.0))) == {(8, 0), (0, 10), (-4, 0), (0, -20)}


def test_the_largest_value_fills_the_picture_and_nothing_is_a_point_in_the_middle() -> None:
    assert places(polar((0.0, pi / 4), (0.001, 0.0))) == {(8, 0), (0, 0)}
    assert places(polar((0.0,), (0.0,))) == {(0, 0)}
    lines = polar((pi / 4,), (1.0,))
    assert len(lines) == 2 * HALF_HEIGHT + 1
    assert places(lines) == {(6, 14)}
    assert all(len(line) <= 2 * HALF_WIDTH + 1 for line in lines)
