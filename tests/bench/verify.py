"""Speed of `replay verify` at 1 kHz, reading the session from disk included, as a multiple of real time."""

import tempfile
from pathlib import Path

from gateway.types import Twist
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.recordings import write_drive
from tests.world import NAMES, World

RATE_HZ = 1000.0
COURSE = (Twist(0.5, 0.0, 0.0), Twist(0.0, 0.4, 0.0), Twist(0.0, 0.0, 0.8), Twist(0.3, 0.2, 0.3))
LEG_S = 4.0
REPEATS = 3


def measure() -> dict[str, float]:
    """The best of a few runs for each robot."""
    figures: dict[str, float] = {}
    for name in NAMES:
        world = World(name, rate_hz=RATE_HZ)
        world.start()
        for twist in COURSE:
            world.run(LEG_S, twist)
        with tempfile.TemporaryDirectory() as directory:
            folder = write_drive(Path(directory), world)
            verdicts = [verify(open_session(folder)) for _ in range(REPEATS)]
            assert all(verdict.identical for verdict in verdicts)
            figures[f"verify_realtime_ratio_{name}"] = max(verdict.realtime_ratio for verdict in verdicts)
    return figures
