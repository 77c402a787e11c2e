"""Who drives: whose zero counts, how long a command is fresh, and the reason told to everybody else."""

import pytest

from gateway.config import Source
from gateway.control.drive_law import Features
from gateway.core.arbiter import Arbiter
from gateway.types import ZERO_TWIST, Refusal, RefusalCode, Region, Twist, TwistCommand, TwistFrame

MS = 1_000_000
MOTION = Twist(0.1, 0.0, 0.0)


def arbiter() -> Arbiter:
    """`low` is fresh for 100 ms; `high` wins for 50 ms."""
    return Arbiter([Source(name="low", priority=1, timeout=0.1), Source(name="high", priority=2, timeout=0.05)])


def command(
    ms: float, source: str = "low", twist: Twist = ZERO_TWIST, *, sender: str = "a", stamped: bool = False
) -> TwistCommand:
    return TwistCommand(source, twist, TwistFrame.BODY, None, round(ms * MS), sender, stamped)


def winner(of: Arbiter, ms: float) -> str | None:
    selection = of.select(round(ms * MS))
    return selection.command and selection.command.source


def test_the_timeout_of_a_source_counts_from_arrival_and_is_inclusive() -> None:
    both = arbiter()
    for source in ("low", "high", "stranger"):
        both.receive(command(0, source))
    times = (0, 50, 50.000001, 100, 100.000001)
    assert [winner(both, ms) for ms in times] == ["high", "high", "low", "low", None]
    assert both.select(0).age_ns == 0
    assert both.select(200 * MS) == (None, None)
    both.receive(command(100))
    assert both.select(130 * MS) == (command(100), 30 * MS)


def test_only_a_zero_admits_and_only_one_after_the_dismissal() -> None:
    one = arbiter()
    one.receive(command(10, twist=MOTION))
    assert winner(one, 10) is None
    one.receive(command(20))
    one.receive(command(30, twist=MOTION))
    assert winner(one, 30) == "low"
    one.dismiss(40 * MS)
    for ms, twist, expected in ((35, ZERO_TWIST, None), (40, ZERO_TWIST, None), (50, MOTION, None)):
        one.receive(command(ms, twist=twist))
        assert winner(one, 50) is expected
    one.receive(command(60))
    assert winner(one, 60) == "low"


@pytest.mark.parametrize(
    ("before", "after", "admitted"),
    [
        (command(0), command(100, twist=MOTION), True),
        (command(0), command(100.000001, twist=MOTION), False),
        (command(0, stamped=True), command(2000, twist=MOTION, stamped=True), True),
        (command(0, stamped=True), command(2001, twist=MOTION, stamped=True), False),
        (command(0), command(101, twist=MOTION, stamped=True), False),
        (command(0, stamped=True), command(101, twist=MOTION), False),
        (command(0), command(1, twist=MOTION, sender="b"), False),
        (command(0, stamped=True), command(1, twist=MOTION, sender="b", stamped=True), False),
        (command(80), command(90, twist=MOTION), True),
    ],
)
def test_another_sender_or_a_silence_starts_over(before: TwistCommand, after: TwistCommand, admitted: bool) -> None:
    one = arbiter()
    one.receive(before)
    one.receive(after)
    assert (one.select(after.received_ns).command is after) is admitted
    one.receive(after._replace(received_ns=after.received_ns + 1, twist=ZERO_TWIST))
    assert one.select(after.received_ns + 1).command is not None


def test_moving_looks_at_every_fresh_source() -> None:
    both = arbiter()
    assert both.moving(0) is None
    both.receive(command(0, "high"))
    assert both.moving(0) is None
    both.receive(command(0, twist=MOTION))
    assert both.moving(100 * MS) == command(0, twist=MOTION)
    assert both.moving(100 * MS + 1) is None


def test_a_source_that_is_not_configured_does_not_count() -> None:
    one = arbiter()
    for ms in (0, 1):
        one.receive(command(ms, "stranger", MOTION))
    assert one.moving(MS) is None


def test_the_timeout_is_whole_nanoseconds() -> None:
    one = Arbiter([Source(name="low", priority=1, timeout=1.001)])  # times 1e9 that is a little less
    one.receive(command(0))
    assert winner(one, 1001) == "low"
    assert winner(one, 1001.000001) is None


