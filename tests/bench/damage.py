"""Kills, cuts and flipped bits by the hundred: seconds that are lost, and whatever should not be: each of these is 0.

A loss is what had been handed over and cannot be read: of a kill by the service's clock, of a cut in time of the drive.
"""

import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.damage import Loss, cut, flip, kill_recorders, kill_services, recorded

RECORDER_KILLS = 125
SERVICE_KILLS = 75
BOTH_KILLS = 50
CUTS = FLIPS = 1000
CYCLES = 2000
SEED = 11


def measure() -> dict[str, float]:
    """Whatever is an exception other than a refusal in words ends it."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in ("recorder", "service", "both", "files"):
            (root / name).mkdir()
        _, recorders = kill_recorders(root / "recorder", RECORDER_KILLS, SEED)
        services = list(kill_services(root / "service", SERVICE_KILLS, SEED, recorder_too=False))
        both = list(kill_services(root / "both", BOTH_KILLS, SEED, recorder_too=True))
        path, records = recorded(root / "files", CYCLES)
        cuts = list(cut(path, records, CUTS, SEED))
        flips = flip(path, records, FLIPS, SEED)
    return {
        **_told("recorder_killed", recorders),
        **_told("service_killed", services),
        **_told("both_killed", both),
        **_told("cut", cuts),
        "flips": flips.flips,
        "flips_unnoticed": flips.unnoticed,
        "flips_altered": flips.altered,
        "flips_refused": flips.refused,
        "flip_loss_max_s": max(flips.lost_s),
        "flip_loss_median_s": statistics.median(flips.lost_s),
    }


def _told(name: str, losses: Sequence[Loss]) -> dict[str, float]:
    seconds = [loss.seconds for loss in losses]
    return {
        f"{name}": len(losses),
        f"{name}_refused": sum(loss.refused is not None for loss in losses),
        f"{name}_loss_max_s": max(seconds),
        f"{name}_loss_median_s": statistics.median(seconds),
    }
