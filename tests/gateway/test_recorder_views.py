"""What is drawn is where the robot is."""

import json
from math import atan2, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from gateway.recording.packets import Record
from gateway.recording.shapes import CHASSIS_PATH
from gateway.recording.writer import SessionWriter
from gateway.types import Twist
from tests.drawn import drawn as drawn_rows
from tests.drives import drive
from tests.recordings import PLENTY, hello, robot, write_drive, writer
from tests.world import World


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
    for chunk in RrdReader(session.folder / "segment-00001.rrd").store().stream().filter(content=CHASSIS_PATH):
        batch = chunk.to_record_batch()
        turns = batch.column("Transform3D:quaternion").to_pylist()
        for cycle, ((_, _, z, w),) in zip(batch.column("cycle").to_pylist(), turns, strict=True):
            drawn[cycle] = 2.0 * atan2(z, w)
    assert len(drawn) > 20
    measured = {cycle: records[cycle].outputs.trace.wheel_positions[2] or 0.0 for cycle in drawn}
    assert max(map(abs, measured.values())) > 0.1
    off = np.array([drawn[cycle] + measured[cycle] for cycle in drawn])
    assert np.abs((off + pi) % (2 * pi) - pi).max() < 1e-6


def rows(folder: Path, entity: str, column: str) -> dict[int, list[Any]]:
    """Cells of an entity by cycle."""
    found: dict[int, list[Any]] = {}
    for chunk in RrdReader(folder / "segment-00001.rrd").store().stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if "cycle" not in batch.schema.names:  # static: names and colours
            continue
        for cycle, cell in zip(batch.column("cycle").to_pylist(), batch.column(column).to_pylist(), strict=True):
            found.setdefault(cycle, []).append(cell)
    return found


@pytest.mark.parametrize(("cycle", "point"), [(333, 340), (497, 500)])  # the second at the end of what is drawn at once
def test_plots_have_fifty_points_per_second_and_hide_no_late_cycle(tmp_path: Path, cycle: int, point: int) -> None:
    records = list(drive(1000, rate=500.0))
    late = records[cycle]
    records[cycle] = Record(late.inputs, late.outputs, late.timing._replace(late_ns=80_000_000))
    session = writer(tmp_path)
    for start in range(0, 1000, 250):
        session.write(records[start : start + 250])
    session.close()
    assert sorted(rows(session.folder, "/trace/pose", "Scalars:scalars")) == list(range(0, 1000, 10))
    spent = rows(session.folder, "/trace/loop", "Scalars:scalars")
    assert max(cell[0] for (cell,) in spent.values()) == 80.0
    assert spent[point][0][0] == 80.0


@pytest.mark.parametrize("batch", [10, 1000])
def test_what_is_unknown_for_a_while_is_one_hole_in_its_line(tmp_path: Path, batch: int) -> None:
    records = list(drive(1000, rate=500.0))
    for place in range(300, 600):
        outputs = records[place].outputs
        trace = outputs.trace._replace(winner_age_s=None)
        records[place] = Record(records[place].inputs, outputs._replace(trace=trace), records[place].timing)
    session = writer(tmp_path)
    for start in range(0, 1000, batch):
        session.write(records[start : start + batch])
    session.close()
    drawn = rows(session.folder, "/trace/command_age", "Scalars:scalars")
    assert sorted(drawn) == [*range(0, 310, 10), *range(600, 1000, 10)]
    assert [cycle for cycle, ((age,),) in drawn.items() if np.isnan(age)] == [300]


def test_every_segment_says_in_which_mode_it_begins(tmp_path: Path) -> None:
    session = writer(tmp_path, segment_bytes=1)
    records = list(drive(1000, rate=500.0))
    for start in range(0, 1000, 500):
        session.write(records[start : start + 500])
    session.close()
    files = sorted(session.folder.glob("*.rrd"))
    assert len(files) > 1
    for path in files:
        assert len(drawn_rows([path])["/trace/mode"]) > 1, "besides the static row of its colours"


def test_can_is_shown_in_words_twice_a_second(tmp_path: Path) -> None:
    world = World("omni4")
    world.run(1.6)
    folder = write_drive(tmp_path, world, batch=100)
    told = rows(folder, "/trace/can/in", "TextLog:text")
    lines = [text for cells in told.values() for (text,) in cells]
    of_one = [line for line in lines if line.startswith("front_left ")]
    assert len(of_one) in {3, 4}
    assert all(line.startswith("front_left feedback angle_ticks=") and "(can0 201#" in line for line in of_one)
    sent = [text for cells in rows(folder, "/trace/can/out", "TextLog:text").values() for (text,) in cells]
    assert 3 <= len(sent) <= 4
    assert all(line.startswith("command front_left.current_raw_1=") for line in sent)


def test_plotted_numbers_and_the_status_have_six_digits(tmp_path: Path) -> None:
    world = World("moby")
    world.start()
    world.run(1.0, Twist(0.3, 0.1, 0.2))
    folder = write_drive(tmp_path, world)
    last = max(plotted := rows(folder, "/trace/pose", "Scalars:scalars"))
    (shown,) = plotted[last]
    exact = next(outputs.trace.pose for inputs, outputs in world.records if inputs.cycle == last)
    assert shown == pytest.approx(exact, rel=1e-6)
    assert shown != list(exact)
    told = rows(folder, "/outputs/status", "Status:json")
    status = next(outputs.status for inputs, outputs in world.records if inputs.cycle == max(told))
    commanded = None if status is None else status.motors[0].commanded
    assert commanded is not None
    ((text,),) = told[max(told)]
    assert json.loads(text)["motors"][0]["commanded"] == float(f"{commanded:.6g}") != commanded
