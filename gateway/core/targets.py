"""What a command asks of every axis: its twist, and what axes a chassis may have more."""

from collections.abc import Callable
from typing import Final

from gateway.types import ZERO_TWIST, Rates, TwistCommand

# How a command tells the target of an axis beyond the twist; None: it does not, which is zero.
MORE: Final[dict[str, Callable[[TwistCommand], float | None]]] = {}


def more_of(command: TwistCommand, axes: tuple[str, ...]) -> Rates:
    """Targets of these axes beyond the twist."""
    return tuple([(MORE[axis](command) or 0.0) if axis in MORE else 0.0 for axis in axes])


def is_zero(command: TwistCommand) -> bool:
    """Whether it asks for rest in every axis there may be."""
    return command.twist == ZERO_TWIST and not any(read(command) for read in MORE.values())
