"""`python -m tests.bench.laws [--cycles N] [--seed N]`: violations per law over random drives of both robots."""

import argparse
import sys
import time
from collections import Counter

from gateway.config import parse
from replay.inject.laws import ALL_LAWS
from replay.inject.random_drives import drive
from tests.world import NAMES, robot_text

CYCLES = 60_000  # of `measure`; the evidence is a run of this module with its default
FIRST_DRIVE = 1000  # beyond those of the tests


def measure() -> dict[str, float]:
    """A short run: cycles, violations of each law, and cycles per second with simulated world and laws included."""
    started = time.perf_counter()
    cycles, _, broken = judge(CYCLES, FIRST_DRIVE)
    figures = {f"violations_{law.replace(' ', '_')}": float(broken[law]) for law in ALL_LAWS}
    return {"law_cycles": float(cycles), "law_cycles_per_s": cycles / (time.perf_counter() - started), **figures}


def judge(least: int, first: int) -> tuple[int, int, Counter[str]]:
    """Drives from this number on until at least so many cycles: cycles, last drive, violations by law.

    Prints the first violation of each law in each drive to stderr.
    """
    configs = [parse(robot_text(name), name) for name in NAMES]
    broken: Counter[str] = Counter()
    cycles, seed = 0, first
    while cycles < least:
        for config in configs:
            for can_brake in (False, True):
                driven = drive(seed, config, can_brake=can_brake)
                cycles += driven.cycles
                for law, found in driven.violations.items():
                    broken[law] += len(found)
                    if found:
                        kind = "kind" if can_brake else "wild"
                        print(f"{config.robot.name} {kind} {seed}: {law}: {found[0]}", file=sys.stderr, flush=True)
        seed += 1
        if sys.stderr.isatty():
            print(f"\r{min(cycles / least, 1.0):4.0%} {cycles} cycles", end="", file=sys.stderr)
    return cycles, seed - 1, broken


def main() -> int:
    """Prints every first violation of a drive, and the counts; 1 when a law was broken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=1_000_000, help="at least so many cycles in all")
    parser.add_argument("--seed", type=int, default=0, help="number of the first drive")
    wanted = parser.parse_args()
    started = time.perf_counter()
    cycles, last, broken = judge(wanted.cycles, wanted.seed)
    print(f"{cycles} cycles, drives {wanted.seed} to {last}, {time.perf_counter() - started:.0f} s")
    for law in ALL_LAWS:
        print(f"  {broken[law]:8} violations: {law}")
    return 1 if broken.total() else 0


if __name__ == "__main__":
    sys.exit(main())
