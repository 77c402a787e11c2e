"""Rest: what is measured must stand for a while; only where nothing is measured does time count instead."""

from gateway.core.standstill import Standstill

REST_DWELL_NS = 250_000_000
ROLL_NS = 100_000_000
REST_TIMEOUT_NS = 4_000_000_000
START_NS = 7_000_000_000


def watch(turning: bool | None, *, braking: bool = True) -> Standstill:
    standstill = Standstill()
    standstill.measure(turning=turning, measurable=turning is not None, now_ns=START_NS)
    standstill.command(braking=braking, now_ns=START_NS)
    return standstill


def test_rests_after_the_dwell_and_not_before() -> None:
    standstill = watch(False)
    assert not standstill.rested(START_NS + REST_DWELL_NS - 1)
    assert standstill.rested(START_NS + REST_DWELL_NS)


def test_a_touch_begins_the_dwell_anew() -> None:
    standstill = watch(False)
    standstill.measure(turning=True, measurable=True, now_ns=START_NS + 1)
    standstill.measure(turning=False, measurable=True, now_ns=START_NS + 2)
    assert not standstill.rested(START_NS + 1 + REST_DWELL_NS)
    assert standstill.rested(START_NS + 2 + REST_DWELL_NS)


def test_where_nothing_is_measured_only_the_timeout_counts() -> None:
    standstill = watch(None)
    assert not standstill.rested(START_NS + REST_TIMEOUT_NS)
    assert standstill.rested(START_NS + REST_TIMEOUT_NS + 1)


def test_the_timeout_counts_from_braking_too() -> None:
    standstill = watch(None, braking=False)
    standstill.command(braking=True, now_ns=START_NS + 5)
    assert not standstill.rested(START_NS + REST_TIMEOUT_NS + 5)
    assert standstill.rested(START_NS + REST_TIMEOUT_NS + 6)


def test_what_turns_never_rests() -> None:
    assert not watch(True).rested(START_NS + 100 * REST_TIMEOUT_NS)


def test_rests_only_while_it_brakes() -> None:
    for turning in (False, None):
        assert not watch(turning, braking=False).rested(START_NS + 100 * REST_TIMEOUT_NS)


def test_rolls_once_it_has_turned_for_a_while() -> None:
    standstill = watch(True)
    assert not standstill.rolls(START_NS + ROLL_NS - 1)
    assert standstill.rolls(START_NS + ROLL_NS)
    assert not watch(None).rolls(START_NS + 10 * ROLL_NS)


def test_standing_is_unknown_where_too_few_wheels_report() -> None:
    standstill = Standstill()
    for turning, measurable, standing in ((False, True, True), (False, False, None), (True, False, False)):
        standstill.measure(turning=turning, measurable=measurable, now_ns=0)
        assert standstill.standing is standing


def test_every_stretch_counts_from_its_beginning() -> None:
    for turning, rested_ns, rolls in (
        (False, REST_DWELL_NS, False),
        (None, REST_TIMEOUT_NS + 1, False),
        (True, None, True),
    ):
        standstill = watch(turning)
        for now_ns in range(START_NS, START_NS + 5_000_000_000, 50_000_000):
            standstill.measure(turning=turning, measurable=turning is not None, now_ns=now_ns)
            standstill.command(braking=True, now_ns=now_ns)
        assert standstill.rested(START_NS + (rested_ns or REST_TIMEOUT_NS)) is (rested_ns is not None)
        assert standstill.rolls(START_NS + ROLL_NS) is rolls


def test_before_the_first_measurement_nothing_is_known() -> None:
    standstill = Standstill()
    assert standstill.standing is None
    assert not standstill.rolls(START_NS)
    standstill.measure(turning=False, measurable=True, now_ns=START_NS)
    assert not standstill.rested(START_NS + REST_DWELL_NS), "nobody asked it to brake"
    standstill = Standstill()
    standstill.command(braking=True, now_ns=START_NS)
    assert not standstill.rested(START_NS + 100 * REST_TIMEOUT_NS)


def test_wheels_that_stand_while_too_few_report_say_nothing_of_the_body_before_the_timeout() -> None:
    standstill = Standstill()
    standstill.measure(turning=False, measurable=False, now_ns=START_NS)
    standstill.command(braking=True, now_ns=START_NS)
    assert not standstill.rested(START_NS + REST_TIMEOUT_NS)
    assert standstill.rested(START_NS + REST_TIMEOUT_NS + 1)
    standstill.measure(turning=False, measurable=True, now_ns=START_NS + 9)
    assert not standstill.rested(START_NS + 9 + REST_DWELL_NS - 1)
    assert standstill.rested(START_NS + 9 + REST_DWELL_NS)
