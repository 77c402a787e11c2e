"""What is drawn is where the robot is."""

from math import atan2, pi
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from gateway.recording.shapes import CHASSIS
from gateway.recording.writer import SessionWriter
from tests.drives import drive
from tests.recordings import PLENTY, hello, robot


@pytest.mark.parametrize("zero", [0.0, 0.7])
def test_the_chassis_turns_by_the_joint_angle_wherever_its_zero_is(tmp_path: Path, zero: float) -> None:
    """Positions of the core have the zero of the robot file subtracted already."""
    config = robot(tmp_path)
    motors = [m.model_copy(update={"zero": zero}) if m.name == "platform" else m for m in config.motor]
    config = config.model_copy(update={"motor": motors})
    records = list(drive(600))
    session = SessionWriter(config, hello(config), free=lambda _: PLENTY)
    session.write(records)
    session.close()
    drawn: dict[int, float] = {}
    for chunk in RrdReader(session.folder / "segment-00001.rrd").store().stream().filter(content=CHASSIS):
        batch = chunk.to_record_batch()
        turns = batch.column("Transform3D:quaternion").to_pylist()
        for cycle, ((_, _, z, w),) in zip(batch.column("cycle").to_pylist(), turns, strict=True):
            drawn[cycle] = 2.0 * atan2(z, w)
    assert len(drawn) > 20
    measured = {cycle: records[cycle].outputs.trace.wheel_positions[2] or 0.0 for cycle in drawn}
    assert max(map(abs, measured.values())) > 0.1
    off = np.array([drawn[cycle] + measured[cycle] for cycle in drawn])
    assert np.abs((off + pi) % (2 * pi) - pi).max() < 1e-6
