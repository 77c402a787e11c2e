"""How the simulated robot moves, per chassis kind. A new chassis is one file here and one row in `PLANTS`."""

from collections.abc import Callable
from typing import Any, Protocol

from replay.sim.plants import offset_caster, offset_differential, omni
from replay.sim.plants.contract import Plant

SIMPLE = "simple"  # one rigid body on its wheels; every kind has it
DYNAMICS = "dynamics"  # every body that the robot is made of

PLANTS: dict[str, dict[str, Callable[[Any], Plant]]] = {
    "omni": {SIMPLE: omni.plant},
    "offset_differential": {SIMPLE: offset_differential.plant, DYNAMICS: offset_caster.plant},
}
NAMES = tuple(dict.fromkeys(name for row in PLANTS.values() for name in row))


class _OfKind(Protocol):
    """The section `robot` of a robot file."""

    @property
    def kind(self) -> str: ...


def plant_of(robot: _OfKind, name: str = SIMPLE) -> Plant:
    """The plant of this name for the robot of a robot file. Raises ValueError where it has none, with the reason."""
    row = PLANTS[robot.kind]
    if name not in row:
        raise ValueError(f"plant = {name!r}: a robot of kind {robot.kind} has {', '.join(row)}")
    try:
        return row[name](robot)
    except ValueError as error:
        raise ValueError(f"plant = {name!r}: {error}") from None
