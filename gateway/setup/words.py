"""What a person at the robot sees when a joint turns positively. Pure."""

from math import pi, remainder, tau
from typing import Final

from gateway.config import RobotConfig

EXACT: Final = 1.0  # degrees
_QUARTERS: Final = {0: "forward", 90: "to the left", -90: "to the right", 180: "backward", -180: "backward"}


def positive_ways(config: RobotConfig) -> dict[str, str]:
    """By motor, in chassis order: where the wheel rolls, or how the body turns."""
    drawing = config.robot.drawing()
    ways = {}
    for place, motor in enumerate(config.robot.motor_names()):
        if place == drawing.beneath:
            ways[motor] = "the body turns counter-clockwise, as seen from above, on what carries it"
        elif place < len(drawing.wheels):
            ways[motor] = f"the wheel rolls {rolling(drawing.wheels[place].rolling)}"
        else:
            ways[motor] = "the joint turns positively"
    return ways


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
