"""What is told, and that no flood of strangers takes memory or passes as news."""

from pathlib import Path

from gateway.config import parse
from gateway.core.reporter import MAX_KINDS, REPEAT_NS, Reporter
from gateway.types import Event, Inputs, Mode, Refusal, RefusalCode, Reply, Request, RequestKind

ROBOT_FILE = Path(__file__).parents[2] / "deploy" / "robots" / "moby.toml"  # sources teleop and autonomy


def _reporter() -> Reporter:
    return Reporter(parse(ROBOT_FILE.read_text(encoding="utf-8"), str(ROBOT_FILE)))


def _told(reporter: Reporter, *refusals: Refusal, now_ns: int = 0, replies: tuple[Reply, ...] = ()) -> list[Event]:
    requests = tuple(Request(RequestKind.RESET, reply.id, now_ns) for reply in replies)
    inputs = Inputs(0, now_ns, refusals=refusals, requests=requests)
    return list(reporter.events(inputs, mode=Mode.IDLE, reason=None, faults=(), replies=replies))


def _refusal(source: str, code: RefusalCode = RefusalCode.UNKNOWN_SOURCE) -> Refusal:
    return Refusal(source, code, "no", 0)


def test_strangers_are_one_however_they_call_themselves() -> None:
    reporter = _reporter()
    flood = [_refusal(f"stranger{number}") for number in range(1000)]
    assert [event.text for event in _told(reporter, *flood)] == ["stranger0: no"]
    late = _told(reporter, _refusal("another"), now_ns=REPEAT_NS)
    assert [event.text for event in late] == ["another: no (1000 times)"]
    assert reporter.refused == 1001


def test_sources_of_the_robot_file_and_reasons_are_told_apart() -> None:
    refusals = [_refusal(source, code) for source in ("teleop", "autonomy", "ghost") for code in RefusalCode]
    assert len(_told(_reporter(), *refusals)) == len(refusals)


def test_the_number_of_kinds_is_bounded() -> None:
    reporter = _reporter()
    replies = tuple(Reply(number, False, f"reason {number}") for number in range(2 * MAX_KINDS))
    assert len(_told(reporter, replies=replies)) == MAX_KINDS + 1
    assert len(reporter._throttle._seen) == MAX_KINDS + 1


def test_a_crowd_that_asks_for_a_reset_is_told_once() -> None:
    reporter = _reporter()
    granted = tuple(Reply(number, True, None) for number in range(16))
    assert [event.code for event in _told(reporter, replies=granted)] == ["reset"]
    refused = tuple(Reply(number, False, "the robot still moves") for number in range(16))
    assert [(event.code, event.text) for event in _told(reporter, replies=refused)] == [
        ("reset_refused", "the robot still moves")
    ]
    assert _told(reporter, replies=refused, now_ns=1) == []


def _slips(reporter: Reporter, slip: tuple[str, ...] | None, now_ns: int) -> list[tuple[str, str]]:
    inputs = Inputs(0, now_ns)
    told = reporter.events(inputs, mode=Mode.IDLE, reason=None, faults=(), replies=(), slip=slip)
    return [(event.code, event.text) for event in told]


def test_slip_is_told_with_its_name_once_that_is_known_and_when_it_is_over() -> None:
    reporter = _reporter()
    unknown = "the wheels do not fit a rigid motion: one of them slips"
    assert _slips(reporter, None, 0) == []
    assert _slips(reporter, (), 0) == [("slip", unknown)]
    assert _slips(reporter, (), 1) == []
    assert _slips(reporter, ("left",), 2) == [("slip", "left slips")]
    assert _slips(reporter, (), 3) == [], "a name that is lost again is no news"
    assert _slips(reporter, ("left", "right"), 4) == [("slip", "left, right slip")]
    assert _slips(reporter, None, 5) == [("slip_over", "all wheels grip")]


def test_a_wheel_that_slips_again_and_again_is_told_once_a_second() -> None:
    reporter = _reporter()
    codes: list[str] = []
    for cycle in range(501):
        codes += [code for code, _ in _slips(reporter, ("left",) if cycle % 10 < 5 else None, cycle * 4_000_000)]
    assert (codes.count("slip"), codes.count("slip_over")) == (3, 2)
