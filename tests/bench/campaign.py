"""`python -m tests.bench.campaign [--cycles N] [--seed N]`: how soon random faults find a rule that is gone.

Takes every rule out of the core in turn that `tests.test_laws_can_fail` takes out, and lets the campaign of `drivegate
replay campaign` break that robot until a law notices: cycles and time to that, and how short the script became. Rules
whose absence only shows in drives that leave the motors able to brake are left out: a campaign breaks everything.
Exit 1 where a rule was not missed.
"""

import argparse
import sys
import time

from pytest import MonkeyPatch

from gateway.config import parse
from replay.drive.scenario import Given
from replay.inject.campaign import Found, campaign
from replay.inject.injection import Recorded
from replay.inject.laws import LAWS
from replay.sim.plants.contract import PlantName
from tests.test_laws_can_fail import ROWS, Removed
from tests.world import robot_text

CYCLES = 400_000
SECONDS = 16.0  # more than somebody holds a robot that was asked to stand up


def search(row: Removed, *, cycles: int, seed: int) -> Found | None:
    """What a campaign finds without this rule; None: nothing in so many cycles."""
    text = row.edit(robot_text(row.robot))
    drive = Recorded(row.robot, text, parse(text, row.robot), Given(), SECONDS, PlantName.SIMPLE)
    with MonkeyPatch.context() as patch:
        row.remove(patch)
        return campaign([drive], cycles=cycles, seed=seed).found


def main() -> int:
    """Prints a line per rule."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=CYCLES, help="after which it is given up")
    parser.add_argument("--only", default="", help="part of a rule's name")
    parser.add_argument("--seed", type=int, default=1, help="number of the first drive")
    wanted = parser.parse_args()
    rows = [row for row in ROWS if row.law in LAWS and wanted.only in row.remove.__name__]
    missed = 0
    print("rule that is gone                robot            cycles    time  entries  seconds  drives  law")
    for row in rows:
        started = time.perf_counter()
        found = search(row, cycles=wanted.cycles, seed=wanted.seed)
        elapsed = time.perf_counter() - started
        missed += found is None
        told = f"{row.remove.__name__:32} {row.robot:14}"
        if found is None:
            print(f"{told} not found in {wanted.cycles} cycles, {elapsed:.0f} s", flush=True)
            continue
        shrunk = found.shrunk
        print(
            f"{told} {found.cycles:8} {elapsed:6.1f}s {len(shrunk.scenario.at):8} {shrunk.scenario.seconds:8.2f} "
            f"{shrunk.tries:7}  {found.law}",
            flush=True,
        )
    print(f"{len(rows) - missed} of {len(rows)} found")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
