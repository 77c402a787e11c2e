"""All differences of a session, grouped, each episode with the cause that made it."""

import json
from collections.abc import Callable, Sequence
from math import inf, nextafter
from pathlib import Path

import pytest

from gateway.core.engine import Engine
from gateway.recording import segment
from gateway.recording.chain import link
from gateway.recording.packets import Record, Snapshot
from gateway.types import CycleTiming, Inputs, Mode, Outputs, Request, RequestKind, Twist
from replay.compare.differences import Cause, Differences, differences
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.recordings import world_writer
from tests.replay.test_incomplete import OLD
from tests.world import World

BATCH = 50
Change = Callable[[Inputs, Outputs], tuple[Inputs, Outputs]]


@pytest.fixture(scope="module")
def world() -> World:
    driven = World("moby", rate_hz=100.0)
    driven.start()
    driven.run(0.5, Twist(0.3, 0.1, 0.0))
    driven.cycle(requests=[Request(RequestKind.SET, 7, driven.now_ns, setting="speed_override", value=0.2)])
    driven.run(2.05, Twist(9.0, 0.1, 0.0))
    return driven


def first_set(world: World) -> int:
    return next(inputs.cycle for inputs, _ in world.records if inputs.requests)


def recorded(folder: Path, world: World, changed: Sequence[tuple[Inputs, Outputs]], text: str | None = None) -> Path:
    """What was changed, with the states of the core that was driven."""
    drive = World("moby", rate_hz=100.0)
    drive.text = text or world.text
    session = world_writer(folder, drive)
    engine, snapshot = Engine(world.config), None
    for start in range(0, len(changed), BATCH):
        records = [Record(*one, CycleTiming(0, 0, 0)) for one in changed[start : start + BATCH]]
        session.write(records, (), snapshot)
        for inputs, _ in world.records[start : start + BATCH]:
            engine.step(inputs)
        snapshot = Snapshot.of(records[-1].inputs.cycle, engine.snapshot())
    session.close()
    return session.folder


def found(folder: Path) -> Differences:
    return differences(open_session(folder))


def at(cycles: Sequence[int], change: Change, world: World) -> list[tuple[Inputs, Outputs]]:
    return [change(*one) if one[0].cycle in cycles else one for one in world.records]


def other_byte(inputs: Inputs, outputs: Outputs) -> tuple[Inputs, Outputs]:
    frame = outputs.frames[0]
    data = bytes([*frame.data[:2], frame.data[2] ^ 0x40, *frame.data[3:]])
    return inputs, outputs._replace(frames=(frame._replace(data=data), *outputs.frames[1:]))


def without_requests(inputs: Inputs, outputs: Outputs) -> tuple[Inputs, Outputs]:
    return inputs._replace(requests=()), outputs


def without_requests_and_replies(inputs: Inputs, outputs: Outputs) -> tuple[Inputs, Outputs]:
    return inputs._replace(requests=()), outputs._replace(replies=())


def last_bit(inputs: Inputs, outputs: Outputs) -> tuple[Inputs, Outputs]:
    odometry = outputs.odometry
    if odometry is None:
        return inputs, outputs
    pose = odometry.pose._replace(x=nextafter(odometry.pose.x, inf))
    return inputs, outputs._replace(odometry=odometry._replace(pose=pose))


def other_mode(inputs: Inputs, outputs: Outputs) -> tuple[Inputs, Outputs]:
    return inputs, outputs._replace(mode=Mode.FAULT)


def test_of_an_unchanged_drive_there_are_none(world: World, tmp_path: Path) -> None:
    assert found(recorded(tmp_path, world, world.records)) == Differences(len(world.records), 0, ())


def test_all_of_them_are_counted_by_motor_and_field(world: World, tmp_path: Path) -> None:
    places = (70, 75, 80, 130)
    all_of_it = found(recorded(tmp_path, world, at(places, other_byte, world)))
    assert (all_of_it.cycles, all_of_it.different) == (len(world.records), 4)
    assert [(one.first_cycle, one.last_cycle) for one in all_of_it.episodes] == [(70, 99), (130, 149)]
    (group,) = all_of_it.groups
    assert (group.cycles, group.first_cycle, group.last_cycle) == (4, 70, 130)
    assert group.motor in world.config.robot.motor_names()
    assert group.largest is not None
    assert group.largest > 0.0


