"""`drivegate replay report`: of every session a page that needs nothing else, in bounded memory, with all text escaped.

How it looks is for `python -m tests.browser`.
"""

import json
import re
import shutil
import tracemalloc
from html.parser import HTMLParser
from itertools import pairwise
from math import cos, hypot, isnan, nan, sin
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from gateway.cli import replay_report
from gateway.cli.app import build
from gateway.config import ConfigError
from gateway.recording.packets import Record
from gateway.types import (
    Event,
    Level,
    Mode,
    Refusal,
    RefusalCode,
    Reply,
    Request,
    RequestKind,
    Twist,
    TwistCommand,
    TwistFrame,
)
from replay.report import gather, track
from replay.report.binned import Binned, Stretches, stretches_of
from replay.report.scales import HIGH, Scale, across, path, rounds, ticks, upwards
from replay.report.timing import Latency
from replay.report.track import Station, Track
from replay.sessions.reader import open_session
from replay.sessions.summary import summary
from tests.corpus import FOLDER, ROBOTS
from tests.drives import drive
from tests.recordings import write, write_drive
from tests.world import World

MARKUP = "</title></style><script>alert(1)</script><img src=x onerror='alert(1)'>\"&amp;"
VOID = {"meta", "circle", "path", "rect", "link", "br"}


class Markup(HTMLParser):
    """Elements that are open at the end, and names of all of them; text by id."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[tuple[str, str]] = []
        self.names: set[str] = set()
        self.attributes: set[str] = set()
        self.texts: dict[str, str] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.attributes |= {name for name, _ in attrs}
        if tag not in VOID or (tag in {"path", "rect"} and not (self.get_starttag_text() or "").endswith("/>")):
            self.open.append((tag, dict(attrs).get("id") or ""))

    def handle_endtag(self, tag: str) -> None:
        if tag in VOID and (not self.open or self.open[-1][0] != tag):
            return
        assert self.open.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        for _, key in self.open:
            if key:
                self.texts[key] = self.texts.get(key, "") + data


def asked(*arguments: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "report", *map(str, arguments)])


def page_of(session: Path, directory: Path, exit_code: int = 0) -> tuple[str, Markup]:
    out = directory / "page.html"
    result = asked(session, "-o", out)
    assert result.exit_code == exit_code, result.output
    text = out.read_text(encoding="utf-8")
    markup = Markup()
    markup.feed(text)
    assert markup.open == []
    assert not markup.names & {"script", "img", "link", "iframe", "object", "base", "form"}
    assert not {name for name in markup.attributes if name.startswith("on")} | markup.attributes & {"href", "src"}
    assert "url(" not in text
    assert "@import" not in text
    return text, markup


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_robot_has_a_page_of_its_own(robot: str, tmp_path: Path) -> None:
    text, markup = page_of(FOLDER / robot, tmp_path)
    told = summary(open_session(FOLDER / robot))
    assert markup.texts["robot"] == robot
    assert markup.texts["word"] == "identical"
    assert markup.texts["exit-code"] == "0"
    assert markup.texts["cycles"] == f"{told.cycles:,}"
    assert {"timeline", "path", "plot-1", "latency", "faults", "commands", "log", "recording"} <= markup.texts.keys()
    for fault in told.faults:
        assert fault.text in markup.texts["faults"]
    cycles = list(open_session(FOLDER / robot).cycles())
    assert markup.texts["commanded"] == str(sum(len(inputs.commands) for inputs, _ in cycles))
    happened = [one for _, outputs in cycles for one in outputs.events]
    happened_codes = [one.kind.value for inputs, _ in cycles for one in inputs.requests] + [
        one.code for one in happened
    ]
    log = text.partition('<section class="card" id="log">')[2]
    assert sorted(re.findall(r'<td class="level \w+">\w+</td><td>([^<]*)</td>', log)) == sorted(happened_codes)
    assert all(one.text in markup.texts["log"] for one in happened)
    drawn = re.findall(r'class="robot (\w+)"', text)
    assert drawn.count("begin") == drawn.count("end") == 1
    assert len(text) < 300_000


def test_everything_a_session_says_is_escaped(tmp_path: Path) -> None:
    records = []
    for record in drive(60):
        inputs, outputs = record.inputs, record.outputs
        commands = tuple(command._replace(source=MARKUP) for command in inputs.commands)
        refusals = (Refusal(MARKUP, RefusalCode.MALFORMED, MARKUP, inputs.now_ns),)
        requests = (Request(RequestKind.RESET, 1, inputs.now_ns),)
        inputs = inputs._replace(commands=commands, refusals=refusals, requests=requests)
        outputs = outputs._replace(
            events=(Event(Level.WARNING, MARKUP, MARKUP),), replies=(Reply(1, ok=False, reason=MARKUP),)
        )
        records.append(Record(inputs, outputs, record.timing))
    text, markup = page_of(write(tmp_path, records), tmp_path)
    assert "<script" not in text
    assert "<img" not in text
    for section in ("timeline", "faults", "commands", "log"):
        assert MARKUP in markup.texts[section], section
    assert f"refused: {MARKUP}" in markup.texts["log"]


def test_text_that_is_no_text(tmp_path: Path) -> None:
    odd = "\x00\x1b[31m\u202e\U0001f600"
    records = [
        Record(r.inputs, r.outputs._replace(events=(Event(Level.ERROR, "x", odd),)), r.timing) for r in drive(30)
    ]
    assert "\U0001f600" in page_of(write(tmp_path, records), tmp_path, 0)[1].texts["log"]


def test_a_recording_that_is_cut(tmp_path: Path) -> None:
    shutil.copytree(FOLDER / "odd", tmp_path / "s")
    segment = max((tmp_path / "s").glob("*.rrd"))
    segment.write_bytes(segment.read_bytes()[: segment.stat().st_size // 2])
    markup = page_of(tmp_path / "s", tmp_path, 3)[1]
    assert markup.texts["word"] == "incomplete"
    assert markup.texts["exit-code"] == "3"
    assert markup.texts["complete"] == "no"
    for problem in summary(open_session(tmp_path / "s")).problems:
        assert problem in markup.texts["verdict"]


def test_a_drive_that_would_go_differently_says_where_and_why(tmp_path: Path) -> None:
    markup = page_of(write(tmp_path, list(drive(100))), tmp_path)[1]
    assert markup.texts["exit-code"] == "1"
    assert "First difference" in markup.texts["verdict"]
    assert "All differences: 100 cycles" in markup.texts["verdict"]
    assert "not what was said then" in markup.texts["drawn"]


def test_a_robot_file_that_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page says so, and shows what follows from no core."""

    def refuse(*_: object) -> None:
        raise ConfigError("robot file of the session", ["robot.kind: no such chassis"])

    monkeypatch.setattr(gather, "parse", refuse)
    monkeypatch.setattr(replay_report, "verify_with_progress", refuse)
    markup = page_of(FOLDER / "moby", tmp_path)[1]
    assert markup.texts["exit-code"] == "2"
    assert markup.texts["word"] == "not replayable"
    assert "no such chassis" in markup.texts["verdict"]
    assert "no such chassis" in markup.texts["refused"]
    assert "path" not in markup.texts
    assert "estop" in markup.texts["timeline"]
    assert "teleop" in markup.texts["commands"]


