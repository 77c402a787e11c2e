"""What the slip check costs in every cycle; as a program, false alarms in random drives of healthy robots.

`python -m tests.bench.slip [--minutes 30] [--seed N]`: of each bundled robot so many minutes of random commands on good
ground, 2 s of virtual time per second or faster. Exit 1 when slip was told in any of them.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from math import inf
from typing import Any

from gateway.build import COMPILED
from gateway.control.drive_law import Measured
from gateway.core.sensors import Heading
from gateway.core.slip import SlipDetector
from gateway.core.slip_model import SlipModel
from gateway.kinematics.contract import Estimate
from gateway.types import Twist
from tests.bench import cycle
from tests.random_clean import clean_drive
from tests.world import NAMES, World

REPEATS = 25
MINUTE_S = 60.0
Seen = tuple[Measured, Sequence[float | None], Estimate | None, Heading | None]


def measure() -> dict[str, float]:
    """us per cycle of omni4: of a lively drive, and while a wheel on oil slips, its name found out.

    Of pure Python only: nothing takes the place of a part of the compiled core and watches what it is told.
    """
    if COMPILED:
        return {}
    clean, oil = _Watched(), _Watched()
    cycle.drive(clean.world, 4.0)
    oil.world.start()
    oil.world.bus.robot.set_friction("rear_left", 0.05)
    oil.world.run(2.0, Twist(0.3, 1.0, 0.2))
    return {"slip_us": _fastest(clean), "slip_on_oil_us": _fastest(oil)}


class _Watched:
    """A world of which everything is kept that the slip check sees."""

    def __init__(self) -> None:
        self.world = World("omni4", rate_hz=cycle.RATE_HZ)
        self.seen: list[Seen] = []
        detector = self.world.engine._slip
        assert detector is not None
        self.names, self.model = self.world.config.robot.motor_names(), detector._model
        self.world.engine._slip = _Spy(self.names, self.model, self.seen)


class _Spy(SlipDetector):
    def __init__(self, names: Sequence[str], model: SlipModel, seen: list[Seen]) -> None:
        super().__init__(names, model)
        self._seen = seen

    def look(self, *args: Any) -> Any:  # noqa: ANN401  as it is called
        """The same, and kept."""
        self._seen.append(args)
        return super().look(*args)


def _fastest(watched: _Watched) -> float:
    best = inf
    for _ in range(REPEATS):
        detector = SlipDetector(watched.names, watched.model)
        begin = time.process_time_ns()
        for one in watched.seen:
            detector.look(*one)
        best = min(best, (time.process_time_ns() - begin) / len(watched.seen))
    return best / 1000.0


def main() -> int:
    """Prints slips that were told and cycles in which one was suspected; 1 when there was a slip."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0, help="of the first minute")
    wanted = parser.parse_args()
    alarms = 0
    for name in NAMES:
        drives = [clean_drive(name, seed=wanted.seed + minute, seconds=MINUTE_S) for minute in range(wanted.minutes)]
        told, cycles = sum(drive.told for drive in drives), sum(drive.cycles for drive in drives)
        suspected = sum(drive.suspected for drive in drives)
        print(f"{name}: {wanted.minutes} min, {cycles} cycles: slip told {told} times, suspected in {suspected} cycles")
        alarms += told
    return 1 if alarms else 0


if __name__ == "__main__":
    sys.exit(main())