def test_outputs_that_were_changed_are_tampered_with(world: World, tmp_path: Path) -> None:
    assert causes(found(recorded(tmp_path, world, at((70,), other_mode, world)))) == [Cause.TAMPERED]


def test_a_broken_seal_is_tampered_with_whatever_differs(world: World, tmp_path: Path) -> None:
    folder = recorded(tmp_path, world, at([one[0].cycle for one in world.records], last_bit, world))
    with (folder / "segment-00001.rrd").open("ab") as file:
        file.write(b"\0")
    assert set(causes(found(folder))) == {Cause.TAMPERED}


def test_a_broken_chain_is_tampered_with_whatever_differs(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seal and sums fit what was edited: only the chain is still that of the truth."""

    def linked(before: bytes, number: int, cycles: int, stored: bytes) -> bytes:
        return bytes(32) if number == BATCH else link(before, number, cycles, stored)

    monkeypatch.setattr(segment, "link", linked)
    folder = recorded(tmp_path, world, at([one[0].cycle for one in world.records], last_bit, world))
    assert set(causes(found(folder))) == {Cause.TAMPERED}


def test_last_bits_are_arithmetic(world: World, tmp_path: Path) -> None:
    all_of_it = found(recorded(tmp_path, world, at([one[0].cycle for one in world.records], last_bit, world)))
    assert set(causes(all_of_it)) == {Cause.ARITHMETIC}
    assert [group.field for group in all_of_it.groups] == ["odometry.x"]


def test_a_request_that_was_left_out_is_a_missing_input(world: World, tmp_path: Path) -> None:
    """By its reply, and without one by the state; behind the next recorded state nothing differs."""
    place = first_set(world)
    for name, change in (("reply", without_requests), ("state", without_requests_and_replies)):
        all_of_it = found(recorded(tmp_path / name, world, at((place,), change, world)))
        assert causes(all_of_it) == [Cause.MISSING_INPUTS]
        assert all_of_it.episodes[0].last_cycle % BATCH == BATCH - 1
        assert ("reply" in all_of_it.episodes[0].why) is (name == "reply")


def test_another_robot_file_is_named(world: World, tmp_path: Path) -> None:
    text = world.text.replace("[loop]\nrate = 100.0", "[loop]\nrate = 125.0")

    assert causes(found(recorded(tmp_path, world, world.records, text=text)))[0] is Cause.ROBOT_FILE


def test_another_version_is_the_software(world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    then = {"drivegate": "0.0.1", "arithmetic": "own"}
    monkeypatch.setattr("gateway.recording.header.versions", lambda: then)
    all_of_it = found(recorded(tmp_path, world, at((70,), other_byte, world)))
    assert causes(all_of_it) == [Cause.SOFTWARE]
    assert "drivegate 0.0.1, now" in all_of_it.episodes[0].why


def test_without_a_state_behind_it_nobody_knows(world: World, tmp_path: Path) -> None:
    last = world.records[-1][0].cycle
    assert last % BATCH != BATCH - 1
    assert causes(found(recorded(tmp_path, world, at((last,), other_byte, world)))) == [Cause.UNKNOWN]


@pytest.mark.parametrize("name", ["v1-moby", "v1-omni4"])
def test_older_recordings_differ_by_their_software(name: str) -> None:
    all_of_it = found(OLD / name)
    assert causes(all_of_it) == [Cause.SOFTWARE]
    first = verify(open_session(OLD / name)).first_difference
    assert first is not None
    assert all_of_it.episodes[0].first_cycle == first.cycle


def test_as_json_it_is_plain(world: World, tmp_path: Path) -> None:
    told = json.loads(json.dumps(found(recorded(tmp_path, world, at((70,), other_mode, world))).as_json()))
    (episode,) = told["episodes"]
    assert (told["cycles"], told["different"], episode["cause"]) == (len(world.records), 1, "tampered")
    assert episode["groups"] == [
        {"motor": None, "field": "mode", "cycles": 1, "first_cycle": 70, "last_cycle": 70, "largest": None}
    ]


def causes(found: Differences) -> list[Cause]:
    return [episode.cause for episode in found.episodes]
