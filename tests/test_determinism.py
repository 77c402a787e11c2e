"""The two laws: the same inputs give the same outputs; a recorded drive, replayed verbatim, sends the same frames."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given

from drivers.contract import CanFrame
from gateway.core.engine import Engine
from gateway.types import Inputs, Mode, Outputs, Twist, TwistFrame
from replay.compare.verify import verify
from replay.sessions.reader import RecordedOutputs, open_session
from tests.recordings import write_drive
from tests.scripts import Script, both, few, play, scripts
from tests.world import World


@both
@few
@given(script=scripts)
def test_the_same_inputs_give_the_same_outputs(name: str, script: Script) -> None:
    world = play(name, script)
    again = Engine(world.config)
    for inputs, outputs in world.records:
        assert again.step(inputs) == outputs


@both
@few
@given(script=scripts)
def test_a_recorded_drive_replays_verbatim(name: str, script: Script, tmp_path_factory: pytest.TempPathFactory) -> None:
    world = play(name, script)
    session = open_session(write_drive(tmp_path_factory.mktemp("session"), world))
    read = list(session.cycles())
    assert read == [(inputs, RecordedOutputs.of(outputs)) for inputs, outputs in world.records]
    verdict = verify(session)
    assert verdict.identical
    assert verdict.cycles == len(world.records)


def tampered(world: World, cycle: int, change: Callable[[Outputs], Outputs]) -> World:
    inputs, outputs = world.records[cycle]
    world.records[cycle] = (inputs, change(outputs))
    return world


def changed_byte(outputs: Outputs) -> Outputs:
    frame = outputs.frames[0]
    data = bytes([frame.data[0], frame.data[1] ^ 0x01, *frame.data[2:]])
    return outputs._replace(frames=(frame._replace(data=data), *outputs.frames[1:]))


def test_verify_names_motor_field_and_values_of_a_shared_frame(tmp_path: Path) -> None:
    """One DJI frame carries four motors: the difference names the one whose current differs."""
    world = play("omni4", [("stream", Twist(0.5, 0.0, 0.0), "teleop", TwistFrame.BODY, 50)])
    verdict = verify(open_session(write_drive(tmp_path, tampered(world, len(world.records) - 1, changed_byte))))
    difference = verdict.first_difference
    assert (verdict.exit_code, verdict.software_change) == (1, None)
    assert difference is not None
    assert (difference.cycle, difference.motor) == (len(world.records) - 1, "front_left")
    assert "current" in difference.field
    assert difference.recorded != difference.replayed


def test_verify_names_motor_field_and_values_of_a_velocity(tmp_path: Path) -> None:
    world = play("moby", [("stream", Twist(0.5, 0.0, 0.0), "teleop", TwistFrame.BODY, 50)])
    last = len(world.records) - 1
    verdict = verify(open_session(write_drive(tmp_path, tampered(world, last, changed_byte))))
    difference = verdict.first_difference
    assert difference is not None
    assert (difference.cycle, difference.motor) == (last, "left")
    assert "Input_Vel" in difference.field


def test_verify_tells_missing_frames_and_modes(tmp_path: Path) -> None:
    def without_frames(outputs: Outputs) -> Outputs:
        return outputs._replace(frames=outputs.frames[:-1])

    def other_mode(outputs: Outputs) -> Outputs:
        return outputs._replace(mode=Mode.FAULT)

    for index, (change, field) in enumerate(((without_frames, "frame"), (other_mode, "mode"))):
        world = tampered(play("moby", []), 60, change)
        directory = tmp_path / str(index)
        directory.mkdir()
        difference = verify(open_session(write_drive(directory, world))).first_difference
        assert difference is not None
        assert (difference.cycle, difference.field) == (60, field)


def test_verify_says_what_is_missing(tmp_path: Path) -> None:
    world = play("moby", [])
    del world.records[50:60]
    verdict = verify(open_session(write_drive(tmp_path, world)))
    assert verdict.exit_code == 3
    assert verdict.problem == "cycles 50 to 59 are missing from the recording"
    assert verdict.cycles == 50


def test_frames_to_be_sent_carry_no_stamp() -> None:
    world = play("omni4", [])
    assert all(isinstance(frame, CanFrame) and frame.received_ns is None for frame in world.last.frames)
    assert isinstance(world.records[0][0], Inputs)
