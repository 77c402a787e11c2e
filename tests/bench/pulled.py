"""`python -m tests.bench.pulled [--seconds N] [--seeds N ...]`: random drives in the pull region, and their flips.

Each is driven with compensation, which has to hold it, and without, where it has to flip; at 250 Hz and 50 Hz. With 2 %
of the frames lost three heartbeats in a row are missed in one drive of ten minutes in seven: that ends it.
"""

import argparse
import sys
from itertools import product
from pathlib import Path

from tests.pulled_drives import RATES, TROUBLE, Found, Trouble, drive, recorded


def main() -> int:
    """Prints a line per drive; 1 where something is not as it has to be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0, help="of each drive, in virtual time")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3], help="numbers of the drives")
    parser.add_argument("--push", type=float, default=TROUBLE.push, help="N, the largest")
    parser.add_argument("--tightest", type=float, default=TROUBLE.tightest, help="radius of the path in d1")
    parser.add_argument("--session", type=Path, help="record the first compensated drive here, and verify it")
    given = parser.parse_args()
    trouble = Trouble(push=given.push, tightest=given.tightest)
    good = True
    if given.session is not None:
        found, verdict = recorded(
            given.seeds[0], RATES[0], seconds=given.seconds, trouble=trouble, directory=given.session
        )
        good = verdict.identical
        print(f"verify: identical {verdict.identical}, {verdict.cycles} cycles, {verdict.frames} frames", flush=True)
    print("compensated    Hz seed   cycles flips first/s  neutral/rad  error/rad  step/limit  differing  ended by")
    for compensated, rate, seed in product((True, False), RATES, given.seeds):
        found = drive(seed, rate, compensated=compensated, seconds=given.seconds, trouble=trouble)
        good = good and found.sound and (found.flips == 0) is compensated
        print(_line(found, compensated=compensated, rate=rate, seed=seed), flush=True)
    return 0 if good else 1


def _line(found: Found, *, compensated: bool, rate: float, seed: int) -> str:
    first = "-" if found.first_flip is None else f"{found.first_flip:.2f}"
    return (
        f"{'yes' if compensated else 'no':11} {rate:5.0f} {seed:4} {found.cycles:8} {found.flips:5} {first:>7} "
        f"{found.nearest:12.3f} {found.error:10.3f} {found.step:11.3f} {found.differing:10}  {found.ended or ''}"
    )


if __name__ == "__main__":
    sys.exit(main())
