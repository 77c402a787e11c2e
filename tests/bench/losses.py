"""`python -m tests.bench.losses [--way WAY ...] [ROBOT]`: a motor killed at full speed, a line per drive.

Eight directions, each motor, by power, by cable, by frozen encoder and by silent loss of torque: when it is seen, who
is blamed, and what the robot does until then and for 2 s. ROBOT: a bundled omni robot, `omni4` unless told. The last
column says which bound is missed (`tests.omni_losses`; a way without bounds is only told); then the exit is 1.
"""

import argparse
import sys

from gateway.config import parse
from tests.omni_losses import BOUNDS, WAYS, Found, deaths, drive, missed
from tests.world import robot_text


def main() -> int:
    """Prints the table, the worst of each way below it; 1 where a bound is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="?", default="omni4", choices=BOUNDS)
    parser.add_argument("--way", nargs="+", default=list(WAYS), choices=WAYS, help="only these ways of dying")
    given = parser.parse_args()
    config = parse(robot_text(given.robot), given.robot)
    print("way             deg motor         seen/s then      heading/deg offset/m spin/(rad/s) turned/deg speed  step")
    found: list[Found] = []
    for death in deaths(config):
        if death.way in given.way:
            found.append(drive(config, death))
            print(_line(found[-1]), *_missed(found[-1], given.robot), flush=True)
    for way in given.way:
        print(_worst(way, [one for one in found if one.death.way == way]))
    return 1 if any(_missed(one, given.robot) for one in found) else 0


def _missed(found: Found, robot: str) -> list[str]:
    bounds = BOUNDS[robot].get(found.death.way)
    return [] if bounds is None else missed(found, bounds)


def _line(found: Found) -> str:
    death = found.death
    seen = "-" if found.seconds is None else f"{found.seconds:.3f}"
    others = " ".join(name for name in found.blamed if name != death.motor)
    return (
        f"{death.way:14} {death.direction:4.0f} {death.motor:12} {seen:>7} {found.mode.value:9} {found.heading:10.2f} "
        f"{found.offset:8.3f} {found.spin:12.3f} {found.turned:10.2f} {found.slowest:5.2f} {found.step:5.2f}  {others}"
    )


def _worst(way: str, found: list[Found]) -> str:
    seen = [one.seconds for one in found if one.seconds is not None]
    return (
        f"{way}: seen in {len(seen)} of {len(found)} drives, the latest after {max(seen, default=0.0):.3f} s; at worst "
        f"{max(one.heading for one in found):.2f} deg, {max(one.offset for one in found):.3f} m, "
        f"{max(one.spin for one in found):.3f} rad/s, {max(one.turned for one in found):.2f} deg turned, "
        f"step {max(one.step for one in found):.3f}"
    )


if __name__ == "__main__":
    sys.exit(main())
