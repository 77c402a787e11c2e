"""Faults of a simulated robot that runs: given in the one vocabulary, happening at their time, told in words."""

import re
from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.cli.simulation import _take
from gateway.config import ConfigError
from gateway.edges.messages import MAX_WORDS
from gateway.types import Event, Mode, Request, RequestKind, Twist
from replay.drive.faults import RULES, FaultKind
from replay.drive.live_faults import LIVE, MARK, MAX_WAITING, LiveFaults, entries_of, words
from replay.drive.script import Script, in_words, script_of, text_of
from replay.sim.plants.contract import PlantName
from tests.world import World

SECOND_NS = 1_000_000_000
VALUES = {
    **{FaultKind.FRAMES_LOST: "=0.3", FaultKind.FRAMES_DELAYED: "=0.01", FaultKind.FRAMES_DOUBLED: "=0.2"},
    **{
        FaultKind.ENCODER_JUMP: "=0.5",
        FaultKind.BRAKE_WEAK: "=0.5",
        FaultKind.PUSH: "+0.5=10",
        FaultKind.SLOPE: "=0.1",
    },
    **{FaultKind.IMPACT: "+0.5=10", FaultKind.FRICTION: "=0.4", FaultKind.MASS: "=100", FaultKind.SENSOR_JUMP: "=0.1"},
}


def script(*said: str, seed: int = 0) -> Script:
    return script_of(entries_of(said), seed)


def robot(name: str = "omni4") -> tuple[World, LiveFaults]:
    world = World(name)
    world.start()
    return world, LiveFaults(world.bus, world.config, PlantName.SIMPLE)


def run(world: World, faults: LiveFaults, seconds: float, twist: Twist | None = None) -> list[str]:
    """So many seconds; what the core told of them, with its time in s since the first cycle."""
    begin_ns, told = world.now_ns, []
    marks: list[Request] = []
    for index in range(round(seconds * SECOND_NS / world.period_ns)):
        commands = [world.command(twist)] if twist is not None and index % 5 == 0 else []
        outputs = world.cycle(commands=commands, requests=marks)
        mark = faults.step(world.now_ns, outputs.events)
        marks = [] if mark is None else [Request(RequestKind.MARK, 0, world.now_ns, text=mark)]
        if mark is not None:
            assert 0 < len(mark) <= MAX_WORDS
            told.append(f"{(world.now_ns - begin_ns) / SECOND_NS:.2f} {mark.removeprefix(MARK)}")
    return told


def test_it_happens_at_its_time_and_ends_at_its_own() -> None:
    world, faults = robot()
    faults.give(script("power_off@0.2+1.4:front_left", "bus_down@3:can0"))
    told = run(world, faults, 3.2, Twist(0.3, 0.0, 0.0))
    assert told == ["0.20 power_off+1.4:front_left", "1.60 end of power_off+1.4:front_left", "3.00 bus_down:can0"]
    modes = [outputs.mode for _, outputs in world.records]
    assert Mode.DEGRADED in modes
    assert "bus_down" in world.codes()


def test_now_is_the_next_cycle_and_without_a_name_it_is_everyone() -> None:
    world, faults = robot()
    faults.give(script("cable_out"))
    assert run(world, faults, 0.2) == ["0.00 cable_out"]
    assert world.codes().count("fault_silent") == 4


def test_clear_mends_and_forgets_what_was_to_come() -> None:
    """Also the end of what it has mended: it would undo what was broken since."""
    world, faults = robot()
    faults.give(script("power_off+1:front_left", "encoder_frozen@2:rear_left"))
    run(world, faults, 0.5)
    faults.give(script("clear", "power_off@0.2:front_left"))
    told = run(world, faults, 3.0)
    assert told == ["0.56 clear 0.55 s ago, power_off:front_left 0.35 s ago"]
    assert not world.bus.robot.devices["front_left"].acknowledges


def test_clear_forgets_ends_of_its_own_script_too() -> None:
    world, faults = robot()
    faults.give(script("power_off+1:front_left", "clear@0.5", "power_off@0.7:front_left"))
    told = ", ".join(run(world, faults, 3.0))
    assert "end of" not in told
    assert not world.bus.robot.devices["front_left"].acknowledges


def test_clear_of_one_motor_leaves_the_others() -> None:
    world, faults = robot()
    faults.give(script("power_off+1:front_left", "power_off+1:rear_left", "frames_doubled@0.6=0.1"))
    run(world, faults, 0.5)
    faults.give(script("clear:front_left"))
    (told,) = run(world, faults, 1.0)
    assert (
        told
        == "0.56 clear:front_left 0.55 s ago, frames_doubled=0.1 0.45 s ago, end of power_off+1:rear_left 0.05 s ago"
    )


def told_slopes(events: Sequence[Event]) -> list[float]:
    texts = ", ".join(event.text for event in events if event.code == "mark")
    return [float(value) for value in re.findall(r"slope=([\d.]+)", texts)]


