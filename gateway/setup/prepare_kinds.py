"""What `drivegate setup prepare` knows of each driver's controllers: one row for each in `drivers.DRIVERS`. Pure."""

from collections.abc import Callable
from typing import Final, NamedTuple

from gateway.config import Bus, Motor
from gateway.setup import prepare_dji, prepare_odrive, prepare_vesc
from gateway.setup.preparation import Ear, Line


class Kind(NamedTuple):
    """`heard_lines`: what listening tells. `by_hand`: what to set with the vendor's tool, a step each."""

    heard_lines: Callable[[Ear, Motor, Bus], list[Line]]
    by_hand: Callable[[Motor, Bus], list[str]]


KINDS: Final[dict[str, Kind]] = {
    "odrive": Kind(prepare_odrive.heard_lines, prepare_odrive.by_hand),
    "dji": Kind(prepare_dji.heard_lines, prepare_dji.by_hand),
    "vesc": Kind(prepare_vesc.heard_lines, prepare_vesc.by_hand),
}
