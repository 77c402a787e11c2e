"""What is seen live is what a session shows of the same cycles, whatever the batches are."""

from collections.abc import Sequence
from pathlib import Path
from random import Random

import pytest

from gateway.config import parse
from gateway.core.samples import Sampler
from gateway.edges.live_view import Batch, decode_batch, encode_batch
from gateway.recording.failures import RecordingOffError
from gateway.recording.live import LiveRecording
from gateway.recording.packets import Record
from gateway.recording.writer import SessionWriter
from gateway.types import CycleTiming, Event, Level, Mode, RequestKind, Sample, Twist
from tests.drawn import STATIC, Drawn, drawn
from tests.recordings import PLENTY, STARTED_NS, hello, stored
from tests.world import World

RUN = "0123abcd"


@pytest.fixture(scope="module", params=["moby", "omni4"])
def world(request: pytest.FixtureRequest) -> World:
    """Starts, drives, is stopped, and drives again: plots with holes, modes, events, a path."""
    world = World(request.param)
    world.start()
    world.run(1.0, Twist(0.3, 0.1, 0.4))
    world.request(RequestKind.ESTOP)
    world.run(1.0)
    world.request(RequestKind.RESET)
    world.start()
    world.run(0.7, Twist(-0.2, 0.0, 0.0))
    return world


def records_of(world: World) -> list[Record]:
    random = Random(1)
    return [
        Record(
            inputs,
            outputs,
            CycleTiming(random.randrange(10**6), random.randrange(10**6), STARTED_NS + inputs.now_ns),
        )
        for inputs, outputs in world.records
    ]


def session(directory: Path, world: World, records: Sequence[Record]) -> Drawn:
    config = stored(world.config, directory)
    writer = SessionWriter(config, hello(config, text=world.text), free=lambda _: PLENTY)
    for start in range(0, len(records), 100):
        writer.write(records[start : start + 100])
    writer.close()
    return drawn(sorted(writer.folder.glob("*.rrd")))


def live(path: Path, world: World, samples: Sequence[Sample], *, most: int = 5) -> Drawn:
    """Over the wire, in batches of uneven length."""
    random, recording = Random(2), file_of(path, world)
    while samples:
        size = random.randint(1, most)
        batch = decode_batch(encode_batch(Batch(RUN, tuple(samples[:size]))))
        assert isinstance(batch, Batch)
        assert batch.run == RUN
        recording.draw(batch.samples)
        samples = samples[size:]
    recording.close()
    return drawn([path])


def file_of(path: Path, world: World) -> LiveRecording:
    return LiveRecording(
        parse(world.text, "live"),
        world.text,
        RUN,
        lambda recording, layout: recording.save(path, default_blueprint=layout),
    )


def sampled(records: Sequence[Record]) -> list[Sample]:
    sampler = Sampler()
    found = [sampler.step(one.inputs, one.outputs, one.timing) for one in records]
    return [sample for sample in found if sample is not None]


def since(found: Drawn, cycle: int) -> Drawn:
    return {
        entity: {at: cells for at, cells in rows.items() if at >= cycle or at == STATIC}
        for entity, rows in found.items()
    }


@pytest.mark.parametrize("most", [3, 40])
def test_it_is_what_a_session_shows(tmp_path: Path, world: World, most: int) -> None:
    records = records_of(world)
    shown = live(tmp_path / "live.rrd", world, sampled(records), most=most)
    recorded = session(tmp_path, world, records)
    assert shown.keys() == recorded.keys()
    for entity, rows in recorded.items():
        assert shown[entity] == rows, entity
    assert {"/config", "/outputs/status", "/trace/can/in", "/trace/events", "/trace/mode", "/trace/world/path"} <= {
        *shown
    }


def test_who_comes_later_is_shown_the_same_from_then_on(tmp_path: Path, world: World) -> None:
    records = records_of(world)
    late = records[211:]
    settled = late[0].inputs.cycle + 126  # half a second, in which the CAN messages come once
    recorded = since(session(tmp_path, world, records), settled)
    shown = since(live(tmp_path / "live.rrd", world, sampled(late)), settled)
    for entity in recorded.keys() - {"/trace/world/path"}:  # its pieces are counted from the beginning
        assert shown[entity] == recorded[entity], entity


def test_what_is_missing_is_said_where_it_is_missing(tmp_path: Path, world: World) -> None:
    samples = sampled(records_of(world))
    holes = [*samples[:20], *samples[30:40], *samples[45:]]
    said = live(tmp_path / "live.rrd", world, holes, most=15)["/trace/events"]
    gaps = {cycle: cells for cycle, rows in said.items() if (cells := [row for row in rows if "gap" in row])}
    assert gaps.keys() == {samples[30].cycle, samples[45].cycle}
    first, last = samples[19].cycle + 1, samples[30].since - 1
    assert f"gap: cycles {first} to {last} are missing: they did not arrive here" in gaps[samples[30].cycle][0]


def test_a_line_that_is_not_the_robots_comes_after_the_newest_cycle(tmp_path: Path, world: World) -> None:
    samples = sampled(records_of(world))
    recording = file_of(tmp_path / "live.rrd", world)
    recording.say(Event(Level.WARNING, "view", "too early"))
    recording.draw(samples[:10])
    recording.say(Event(Level.WARNING, "view", "it is silent"))
    recording.close()
    rows = drawn([tmp_path / "live.rrd"])["/trace/events"]
    assert "view: it is silent" in rows[samples[9].cycle][-1]
    wall_ns = int(rows[samples[9].cycle][-1].rpartition("'wall': ")[2].rstrip("}"))
    assert wall_ns >= samples[9].wall_ns, "at the robot's time"
    assert "too early" not in repr(rows)


def test_every_mode_is_seen_at_once_by_whoever_comes(tmp_path: Path, world: World) -> None:
    standing = [sample for sample in sampled(records_of(world)) if sample.mode is Mode.ESTOP]
    rows = live(tmp_path / "live.rrd", world, standing)["/trace/mode"]
    assert "estop" in rows[standing[0].cycle][0]


def test_rerun_that_is_switched_off_is_said(world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(RecordingOffError, match="nothing can be shown"):
        file_of(tmp_path / "live.rrd", world)
