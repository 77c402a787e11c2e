"""How the simulated robot moves, per chassis kind. A new chassis is one file here and one row in `PLANTS`."""

from collections.abc import Callable
from typing import Any, Protocol

from replay.sim.plants import mecanum, odd, odd_dynamics, offset_caster, offset_differential, omni, omni_dynamics
from replay.sim.plants.contract import Plant, PlantName

PLANTS: dict[str, dict[PlantName, Callable[[Any], Plant]]] = {
    "omni": {PlantName.SIMPLE: omni.plant, PlantName.DYNAMICS: omni_dynamics.plant},
    "mecanum": {PlantName.SIMPLE: mecanum.plant},
    "odd": {PlantName.SIMPLE: odd.plant, PlantName.DYNAMICS: odd_dynamics.plant},
    "offset_differential": {PlantName.SIMPLE: offset_differential.plant, PlantName.DYNAMICS: offset_caster.plant},
}


class _OfKind(Protocol):
    """The section `robot` of a robot file."""

    @property
    def kind(self) -> str: ...


def plant_of(robot: _OfKind, name: PlantName = PlantName.SIMPLE) -> Plant:
    """The plant of this name for the robot of a robot file. Raises ValueError where it has none, with the reason."""
    row = PLANTS[robot.kind]
    if name not in row:
        known = ", ".join(repr(one.value) for one in row)
        raise ValueError(f"plant = {name.value!r}: for a robot of kind {robot.kind} there is {known}")
    try:
        return row[name](robot)
    except ValueError as error:
        raise ValueError(f"plant = {name.value!r}: {error}") from None
