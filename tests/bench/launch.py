"""`python -m tests.bench.launch [--robot NAME ...] [--plant NAME ...]`: launches on two floors, a line per direction.

Each through the whole service, beside what floor and motors give at most, what they give to equal torques until the
first wheel slips, and a plain ramp that asks for more than both. Exit 1 where a launch takes less than 95 % of the
most, or slips by more than 2 % of its speed. Below it the time to nine tenths of the speed where friction falls with
slip, to 60 % of that at rest (Stribeck; on our dynamics): there wheels that slip are slower as well.
"""

import argparse
import sys
import time
from math import inf
from typing import NamedTuple

from gateway.config import RobotConfig
from gateway.core.assembly import build, limiter
from tests.launches import FALLING, FRICTIONS, PLANTS, ROBOTS, Launch, best, equal_torques, robot

BUNDLED = ["omni4", "omni4_gm6020"]
SECONDS = 1.1  # to reach the speed on the worse floor
FALLING_SECONDS = 2.5  # the same where friction falls with slip
LEAST, SLIP = 0.95, 0.02  # of the most; of the speed
REPEATS = 60
STRETCH = 5  # cycles


def measure() -> dict[str, float]:
    """us of a cycle of omni4 that are the launch's: what the floor gives, torques, bounds and the look for slip."""
    straight = Launch("omni4", 0, 0.8, told=0.8, seconds=0.2, stop=False)
    curve = Launch("omni4", 1, 0.8, told=0.8, seconds=0.5, stop=False, turn=1.5)
    return {"launch_us": _added(straight), "launch_in_a_curve_us": _added(curve)}


def _added(run: Launch) -> float:
    """Law and limiter on the same measurements, with and without, in turn."""
    configs = run.config, robot("omni4", None)
    stretches = -(-len(run.measured) // STRETCH)
    fastest = [[inf] * stretches for _ in configs]
    for _ in range(REPEATS):
        for config, least in zip(configs, fastest, strict=True):
            _time(config, run, least)
    careful, plain = (sum(least) for least in fastest)
    return (careful - plain) / len(run.measured) / 1000.0


def _time(config: RobotConfig, run: Launch, least: list[float]) -> None:
    """Of each stretch the fastest counts: a busy machine only adds."""
    built = build(config)
    law, moving, grips = built.law, limiter(config, built), built.law.features.grip
    for place in range(len(least)):
        stretch = run.measured[place * STRETCH : (place + 1) * STRETCH]
        begin = time.perf_counter_ns()
        for measured in stretch:
            ground = law.ground(whole=True) if grips else None
            moving.step(run.target, measured.dt, ground=ground)
            law.motion(moving.rates, measured, braking=False)
        least[place] = min(least[place], time.perf_counter_ns() - begin)


class Row(NamedTuple):
    """One launch beside a plain ramp."""

    name: str
    plant: str
    friction: float
    eighth: int
    careful: Launch
    plain: Launch

    @property
    def most(self) -> float:
        return best(self.careful.config, self.eighth, self.friction)

    @property
    def equal(self) -> float:
        return equal_torques(self.careful.config, self.eighth, self.friction)

    @property
    def good(self) -> bool:
        return self.careful.acceleration >= LEAST * self.most and self.careful.slip < SLIP

    def line(self) -> str:
        careful, plain = self.careful, self.plain
        taken = careful.acceleration / self.most
        slipped = f"{1e3 * careful.odometry_error:6.1f} {plain.acceleration:7.2f} {plain.slip:6.0%}"
        return (
            f"{self.name:13} {self.plant:9} {self.friction:4.1f} {45 * self.eighth:4} {self.most:6.2f} "
            f"{self.equal:6.2f} {careful.acceleration:7.2f} {taken:5.0%} {careful.slip:6.1%} {slipped} "
            f"{1e3 * plain.odometry_error:6.1f}{'' if self.good else '  !'}"
        )


class Falling(NamedTuple):
    """One launch beside a plain ramp where friction falls with slip."""

    name: str
    friction: float
    eighth: int
    careful: Launch
    plain: Launch

    @property
    def gained(self) -> float:
        """How many times as long the plain ramp takes; inf: it did not get there."""
        return self.plain.seconds_to_speed / self.careful.seconds_to_speed

    @property
    def good(self) -> bool:
        return self.gained > 1.0 and self.careful.slip < SLIP

    def line(self) -> str:
        careful, plain = self.careful, self.plain
        return (
            f"{self.name:13} {self.friction:4.1f} {45 * self.eighth:4} "
            f"{careful.seconds_to_speed:7.3f} {careful.slip:6.1%} {1e3 * careful.odometry_error:6.1f} | "
            f"{plain.seconds_to_speed:7.3f} {plain.slip:6.0%} {1e3 * plain.odometry_error:6.1f} "
            f"{self.gained:6.2f}{'' if self.good else '  !'}"
        )


def falling(name: str, friction: float, eighth: int) -> Falling:
    """Drives both."""
    careful, plain = (
        Launch(name, eighth, friction, told=told, seconds=FALLING_SECONDS, stop=False, stribeck=FALLING)
        for told in (friction, None)
    )
    return Falling(name, friction, eighth, careful, plain)


def main() -> int:
    """Prints the table, and the worst of it below."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", nargs="+", default=BUNDLED, choices=ROBOTS)
    parser.add_argument("--plant", nargs="+", default=list(PLANTS), choices=PLANTS)
    given = parser.parse_args()
    print("                             deg   most  equal |  launch      slip  odo/mm | plain   slip odo/mm   (m/s^2)")
    rows: list[Row] = []
    for name in given.robot:
        for plant in given.plant:
            for friction in FRICTIONS:
                for eighth in range(8):
                    careful, plain = (
                        Launch(name, eighth, friction, told=told, plant=plant, seconds=SECONDS, stop=False)
                        for told in (friction, None)
                    )
                    rows.append(Row(name, plant, friction, eighth, careful, plain))
                    print(rows[-1].line(), flush=True)
    least = min(row.careful.acceleration / row.most for row in rows)
    gained = [row.careful.acceleration / row.equal - 1.0 for row in rows]
    print(
        f"{sum(row.good for row in rows)} of {len(rows)} good; at least {least:.1%} of the most, slip up to "
        f"{max(row.careful.slip for row in rows):.1%} of the speed (plain {min(row.plain.slip for row in rows):.0%} to "
        f"{max(row.plain.slip for row in rows):.0%}), {min(gained):.0%} to {max(gained):.0%} more than equal torques"
    )
    return max(_falling(given.robot), 0 if all(row.good for row in rows) else 1)


def _falling(names: list[str]) -> int:
    """Prints how long it takes where friction falls with slip; 1 where a launch slips or gains nothing."""
    print(f"\nfriction falls to {FALLING.kinetic:.0%} with slip, {FALLING.speed:g} m/s")
    print("                   deg launch/s  slip odo/mm | plain/s   slip odo/mm  times")
    rows: list[Falling] = []
    for name in names:
        for friction in FRICTIONS:
            for eighth in range(8):
                rows.append(falling(name, friction, eighth))
                print(rows[-1].line(), flush=True)
    gained = [row.gained for row in rows]
    good = sum(row.good for row in rows)
    print(f"{good} of {len(rows)} good; a plain ramp takes {min(gained):.2f} to {max(gained):.2f} times as long")
    return 0 if all(row.good for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
