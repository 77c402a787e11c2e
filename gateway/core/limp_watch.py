"""Whether a robot that limps comes to move in a way that no motor left can change.

How this works
--------------
Motors that are left set the speeds of their wheels; what turns none of these wheels goes on as mass and friction have
it. It need not die away: a body that is led by two wheels ahead of its middle turns away from its course by itself, as
a Chaplygin sleigh does, e-fold every (I + m a^2)/(m a) of way (a: from the middle to where the axles of both meet). So
limping ends as soon as such a motion has grown by SHARE of the speed at which it limps; as long as the robot slows down
from before the loss there is more of it, and it falls.
Only of wheels that no joint steers: what a joint drags along (a platform whose motor is lost) is bounded by that.
"""

from typing import Final

from gateway.control.limits import excess
from gateway.kinematics.reachable import Reachable
from gateway.types import Rates

SHARE: Final = 0.5


class LimpWatch:
    """Remembers the least there was of it since the robot began to limp."""

    def __init__(self, velocity: Rates, speed: float) -> None:
        """`velocity`: limits of the body; `speed`: share of them at which it limps."""
        self._velocity = velocity
        self._bound = SHARE * speed
        self._least: float | None = None

    def look(self, reach: Reachable | None, rates: Rates | None) -> str | None:
        """Take a cycle: what is left (None: it does not limp) and how the body moves; what is wrong, in words."""
        if reach is None or rates is None or not reach.lost:
            self._least = None
            return None
        nearest = reach.nearest(rates)
        adrift = tuple([whole - part for whole, part in zip(rates, nearest)])
        size = excess(adrift, self._velocity)
        if self._least is None or size < self._least:
            self._least = size
        if size - self._least <= self._bound:
            return None
        vx, vy, wz = adrift[:3]
        return f"it comes to move by {vx:.2f}, {vy:.2f} m/s and {wz:.2f} rad/s that no motor left can change"
