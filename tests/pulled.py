"""An offset-differential robot as a point and a heading, by the closed form of science 1.3: for tests of drives.

The platform keeps heading 0, so its frame is the floor's and the joint angle minus the chassis heading.
"""

import math


class PulledRobot:
    """Joint at (x, y), chassis heading; a velocity is held for a cycle and the chassis follows it exactly."""

    def __init__(self, d1: float, heading: float, x: float = 0.0, y: float = 0.0) -> None:
        self.d1, self.heading, self.x, self.y = d1, heading, x, y

    def move(self, vx: float, vy: float, dt: float) -> None:
        """tan(gamma/2) falls e-fold every d1 of way; the chassis turns by what gamma loses."""
        self.x, self.y = self.x + vx * dt, self.y + vy * dt
        way = math.hypot(vx, vy) * dt
        if way == 0.0:
            return
        gamma = math.remainder(math.atan2(vy, vx) - self.heading, math.tau)
        after = 2.0 * math.atan2(math.sin(gamma / 2.0) * math.exp(-way / self.d1), math.cos(gamma / 2.0))
        self.heading += gamma - after