def test_a_recording_of_schema_1(tmp_path: Path) -> None:
    markup = page_of(FOLDER.parent / "v1-omni4", tmp_path)[1]
    assert "Not told" in markup.texts["latency"]
    assert "plot-1" in markup.texts


def test_a_session_without_a_cycle(tmp_path: Path) -> None:
    markup = page_of(write(tmp_path, []), tmp_path)[1]
    assert markup.texts["exit-code"] == "2"
    assert markup.texts["cycles"] == "0"
    assert "timeline" not in markup.texts


def test_one_cycle(tmp_path: Path) -> None:
    assert page_of(write(tmp_path, list(drive(1))), tmp_path)[1].texts["cycles"] == "1"


def test_json_and_what_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    told = json.loads(asked(FOLDER / "moby", "-o", out, "--json").stdout.splitlines()[-1])
    assert told == {
        "report": str(out),
        "bytes": out.stat().st_size,
        "verdict": "identical",
        "exit_code": 0,
        "complete": True,
        "cycles": 1300,
        "seconds": 5.196,
    }
    for arguments, words in (
        ((tmp_path, "-o", out), "not a session"),
        ((FOLDER / "moby", "-o", tmp_path), "cannot be written"),
        ((FOLDER / "moby", "-o", tmp_path / "no" / "page.html"), "cannot be written"),
        ((FOLDER / "moby", "-o", max((FOLDER / "moby").glob("*.rrd"))), "is of the session itself"),
    ):
        result = asked(*arguments, "--json")
        assert result.exit_code == 2
        assert words in json.loads(result.stdout.splitlines()[-1])["problem"]