SLOPES = [0.01 * index for index in range(30)]


def test_all_of_it_is_told_however_fast_it_happens() -> None:
    """By a core that holds back marks which follow each other too fast: every word, in time order."""
    world, faults = robot()
    faults.give(script(*[f"slope@{2.0 * value:g}={value:g}" for value in SLOPES]))
    run(world, faults, 12.0)
    assert told_slopes(world.events) == SLOPES


@pytest.mark.parametrize("seed", range(6))
def test_all_of_it_is_told_where_people_mark_too_and_marks_are_late_or_lost(seed: int) -> None:
    """A mark whose cycle came late is held back by the core, and one that waited too long never got there."""
    random = Random(seed)
    world, faults = robot()
    faults.give(script(*[f"slope@{10.0 * value:g}={value:g}" for value in SLOPES]))
    marks: list[Request] = []
    for _ in range(round(16.0 * SECOND_NS / world.period_ns)):
        if random.random() < 0.001:
            marks.append(Request(RequestKind.MARK, 0, world.now_ns, text="it squeals"))
        late = random.random() < 0.9
        outputs = world.cycle(requests=[] if late else marks)
        marks = marks if late else []
        mark = faults.step(world.now_ns, outputs.events)
        if mark is not None and random.random() < 0.8:
            marks.append(Request(RequestKind.MARK, 0, world.now_ns, text=mark))
    assert told_slopes(world.events) == SLOPES


@pytest.mark.parametrize("kind", FaultKind, ids=lambda one: one.value)
def test_every_fault_is_said_as_it_was_typed(kind: FaultKind) -> None:
    said = f"{kind.value}{VALUES.get(kind, '')}"
    if kind not in LIVE:
        with pytest.raises(ConfigError, match="must be one of"):
            entries_of([said])
        return
    (at,) = script(said).at
    assert at.fault is not None
    assert words(at.fault) == said
    assert (kind in VALUES) == (RULES[kind].value is not None and RULES[kind].default is None)


@pytest.mark.parametrize(
    ("said", "problem"),
    [
        ("silence@1:teleop", "only a fault can be given while it runs"),
        ("estop@1", "only a fault can be given while it runs"),
        ("power_off@1:wheel", "fault.motor = 'wheel': there is front_left"),
        ("bus_down:can7", "fault.bus = 'can7': there is can0"),
        ("impact@1+0.1=5", "needs a caster"),
        ("loop_pause@1+1", "SIGSTOP"),
        ("sensor_silent@1", "needs a [[sensor]] on a bus"),
    ],
)
def test_what_is_not_of_this_robot_is_refused_and_nothing_of_it_happens(said: str, problem: str) -> None:
    world, faults = robot()
    given = script_of([in_words("power_off", now=True), in_words(said, now=True)])
    with pytest.raises(ConfigError, match=problem.replace("[", r"\[")):
        faults.give(given)
    assert run(world, faults, 0.1) == []


def test_a_crowd_of_them_is_refused() -> None:
    world, faults = robot()
    faults.give(script(*["slope@9=0.1"] * MAX_WAITING))
    with pytest.raises(ConfigError, match=f"at most {MAX_WAITING}"):
        faults.give(script("slope@1=0.1"))
    run(world, faults, 0.1)
    with pytest.raises(ConfigError, match=f"at most {MAX_WAITING}"):
        faults.give(script("slope@1=0.1"))
    faults.give(script("clear"))
    run(world, faults, 0.1)
    faults.give(script("slope@1=0.1"))


@pytest.mark.parametrize("said", ["encoder_freeze", "power-off", "", "@3", "bus_off"])
def test_an_unknown_one_is_told_with_all_that_there_are(said: str) -> None:
    with pytest.raises(ConfigError, match=r"must be one of power_off, power_on"):
        entries_of([said])


def test_what_is_sent_is_what_was_said() -> None:
    entries = entries_of(["power_off@1+0.5:front_left", "frames_lost=0.3", "clear"])
    assert script_of(entries, 7) == script("power_off@1+0.5:front_left", "frames_lost=0.3", "clear", seed=7)
    assert text_of(entries, 7).startswith("seed = 7\n")


WORLD = World("omni4")
TEXTS = [
    "at = [",
    "]",
    "{ t = 0, fault = { kind = ",
    '"power_off"',
    '"impact"',
    "} }",
    ", ",
    "seed = 1\n",
    "\0",
    "[[at]]",
    "\n",
]


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=80) | st.lists(st.sampled_from(TEXTS), max_size=8).map(lambda texts: "".join(texts).encode()))
def test_no_payload_raises(payload: bytes) -> None:
    """In the thread that receives it, whose end would be that of the robot."""
    problem = _take(LiveFaults(WORLD.bus, WORLD.config, PlantName.SIMPLE), payload)
    assert problem is None or problem
