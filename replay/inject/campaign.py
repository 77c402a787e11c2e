"""Random faults in recorded drives, by the thousand, until a law of motion is broken: what broke it is made short.

One number makes one drive, the same on every machine: which session, what happens in it, and when.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from random import Random
from typing import NamedTuple

from replay.drive.script import script_of
from replay.inject.injection import Recorded, run, scenario_of
from replay.inject.laws import LAWS
from replay.inject.random_drives import happenings
from replay.inject.shrink import Shrunk, shrink


class Found(NamedTuple):
    """A law that was broken: by the drive of which number, after how many cycles of all, and the shortest way to it."""

    law: str
    seed: int
    cycles: int
    shrunk: Shrunk


class Campaign(NamedTuple):
    """What came of it."""

    drives: int
    cycles: int
    violations: Counter[str]
    found: Found | None

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        found = self.found
        return {
            "drives": self.drives,
            "cycles": self.cycles,
            "violations": {law: self.violations[law] for law in LAWS},
            "found": None
            if found is None
            else {
                "law": found.law,
                "seed": found.seed,
                "cycles": found.cycles,
                "violation": found.shrunk.words,
                "entries": len(found.shrunk.scenario.at),
                "seconds": found.shrunk.scenario.seconds,
                "tries": found.shrunk.tries,
            },
        }


def campaign(
    drives: Sequence[Recorded], *, cycles: int, seed: int, told: Callable[[int], None] = lambda _: None
) -> Campaign:
    """Until so many cycles were driven, or a law was broken. `told`: cycles of each drive. Raises ConfigError."""
    driven, number, broken = 0, seed, Counter[str]()
    while driven < cycles:
        drive = drives[number % len(drives)]
        script = script_of(happenings(Random(number), drive.config, drive.seconds), number % 2**32)
        scenario = scenario_of(drive, script)
        found = run(drive, scenario)
        driven += found.result.cycles
        told(found.result.cycles)
        for law, words in found.violations.items():
            broken[law] += len(words)
            if words:
                shortest = Found(law, number, driven, shrink(drive, scenario, law))
                return Campaign(number - seed + 1, driven, broken, shortest)
        number += 1
    return Campaign(number - seed, driven, broken, None)