def test_every_source_is_told_its_reason_in_order_of_priority() -> None:
    both = arbiter()
    assert both.describe(both.select(0), 0) == (("high", None, "never heard"), ("low", None, "never heard"))
    both.receive(command(1000))
    both.receive(command(1010, "high"))
    first, second = both.describe(both.select(1040 * MS), 1040 * MS)
    assert (first.name, first.reason) == ("high", None)
    assert (second.name, second.reason) == ("low", "outranked by high")
    assert (first.age_s, second.age_s) == pytest.approx((0.03, 0.04))
    both.dismiss(1090 * MS)
    first, second = both.describe(both.select(1090 * MS), 1090 * MS)
    assert first.reason == "silent for longer than its timeout of 0.05 s"
    assert second.reason == "has to send zero first"
    assert (first.age_s, second.age_s) == pytest.approx((0.08, 0.09))


# what not every chassis can do

EVERYTHING = Features(width=True, widths=(0.25, 0.6), regions=frozenset(Region))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"width_rate": 0.1}, "width_rate = 0.1: must be left out: the width of this chassis is fixed"),
        ({"width_rate": 0.0}, "width_rate = 0: must be left out: the width of this chassis is fixed"),
        ({"width": 0.25}, "width = 0.25: must be left out: the width of this chassis is fixed, or not known"),
        ({"width": 0.6}, "width = 0.6: must be left out: the width of this chassis is fixed, or not known"),
        ({"region": Region.PUSH}, "region = 'push': must be 'any' on this chassis"),
        ({"region": Region.PULL}, "region = 'pull': must be 'any' on this chassis"),
        ({"path_rate": 1.0}, None),
    ],
)
def test_what_the_chassis_cannot_do_is_refused_and_neither_drives_nor_admits(
    change: dict[str, object], text: str | None
) -> None:
    asked = command(10)._replace(**change)  # type: ignore[arg-type]
    plain, able = arbiter(), Arbiter([Source(name="low", priority=1, timeout=0.1)], EVERYTHING)
    for one in (plain, able):
        one.receive(command(5))
    refusal = plain.receive(asked)
    assert refusal == (None if text is None else Refusal("low", RefusalCode.UNSUPPORTED, text, 10 * MS))
    assert winner(plain, 106) == (None if text else "low"), "only the zero was taken, which is silent by now"
    assert able.receive(asked) is None
    assert winner(able, 106) == "low"


def test_what_some_regions_are_for_is_said_in_words() -> None:
    some = Features(regions=frozenset({Region.ANY, Region.PUSH}))
    assert some.objection(command(0)._replace(region=Region.PUSH)) is None
    refused = some.objection(command(0)._replace(region=Region.PULL))
    assert refused == "region = 'pull': must be 'any' or 'push' on this chassis"


@pytest.mark.parametrize("width", [0.249, 0.601, 0.0])
def test_a_width_beyond_the_range_is_refused_with_the_range(width: float) -> None:
    refused = EVERYTHING.objection(command(0)._replace(width=width))
    assert refused == f"width = {width:g}: must be from 0.25 to 0.6 m on this robot"


def test_a_refused_command_ages_the_one_before() -> None:
    one = arbiter()
    one.receive(command(0))
    one.receive(command(10, twist=MOTION))
    one.receive(command(90, twist=MOTION)._replace(region=Region.PULL))
    assert winner(one, 110) == "low"
    assert winner(one, 111) is None


def test_a_changing_width_is_motion_and_no_zero() -> None:
    able = Arbiter([Source(name="low", priority=1, timeout=0.1)], EVERYTHING)
    able.receive(command(0)._replace(width_rate=0.1))
    assert winner(able, 0) is None
    assert able.moving(0) is not None
    able.receive(command(1)._replace(width_rate=0.0))
    assert winner(able, 1) == "low"
    assert able.moving(1) is None


def test_a_width_to_go_to_is_motion_and_no_zero_wherever_the_wheels_are() -> None:
    able = Arbiter([Source(name="low", priority=1, timeout=0.1)], EVERYTHING)
    able.receive(command(0)._replace(width=0.4))
    assert winner(able, 0) is None
    assert able.moving(0) is not None
