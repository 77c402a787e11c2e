"""Every kind of chassis. A new one is a file here and its name in both lines below; its plant is in `replay.sim`."""

from typing import Final

from gateway.chassis.contract import Chassis
from gateway.chassis.mecanum import MecanumRobot
from gateway.chassis.odd import OddRobot
from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.chassis.omni import OmniRobot

AnyRobot = OmniRobot | MecanumRobot | OddRobot | OffsetDifferentialRobot  # by its `kind` in the robot file
CHASSIS: Final[dict[str, type[Chassis]]] = {
    "omni": OmniRobot,
    "mecanum": MecanumRobot,
    "odd": OddRobot,
    "offset_differential": OffsetDifferentialRobot,
}
