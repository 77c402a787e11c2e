"""The lane `tests.equality` sees a single bit, and calls what cannot run a failure."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from gateway.types import Twist
from tests.corpus import FOLDER, ROBOTS
from tests.equality import __main__ as lane
from tests.equality import emulator, judge, verdicts
from tests.equality.judge import Judgement
from tests.world import World


@pytest.fixture(scope="module")
def drive() -> World:
    world = World("moby")
    world.start()
    world.run(0.5, Twist(0.3, 0.2, 0.4))
    return world


def judged(world: World) -> Judgement:
    return judge.judge("moby", world.text, judge.packed(world.records))


def test_the_same_twice_and_as_recorded(drive: World) -> None:
    first, second = judged(drive), judged(drive)
    assert first == second
    assert (first.first_difference, first.cycles) == (None, len(drive.records))


def test_a_bit_of_the_recording_is_seen(drive: World) -> None:
    world = World("moby")
    world.records = list(drive.records)
    inputs, outputs = world.records[-1]
    pose = outputs.trace.pose
    trace = outputs.trace._replace(pose=pose._replace(x=math.nextafter(pose.x, 1.0)))
    world.records[-1] = (inputs, outputs._replace(trace=trace))
    assert judged(world).first_difference == inputs.cycle
    assert judged(world).digest == judged(drive).digest


@pytest.mark.pure_python
def test_a_bit_of_the_arithmetic_is_seen(drive: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cosine of the heading that is off by one last bit, as it was between processors."""
    expected = judged(drive)
    monkeypatch.setattr("gateway.core.odometry.sin_cos", lambda x: (math.sin(x), math.nextafter(math.cos(x), 0.0)))
    found = judged(drive)
    assert found.digest != expected.digest
    assert found.first_difference is not None


JUDGEMENT = Judgement("moby", "aarch64", "pure Python core", 9, None, "ab" * 32, "cd")
TOLD: verdicts.Told = {"cycles": 7, "exit_code": 0, "problem": None, "first_difference": None, "signals": []}
HERE = lane.Run("here", (JUDGEMENT,), {"odd": TOLD})


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (HERE, "PASS here: moby abababababab (9 cycles); corpus of 1 identical (7 cycles)"),
        (
            HERE._replace(judgements=(JUDGEMENT._replace(mathematics="e"),)),
            "PASS here: moby abababababab (9 cycles); corpus of 1 identical (7 cycles); "
            "its libraries compute other bits than those here",
        ),
        (HERE._replace(judgements=(JUDGEMENT._replace(digest="0"),)), "FAIL here: moby: other bits than here"),
        (
            HERE._replace(judgements=(JUDGEMENT._replace(first_difference=4),)),
            "FAIL here: moby: differs from the recording in cycle 4",
        ),
        (HERE._replace(judgements=()), "FAIL here: moby: other bits than here"),
        (lane.Run("x", failure="no such thing"), "FAIL x: no such thing"),
        (HERE._replace(corpus={}), "FAIL here: session odd: no verdict"),
        (
            HERE._replace(
                corpus={"odd": {**TOLD, "exit_code": 1, "first_difference": {"cycle": 4}, "signals": list("abcdefgh")}}
            ),
            "FAIL here: session odd: cycle 4: a, b, c, d, e, f, and 2 more",
        ),
        (
            HERE._replace(corpus={"odd": {**TOLD, "exit_code": 3, "problem": "cycles are missing"}}),
            "FAIL here: session odd: not identical: cycles are missing",
        ),
        (
            HERE._replace(corpus={"odd": {**TOLD, "cycles": 6}}),
            "FAIL here: session odd: another verdict than here in cycles",
        ),
    ],
)
def test_verdicts(run: lane.Run, words: str) -> None:
    assert lane._line(run, HERE) == words


def test_a_corpus_that_is_not_identical_here_is_a_failure_here() -> None:
    here = HERE._replace(corpus={"odd": {**TOLD, "exit_code": 3, "problem": "cycles are missing"}})
    assert lane._line(here, here) == "FAIL here: session odd: not identical: cycles are missing"


def test_nothing_judged_is_a_failure() -> None:
    assert lane._line(lane.Run("x"), lane.Run("x")) == (
        "FAIL x: no drive was judged; no session of the corpus was judged"
    )


def test_the_whole_corpus_is_verified(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert verdicts.main([str(FOLDER / name) for name in ROBOTS] + [str(tmp_path / "none")]) == 0
    told = verdicts.Verdicts(**json.loads(capsys.readouterr().out))
    assert set(told.sessions) == {*ROBOTS, "none"}
    assert {told.sessions[name]["exit_code"] for name in ROBOTS} == {0}
    (words,) = verdicts.problems(told.sessions, told.sessions)
    assert words.startswith("session none: not identical: ")


@pytest.mark.pure_python
def test_a_bit_of_the_arithmetic_is_named_by_session_cycle_and_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.core.odometry.sin_cos", lambda x: (math.sin(x), math.nextafter(math.cos(x), 0.0)))
    here = {"moby": verdicts.verdict(FOLDER / "moby")}
    (words,) = verdicts.problems(here, here)
    assert re.match(r"session moby: cycle (\d+): odometry[.\w ]+ from cycle \1 on by at most \S+e-", words), words


def test_without_packages_there_is_no_emulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It fails with the tool's own words, and leaves nothing in the cache that looks whole."""

    def fails(command: Sequence[str], environment: Mapping[str, str], folder: Path) -> CompletedProcess[str]:
        return CompletedProcess(command, 100, "", "E: no network")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("tests.vm.packages.missing", lambda _: [])
    monkeypatch.setattr(emulator, "run", fails)
    with pytest.raises(emulator.EmulatorError, match="apt-get failed: E: no network"):
        emulator.python()
    assert list((tmp_path / "drivegate").iterdir()) == []
    assert lane._emulated(tmp_path, compiled=False).failure == "apt-get failed: E: no network"


def test_without_tools_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.vm.packages.missing", lambda _: ["qemu-user-static"])
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(emulator.EmulatorError, match="apt-get install qemu-user-static"):
        emulator.python()


def test_a_folder_without_python(tmp_path: Path) -> None:
    with pytest.raises(emulator.EmulatorError, match="no Python"):
        emulator.interpreter(tmp_path)