def test_gaps_are_shaded_and_listed(tmp_path: Path) -> None:
    world = World("omni4", rate_hz=100.0)
    world.start()
    world.run(2.0, Twist(0.4, 0.0, 0.0))
    whole = write_drive(tmp_path / "whole", world, batch=50, snapshots=True, segment_bytes=60_000)
    segments = sorted(whole.glob("*.rrd"))
    assert len(segments) > 2
    (tmp_path / "s").mkdir()
    for segment in (segments[0], *segments[2:]):
        shutil.copy(segment, tmp_path / "s")
    found = open_session(tmp_path / "s")
    told = summary(found)
    driven = gather.drive(found.again(), told)
    assert len(driven.gaps) == 1
    assert driven.motion is not None
    assert len(driven.motion.track.pieces) == 2
    assert driven.gaps[0][1] - driven.gaps[0][0] == pytest.approx(
        0.01 * (told.gaps[0].last_cycle - told.gaps[0].first_cycle + 2)
    )
    text, markup = page_of(tmp_path / "s", tmp_path, 3)
    assert 'class="gap"' in text
    assert told.gaps[0].reason in markup.texts["recording"]


def test_the_distance_is_that_of_the_odometry(tmp_path: Path) -> None:
    world = World("moby", rate_hz=100.0)
    world.start()
    world.run(2.0, Twist(0.3, 0.2, 0.0))
    session = open_session(write_drive(tmp_path, world))
    found = gather.drive(session.again(), summary(session))
    assert found.motion is not None
    poses = [outputs.trace.pose for _, outputs in world.records]
    way = sum(hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(poses))
    assert found.motion.track.distance == pytest.approx(way, rel=0.01, abs=0.002)
    last = found.motion.track.pieces[-1][-1]
    assert (last.x, last.y, last.theta) == tuple(poses[-1])
    speeds = [hypot(t.vx, t.vy) for _, outputs in world.records if (t := outputs.trace.measured) is not None]
    assert found.motion.top_speed == max(speeds)


def test_a_page_is_small_whatever_happened(tmp_path: Path) -> None:
    """The mode changes in every cycle, cycles are missing, everybody talks, and at length."""
    records = []
    modes = list(Mode)
    for record in drive(12_000, received=1, sent=1):
        inputs, outputs = record.inputs, record.outputs
        if inputs.cycle % 20 == 19:
            continue
        twist = Twist(0.1 * (inputs.cycle % 2), 0.0, 0.0)
        said = TwistCommand(f"source_{inputs.cycle % 90}", twist, TwistFrame.BODY, None, inputs.now_ns)
        event = Event(Level.ERROR, f"code_{inputs.cycle % 70}", "words " * 500)
        outputs = outputs._replace(mode=modes[inputs.cycle % len(modes)], events=(event,))
        records.append(Record(inputs._replace(commands=(said,)), outputs, record.timing))
    text, markup = page_of(write(tmp_path, records, batch=400), tmp_path, 3)
    assert len(text) < 3_000_000
    assert markup.texts["missing"] == "599"
    assert "others" in markup.texts["commands"]


def test_memory_and_size_do_not_grow_with_the_drive(tmp_path: Path) -> None:
    """What is kept of a drive that trembles and meanders: no more for many times as many cycles."""
    kept = []
    for cycles in (10_000, 60_000):
        found, binned = Track(), Binned(stretches_of(cycles * 1e-3, cycles, 12), 12)
        latency = Latency()
        tracemalloc.start()
        for number in range(cycles):
            t = number * 1e-3
            found.add(Station(0.1 * t * cos(7 * t), 0.1 * t * sin(5 * t), t, 0.0, "drive"))
            binned.add(t, [t] * 12)
        latency.add(np.arange(cycles, dtype=np.int64) * 1000)
        kept.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        assert sum(map(len, found.pieces)) <= 2 * track.MOST_POINTS
    assert kept[1] < 3_000_000
    assert kept[1] < 1.5 * kept[0] + 1_000_000


