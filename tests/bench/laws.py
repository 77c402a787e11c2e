"""`python -m tests.bench.laws [--cycles N] [--seed N]`: violations per law over random drives of both robots."""

import argparse
import sys
from collections import Counter

from gateway.config import parse
from tests.laws import ALL_LAWS
from tests.random_drives import drive
from tests.world import NAMES, robot_text


def main() -> int:
    """Prints every first violation of a drive, and the counts; 1 when a law was broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=1_000_000, help="at least so many cycles in all")
    parser.add_argument("--seed", type=int, default=0, help="number of the first drive")
    wanted = parser.parse_args()
    configs = [parse(robot_text(name), name) for name in NAMES]
    broken: Counter[str] = Counter()
    cycles, seed = 0, wanted.seed
    while cycles < wanted.cycles:
        for config in configs:
            for can_brake in (False, True):
                driven = drive(seed, config, can_brake=can_brake)
                cycles += driven.cycles
                for law, found in driven.violations.items():
                    broken[law] += len(found)
                    if found:
                        kind = "kind" if can_brake else "wild"
                        print(f"{config.robot.name} {kind} {seed}: {law}: {found[0]}", flush=True)
        seed += 1
        if sys.stderr.isatty():
            print(f"\r{min(cycles / wanted.cycles, 1.0):4.0%} {cycles} cycles", end="", file=sys.stderr)
    print(f"{cycles} cycles, drives {wanted.seed} to {seed - 1}")
    for law in ALL_LAWS:
        print(f"  {broken[law]:8} violations: {law}")
    return 1 if broken.total() else 0


if __name__ == "__main__":
    sys.exit(main())
