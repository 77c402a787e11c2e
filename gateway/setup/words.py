"""What a person at the robot sees when a joint turns positively. Pure."""

from math import pi, remainder, tau
from typing import Final

from gateway.arithmetic import angle_of
from gateway.chassis.contract import Chassis
from gateway.config import RobotConfig
from gateway.setup.signs import JointSign, WheelSign, signs

UNSEEN: Final = (
    "Motors that all turn the other way, or that are mixed up left and right, drive alike in the simulation, and no "
    "file shows them: `drivegate setup directions {file}` tries each motor while you watch."
)
EXACT: Final = 1.0  # degrees
_QUARTERS: Final = {0: "forward", 90: "to the left", -90: "to the right", 180: "backward", -180: "backward"}


def positive_ways(robot: Chassis) -> dict[str, str]:
    """By motor, in chassis order: where the wheel rolls, or how the body turns."""
    return {sign.motor: _way(sign) for sign in signs(robot)}


def _way(sign: WheelSign | JointSign) -> str:
    if isinstance(sign, JointSign):
        turn = "counter-clockwise" if sign.turns > 0.0 else "clockwise"
        return f"the body turns {turn}, as seen from above, on what carries it"
    x, y = sign.way
    return f"the wheel rolls {rolling(angle_of(y, x))}"


def zero_way(config: RobotConfig, motor: str) -> str:
    """How a steered joint stands at its zero."""
    beneath = config.robot.drawing().beneath
    if beneath is not None and config.robot.motor_names()[beneath] == motor:
        return "the body looks to where the wheels beneath it roll when both roll forward"
    return "it stands at its zero"


def rolling(angle: float) -> str:
    """A direction on the floor, rad counter-clockwise from forward, in words."""
    turned = remainder(angle, tau) * 180.0 / pi
    for quarter, word in _QUARTERS.items():
        if abs(turned - quarter) < EXACT:
            return word
    side = "left" if turned > 0.0 else "right"
    return f"{abs(turned):.0f} degrees to the {side} of forward"
