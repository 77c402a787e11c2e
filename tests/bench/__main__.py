"""`python -m tests.bench [--json]`: every figure that an issue names, measured side by side in one run."""

import json
import sys
from collections.abc import Callable

from tests.bench import cycle, laws, recorder, sessions, verify

BENCHES: tuple[tuple[str, Callable[[], dict[str, float]]], ...] = (
    ("one cycle of the core, 4 motors, 8 received frames (aim: at most 0.5 of a frame on the wire)", cycle.measure),
    ("replay verify at 1 kHz, in multiples of real time (aim: at least 20)", verify.measure),
    ("sessions beside BLF and candump of the same frames, bytes and us per cycle", sessions.measure),
    ("recorder: the loop's share per cycle, and the disk's", recorder.measure),
    ("laws of motion over random drives (aim: no violation; `python -m tests.bench.laws` drives more)", laws.measure),
)


def main() -> None:
    figures: dict[str, float] = {}
    for title, measure in BENCHES:
        found = measure()
        figures |= found
        if "--json" not in sys.argv:
            print(title)
            for name, value in found.items():
                print(f"  {name:40} {value:12.4g}")
    if "--json" in sys.argv:
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