@given(
    steps=st.lists(st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)), min_size=1, max_size=300),
    most=st.integers(4, 40),
)
def test_no_pose_is_further_from_a_kept_one_than_it_says(steps: list[tuple[float, float]], most: int) -> None:
    found, x, y, poses = Track(), 0.0, 0.0, []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(track, "MOST_POINTS", most)
        for dx, dy in steps:
            x, y = x + dx, y + dy
            poses.append((x, y))
            found.add(Station(x, y, 0.0, 0.0, "drive"))
        found.part()
    kept = [(here.x, here.y) for piece in found.pieces for here in piece]
    assert kept[0] == poses[0]
    assert kept[-1] == poses[-1]
    assert len(kept) <= 2 * most + 1
    for px, py in poses:
        assert min(hypot(px - kx, py - ky) for kx, ky in kept) <= 2.0 * found.within


def test_a_robot_that_trembles_goes_nowhere() -> None:
    found = Track()
    for number in range(10_000):
        found.add(Station(4e-4 * (-1) ** number, 0.0, 0.0, 0.0, "idle"))
    assert found.distance == 0.0


@given(
    st.lists(
        st.tuples(st.floats(0.0, 10.0), st.one_of(st.none(), st.floats(-1e6, 1e6), st.just(nan))),
        min_size=1,
        max_size=200,
    ),
    st.integers(1, 30),
)
def test_no_peak_is_lost(told: list[tuple[float, float | None]], size: int) -> None:
    told.sort(key=lambda one: one[0])
    stretches = Stretches(10.0, size)
    binned = Binned(stretches, 1)
    for t, value in told:
        binned.add(t, [value])
    binned.finish()
    for place in range(size):
        inside = [v for t, v in told if stretches.place(t) == place and v is not None and not isnan(v)]
        ends = (binned.low[place, 0], binned.high[place, 0])
        assert ends == (min(inside), max(inside)) if inside else all(map(isnan, ends))


@given(st.lists(st.integers(0, 300_000_000), min_size=1, max_size=300))
def test_percentiles_are_those_of_all_cycles_to_the_microsecond(times: list[int]) -> None:
    found = Latency()
    for start in range(0, len(times), 70):
        found.add(np.array(times[start : start + 70], np.int64))
    assert found.most == max(times) * 1e-3
    assert found.cycles == len(times)
    for percent in (50.0, 99.0, 99.9):
        exact = float(np.percentile(np.array(times) * 1e-3, percent, method="inverted_cdf"))
        if exact < 100_000.0:
            assert exact - 1e-6 <= found.below(percent) <= exact + 1.0
        else:
            assert found.below(percent) == found.most
    assert found.between(-1.0, 100.0) == sum(time <= 100_000 for time in times)
    assert found.between(100.0, np.inf) == sum(time > 100_000 for time in times)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(2, 10))
def test_ticks_are_round_few_and_where_they_say(low: float, size: float, most: int) -> None:
    scale = Scale(low, low + size, HIGH, 0.0)
    values = rounds(scale, most)
    assert len(values) <= most + 1
    dust = 1e-9 * size + 1e-15 * (abs(low) + size)
    assert all(low - dust <= value <= low + size + dust for value in values)
    steps = [b - a for a, b in pairwise(values)]
    assert all(step == pytest.approx(steps[0], rel=1e-6, abs=4.0 * dust) for step in steps)
    for tick, value in zip(ticks(scale, most), values, strict=True):
        assert tick.at == pytest.approx(100.0 * (1.0 - (value - low) / size), abs=0.01)


def test_ticks_say_their_unit_once() -> None:
    assert [tick.words for tick in ticks(across(5.0), 6, " s")] == ["0 s", "1", "2", "3", "4", "5"]
    assert [tick.words for tick in ticks(upwards(0.0, 0.3), 4)] == ["0", "0.1", "0.2", "0.3"]


@given(st.lists(st.tuples(st.integers(0, 4000), st.one_of(st.integers(0, 1000), st.just(nan))), max_size=50))
def test_a_path_goes_through_its_points(points: list[tuple[float, float]]) -> None:
    walked = walk(path(points))
    known = [one for one in points if not isnan(one[1])]
    assert [one for one, other in pairwise([*walked, None]) if one != other] == [
        one for one, other in pairwise([*known, None]) if one != other
    ]


def walk(line: str) -> list[tuple[float, float]]:
    """By the rules of SVG: M is a place, numbers after l are steps."""
    found: list[tuple[float, float]] = []
    for piece in line.split("M")[1:]:
        start, steps = piece.split("l")
        x, y = map(int, start.split())
        numbers = [int(number) for number in re.findall(r"-?\d+", steps)]
        found.append((x, y))
        for dx, dy in zip(numbers[::2], numbers[1::2], strict=True):
            x, y = x + dx, y + dy
            found.append((x, y))
    return found
