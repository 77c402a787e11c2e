"""The picture of a fit: the torques that the motors told, and those that the simulated robot needs for the motion."""

from pathlib import Path

import numpy as np

from replay.identify.identify import Identified
from replay.reproduce.drawing import draw
from replay.reproduce.picture import Level, Line, Panel, Picture


def draw_fit(found: Identified, path: Path) -> None:
    """A row for each motor: both torques, and what is left over. Raises OSError."""
    rows = []
    for motor, all_told, all_needed in zip(found.motors, found.told, found.needed, strict=True):
        known = np.isfinite(all_told)
        t, told, needed = found.at[known], all_told[known], all_needed[known]
        lines = (
            Line("told", t.tolist(), told.tolist()),
            Line("needed by the plant", t.tolist(), needed.tolist(), 1, dashed=True),
        )
        left = (Line("", t.tolist(), (told - needed).tolist(), 3),)
        spread = found.file.residuals[motor]
        levels = (Level(f"rms {spread:.3g} N m", spread), Level("", -spread))
        rows.append(
            (
                Panel(f"{motor}: torque", "t [s]", "N m", lines),
                Panel(f"{motor}: left over", "t [s]", "N m", left, levels),
            )
        )
    draw(Picture(f"{found.file.robot}, plant {found.file.plant}, {found.file.session}", rows), path)
