"""What a command asks of the axes that a chassis has beyond the twist."""

from collections.abc import Callable
from typing import Final

from gateway.types import Rates, TwistCommand

# How a command tells the target of such an axis; None: it does not, which is zero.
MORE: Final[dict[str, Callable[[TwistCommand], float | None]]] = {"width_rate": lambda command: command.width_rate}


def more_of(command: TwistCommand, axes: tuple[str, ...]) -> Rates:
    """Targets of these axes beyond the twist."""
    return tuple([MORE[axis](command) or 0.0 for axis in axes])
