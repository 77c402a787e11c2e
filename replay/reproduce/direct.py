"""The dynamics without the service: torques of a motion that is given, and motions of torques that come late.

Section 7 of the paper: along x, evenly faster in the first quarter of the time, 1.2 m/s, evenly slower in the last;
1 kHz, forward Euler, no friction. Its duration is not printed, nor is any length; see science 1.6 and 1.7.
"""

from math import cos, hypot, pi
from typing import NamedTuple

import numpy as np

from replay.sim.plants.offset_dynamics import Array, OffsetDynamics
from replay.sim.plants.offset_parameters import JOINT, PLATFORM, SETS, SWIVEL

TOP = 1.2  # m/s; printed
PERIOD = 1e-3  # s; printed
DURATIONS = {"A": 6.72, "B": 6.72, "C": 6.764, "D": 6.71}  # s; fitted to the compensated force F = m a (science 1.7)
SEED = 2e-3  # rad of gamma_err at the start, which makes the flip happen at a certain time (science 1.7)


class Profile(NamedTuple):
    """The commanded speed along x over the time."""

    duration: float

    def acceleration(self, t: float) -> float:
        """m/s^2."""
        quarter = min(max(int(4.0 * t / self.duration), 0), 3)
        return (1.0, 0.0, 0.0, -1.0)[quarter] * 4.0 * TOP / self.duration

    def speed(self, t: float) -> float:
        """m/s."""
        slope = 4.0 * TOP / self.duration
        return max(0.0, min(TOP, slope * t, slope * (self.duration - t)))


class Instant(NamedTuple):
    """s, rad, N m of the wheels' motors, N of the ground on all wheels (the magnitude of the sum of its vectors)."""

    t: float
    heading: float
    swivel: float
    left: float
    right: float
    force: float


def posed(heading: float, swivel: float) -> Array:
    """At the origin, the chassis at this heading, the platform at zero."""
    place = np.zeros(8)
    place[JOINT], place[SWIVEL] = -heading, swivel
    return place


def heading_of(place: Array) -> float:
    """Of the chassis, rad."""
    return float(place[PLATFORM] - place[JOINT])


def prescribed(name: str, *, heading: float, swivel: float = 0.0, until: float = 1.0) -> list[Instant]:
    """What a set needs for the motion of Section 7, the chassis as it comes. `until`: share of the time."""
    robot, profile = OffsetDynamics(SETS[name]), Profile(DURATIONS[name])
    place, found = posed(heading, swivel), []
    for index in range(int(until * profile.duration / PERIOD)):
        t = index * PERIOD
        free = np.array([profile.speed(t), 0.0, 0.0])
        needed = robot.inverse(place, free, (profile.acceleration(t), 0.0, 0.0))
        left, right, _ = needed.torques
        found.append(Instant(t, heading_of(place), float(place[SWIVEL]), left, right, hypot(*needed.ground)))
        place = place + PERIOD * (robot.spread(place) @ free)
    return found


def late_torques(name: str, *, late: bool) -> list[Instant]:
    """Torques that are right for the instant, or `late` by one, on a robot that starts exactly pulled."""
    robot, profile = OffsetDynamics(SETS[name]), Profile(DURATIONS[name])
    place, free, found = posed(pi, 0.0), np.zeros(3), []
    before = (0.0, 0.0, 0.0)
    for index in range(int(profile.duration / PERIOD)):
        t = index * PERIOD
        needed = robot.inverse(place, free, (profile.acceleration(t), 0.0, 0.0))
        torques, before = before if late else needed.torques, needed.torques
        force = hypot(*needed.ground)
        found.append(Instant(t, heading_of(place), float(place[SWIVEL]), torques[0], torques[1], force))
        slope = robot.acceleration(place, free, torques)
        place, free = place + PERIOD * (robot.spread(place) @ free), free + PERIOD * slope
    return found


def flip_time(found: list[Instant]) -> float | None:
    """When the chassis lies across its motion, s."""
    return next((one.t for one in found if cos(one.heading) >= 0.0), None)


def peak(found: list[Instant]) -> tuple[float, str, float]:
    """The largest torque of a wheel, N m, which one it is, and the largest force, N."""
    left, right = (
        max(abs(torque) for torque in torques) for torques in zip(*((i.left, i.right) for i in found), strict=True)
    )
    return max(left, right), "left" if left > right else "right", max(one.force for one in found)
