"""How the simulated robot moves, per chassis kind. A new chassis is one file here and one line in `PLANTS`."""

from collections.abc import Callable
from typing import Any

from replay.sim.plants import offset_differential, omni
from replay.sim.plants.contract import Plant

PLANTS: dict[str, Callable[[Any], Plant]] = {
    "omni": omni.plant,
    "offset_differential": offset_differential.plant,
}
