"""One cycle of a drive in virtual time: what the robot did, and what really happened."""

from math import hypot
from typing import NamedTuple

from gateway.types import Inputs, Outputs, Twist
from replay.sim.robot import Truth


class Moment(NamedTuple):
    """`t`: s since the first cycle; `asked`: what the winning source asks for, None while all are silent."""

    t: float
    inputs: Inputs
    outputs: Outputs
    truth: Truth
    asked: Twist | None

    @property
    def speed(self) -> float:
        """True speed over the ground, m/s; turning does not count."""
        return hypot(self.truth.twist.vx, self.truth.twist.vy)
