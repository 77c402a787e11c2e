"""What every entry of DRIVERS must hold, whatever its protocol."""

import math
from itertools import pairwise
from struct import error as struct_error
from struct import pack
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import DRIVERS, driver_problem
from drivers.checks import id_conflicts
from drivers.contract import CanFrame, IdUse, MotorFeedback, MotorSpec, MotorState, OptionValue
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from gateway.core import snapshot
from tests.drivers.rig import (
    BUS,
    DRIVER_TYPES,
    MS,
    PAIRS,
    RIGS,
    UNDER_CONTRACT,
    WATCHDOG_S,
    Bench,
    FakeDji,
    FakeOdrive,
    FakeReplier,
    FakeVesc,
    Rig,
    bench,
    claimed,
    rig_of,
    spec,
    watched,
)

every_variant = pytest.mark.parametrize(("driver", "variant"), UNDER_CONTRACT)
MOVING = (CommandKind.VELOCITY, CommandKind.TORQUE, CommandKind.VOLTAGE)
LIMITS = {CommandKind.VELOCITY: 100.0, CommandKind.TORQUE: 2.0, CommandKind.VOLTAGE: 24.0}  # of the specs


def operational(driver: str, variant: str, kind: CommandKind) -> tuple[Bench, Rig]:
    """A bench brought up with zero setpoints."""
    stand, rig = bench(driver, variant)
    stand.run(MotorCommand(kind), ms=1000)
    assert [motor.state for motor in stand.feedback()] == [MotorState.OPERATIONAL] * 2
    return stand, rig


def moving_kinds(rig: Rig) -> list[CommandKind]:
    return [kind for kind in rig.kinds if kind in MOVING]


def power(stand: Bench, *, on: bool) -> None:
    for device in stand.devices:
        assert isinstance(device, FakeOdrive | FakeDji | FakeReplier | FakeVesc)
        device.powered = on


def test_every_driver_has_a_rig() -> None:
    assert set(RIGS) == set(DRIVER_TYPES) > set(DRIVERS)
    assert {spec(variant).variant for _, variant in UNDER_CONTRACT} >= {variant for _, variant in PAIRS}


@pytest.mark.parametrize(("driver", "variant"), PAIRS)
def test_names_are_explained(driver: str, variant: str) -> None:
    assert driver_problem(driver, variant) is None
    assert variant in (driver_problem(driver, "nonsense") or "")
    assert driver in (driver_problem("nonsense", variant) or "")


@every_variant
def test_ids_out_of_range_are_refused_with_the_range(driver: str, variant: str) -> None:
    for bad in rig_of(driver, variant).bad_ids:
        with pytest.raises(ValueError, match=rf"motor_{bad}: id = {bad}: must be \d+ to \d+"):
            DRIVER_TYPES[driver](BUS, [spec(variant, id=bad)])


@every_variant
def test_one_id_twice_is_refused(driver: str, variant: str) -> None:
    with pytest.raises(ValueError, match="motor right: id = 4: already the id of motor left"):
        DRIVER_TYPES[driver](BUS, [spec(variant, id=4, name="left"), spec(variant, id=4, name="right")])


@every_variant
def test_unknown_variants_and_empty_groups_are_refused(driver: str, variant: str) -> None:
    with pytest.raises(ValueError, match=f"motor_4: variant = 'x'.*{spec(variant).variant}"):
        DRIVER_TYPES[driver](BUS, [spec("x", id=4)])
    with pytest.raises(ValueError, match="at least one motor"):
        DRIVER_TYPES[driver](BUS, [])


@every_variant
def test_a_watchdog_that_cannot_be_verified_is_refused(driver: str, variant: str) -> None:
    if variant in rig_of(driver, variant).watchdogs:
        assert DRIVER_TYPES[driver](BUS, [rig_of(driver, variant).spec(variant, id=3)]).capabilities[0].device_watchdog
        return
    with pytest.raises(ValueError, match=r"motor_3: watchdog: .*watchdog_waiver"):
        DRIVER_TYPES[driver](BUS, [spec(variant, watchdog_s=WATCHDOG_S)])


ODD_VALUES: tuple[OptionValue, ...] = ("", "x", -1, 0, 65536, 10**30, 1.5, math.nan, math.inf, True)


@every_variant
def test_options_are_checked_by_the_driver_and_named_with_what_is_allowed(driver: str, variant: str) -> None:
    good = rig_of(driver, variant).spec(variant, id=3)
    DRIVER_TYPES[driver](BUS, [good])
    known = ", ".join(good.options) or "none"
    with pytest.raises(ValueError, match=rf"motor_3: options.poles = 7: no such option; .* has {known}$"):
        DRIVER_TYPES[driver](BUS, [good._replace(options={**good.options, "poles": 7})])
    for key in good.options:
        without = {name: value for name, value in good.options.items() if name != key}
        with pytest.raises(ValueError, match=rf"motor_3: options.{key} is missing: must be \S+"):
            DRIVER_TYPES[driver](BUS, [good._replace(options=without)])
        for value in ODD_VALUES:
            with pytest.raises(ValueError, match=rf"motor_3: options.{key} = .*: must be \S+"):
                DRIVER_TYPES[driver](BUS, [good._replace(options={**good.options, key: value})])


def test_options_of_an_odrive() -> None:
    def made(**options: OptionValue) -> OdriveDriver:
        return OdriveDriver(BUS, [watched()._replace(options={**watched().options, **options})])

    made(watchdog_enable_endpoint=1, watchdog_timeout_endpoint=65535, firmware="0.6.11")
    with pytest.raises(ValueError, match=r"options.watchdog_enable_endpoint = 65536: must be 1 to 65535, a parameter"):
        made(watchdog_enable_endpoint=65536)
    with pytest.raises(ValueError, match=r'options.firmware = .0.6.: must be the exact version .* like "0.6.10"'):
        made(firmware="0.6")
    with pytest.raises(
        ValueError, match=r"options.firmware = .*: no such option; an odrive without a watchdog has none"
    ):
        OdriveDriver(BUS, [watched()._replace(watchdog_s=None)])


@every_variant
def test_zero_command_stops(driver: str, variant: str) -> None:
    for kind in moving_kinds(rig_of(driver, variant)):
        stand, rig = operational(driver, variant, kind)
        assert any(rig.asked(stand.cycle([MotorCommand(kind, 1.0)] * 2)))
        assert rig.asked(stand.cycle([MotorCommand(kind, 0.0)] * 2))
        assert not any(rig.asked(stand.cycle([MotorCommand(kind, 0.0)] * 2)))


@every_variant
def test_brake_and_coast_ask_for_nothing(driver: str, variant: str) -> None:
    for still in (BRAKE, COAST):
        if still.kind not in rig_of(driver, variant).kinds:
            continue
        for kind in moving_kinds(rig_of(driver, variant)):
            stand, rig = operational(driver, variant, kind)
            stand.cycle([MotorCommand(kind, 1.0)] * 2)
            assert not any(rig.asked(stand.run(still, ms=1000)))


@every_variant
def test_odd_symmetry(driver: str, variant: str) -> None:
    for kind in moving_kinds(rig_of(driver, variant)):
        stand, rig = operational(driver, variant, kind)
        for value in (1e-3, 0.37, 1.9, 55.5, 1e9):
            plus = rig.asked(stand.cycle([MotorCommand(kind, value)] * 2))
            minus = rig.asked(stand.cycle([MotorCommand(kind, -value)] * 2))
            assert plus == [-asked for asked in minus]


@every_variant
def test_limits_saturate_and_never_wrap(driver: str, variant: str) -> None:
    for kind in moving_kinds(rig_of(driver, variant)):
        stand, rig = operational(driver, variant, kind)
        limit = LIMITS[kind]
        at_limit = rig.asked(stand.cycle([MotorCommand(kind, limit)] * 2))
        assert max(at_limit) > 0
        for value in (limit * 1.01, limit * 1e6, 1e300, math.inf):
            assert rig.asked(stand.cycle([MotorCommand(kind, value)] * 2)) == at_limit
        rising = [sum(rig.asked(stand.cycle([MotorCommand(kind, limit * step / 50)] * 2))) for step in range(-60, 61)]
        assert rising == sorted(rising)


@every_variant
def test_nan_and_foreign_kinds_raise_in_any_state(driver: str, variant: str) -> None:
    stand, rig = bench(driver, variant)
    for _ in range(2):
        for kind in rig.kinds:
            with pytest.raises(ValueError, match=f"motor_{rig.ids[1]}"):
                stand.driver.command([COAST, MotorCommand(kind, math.nan)], now_ns=stand.now_ns)
        for kind in set(CommandKind) - set(rig.kinds):
            with pytest.raises(ValueError, match=f"motor_{rig.ids[0]}"):
                stand.driver.command([MotorCommand(kind), COAST], now_ns=stand.now_ns)
        with pytest.raises(ValueError, match="1 commands: must be one for each of 2 motors"):
            stand.driver.command([COAST], now_ns=stand.now_ns)
        stand.run(MotorCommand(rig.kinds[0]), ms=1000)


@every_variant
def test_capabilities_are_the_kinds_it_takes(driver: str, variant: str) -> None:
    stand, rig = bench(driver, variant)
    for able in stand.driver.capabilities:
        assert claimed(able) == set(rig.kinds)
        assert able.brake >= able.velocity, "the core brakes a motor that it gives velocities"
    assert len(stand.driver.capabilities) == 2


@every_variant
def test_a_feed_forward_goes_with_a_velocity_within_the_torque_limit_and_leaves_nothing_behind(
    driver: str, variant: str
) -> None:
    stand, rig = bench(driver, variant)
    if not stand.driver.capabilities[0].feed_forward:
        return
    velocity = CommandKind.VELOCITY
    for _ in range(250):
        moving = sum(value != 0 for value in rig.asked(stand.cycle([MotorCommand(velocity, 0.0, 1.0)] * 2)))
        assert moving <= stand.states.count(MotorState.OPERATIONAL)

    def asked(feed_forward: float) -> list[float]:
        return rig.asked(stand.cycle([MotorCommand(velocity, 3.0, feed_forward)] * 2))

    plain = asked(0.0)
    for value in (1e-3, 0.37, 1.9):
        plus, minus = ([now - then for now, then in zip(asked(sign * value), plain, strict=True)] for sign in (1, -1))
        assert plus == [-each for each in minus]
        assert sum(plus) > 0.0
    for value in (2.0 * 1.01, 1e300, math.inf):
        assert asked(value) == asked(2.0)
    for still in (BRAKE, COAST, MotorCommand(velocity)):
        asked(1.0)
        assert not any(rig.asked(stand.cycle([still] * 2)))
    with pytest.raises(ValueError, match=f"motor_{rig.ids[1]}"):
        stand.driver.command([COAST, MotorCommand(velocity, 1.0, math.nan)], now_ns=stand.now_ns)


@every_variant
def test_a_feed_forward_or_a_limit_where_none_is_claimed_is_refused(driver: str, variant: str) -> None:
    stand, rig = bench(driver, variant)
    able = stand.driver.capabilities[0]
    extras = {(1.0, None): able.feed_forward, (0.0, 1.0): able.limit, (0.0, math.inf): able.limit}
    for kind in rig.kinds:
        for (feed_forward, limit), claims in extras.items():
            if kind is not CommandKind.VELOCITY or not claims:
                with pytest.raises(ValueError, match=f"motor_{rig.ids[0]}"):
                    stand.driver.command([MotorCommand(kind, 0.0, feed_forward, limit), COAST], now_ns=stand.now_ns)


@every_variant
def test_foreign_short_remote_extended_and_sent_frames_are_ignored(driver: str, variant: str) -> None:
    stand, _ = bench(driver, variant)
    stand.run(COAST, ms=500)
    known = stand.said()
    assert known
    before = stand.feedback()
    for frame in known:
        strange = [
            frame._replace(bus="can1"),
            frame._replace(extended=not frame.extended),
            frame._replace(remote=True, data=b""),
            frame._replace(fd=not frame.fd),
            frame._replace(received_ns=None),
            frame._replace(id=frame.id ^ 0x600),
            # One byte may be padding (the last of an ODrive 0.6 heartbeat is), two never.
            *(frame._replace(data=frame.data[:length]) for length in range(len(frame.data) - 1)),
        ]
        assert not any([stand.driver.receive(each) for each in strange])
    assert stand.feedback() == before


@every_variant
def test_never_heard_is_silent_and_unknown(driver: str, variant: str) -> None:
    stand, _ = bench(driver, variant)
    for motor in stand.feedback():
        assert motor.state is MotorState.SILENT
        assert motor == MotorFeedback(MotorState.SILENT)


@every_variant
def test_silence_ages_and_ends_setpoints_then_heals(driver: str, variant: str) -> None:
    kind = moving_kinds(rig_of(driver, variant))[0]
    stand, rig = operational(driver, variant, kind)
    power(stand, on=False)
    ages = []
    for _ in range(100):
        ages.append([motor.age_ns or 0 for motor in stand.feedback()])
        stand.cycle([MotorCommand(kind, 1.0)] * 2)
    assert all(later > earlier for earlier, later in pairwise(ages))
    assert all(motor.state is MotorState.SILENT and motor.fault is None for motor in stand.feedback())
    assert not any(rig.asked(stand.cycle([MotorCommand(kind, 1.0)] * 2)))
    power(stand, on=True)
    stand.run(MotorCommand(kind, 1.0), ms=1000)
    assert all(motor.state is MotorState.OPERATIONAL for motor in stand.feedback())
    assert all(motor.age_ns is not None and motor.age_ns < 50 * MS for motor in stand.feedback())


@every_variant
def test_a_fault_bit_becomes_a_latched_fault(driver: str, variant: str) -> None:
    fault_frame = rig_of(driver, variant).fault_frame
    stand, rig = operational(driver, variant, moving_kinds(rig_of(driver, variant))[0])
    if fault_frame is None:
        assert all(motor.fault is None for motor in stand.feedback())
        return
    assert stand.driver.receive(fault_frame(rig.ids[0], variant)._replace(received_ns=stand.now_ns))
    first, second = stand.feedback()
    assert first.state is MotorState.FAULT
    assert first.fault is not None
    assert first.fault.latched
    assert second.state is MotorState.OPERATIONAL
    moving = [MotorCommand(moving_kinds(rig)[0], 1.0)] * 2
    asked = [any(rig.asked([frame])) for frame in stand.cycle(moving)]
    assert asked.count(True) == 1
    stand.run(COAST, ms=1000)
    assert stand.feedback()[0].state is MotorState.FAULT
    stand.driver.clear_faults()
    stand.run(COAST, ms=1000)
    assert [motor.state for motor in stand.feedback()] == [MotorState.IDLE] * 2


@every_variant
def test_nothing_is_asked_before_operational(driver: str, variant: str) -> None:
    for kind in moving_kinds(rig_of(driver, variant)):
        stand, rig = bench(driver, variant)
        for _ in range(250):
            moving = sum(value != 0 for value in rig.asked(stand.cycle([MotorCommand(kind, 1.0)] * 2)))
            assert moving <= stand.states.count(MotorState.OPERATIONAL)
        assert any(rig.asked(stand.cycle([MotorCommand(kind, 1.0)] * 2)))


@every_variant
def test_coast_and_stop_frames_are_valid_in_any_state(driver: str, variant: str) -> None:
    stand, rig = bench(driver, variant)
    fresh = (stand.driver.coast_frames(), stand.driver.stop_frames(now_ns=stand.now_ns))
    for frames in fresh:
        assert frames
        assert not any(rig.asked(frames))
        assert rig.asked(frames)
        assert all(stand.driver.decode(frame) is not None and frame.bus == BUS for frame in frames)
    stand.run(MotorCommand(moving_kinds(rig)[0], 1.0), ms=1000)
    assert (stand.driver.coast_frames(), stand.driver.stop_frames(now_ns=stand.now_ns)) == fresh
    stand.driver.coast_frames().clear()
    assert stand.driver.coast_frames() == fresh[0]


@pytest.mark.parametrize(("driver", "variant"), [pair for pair in UNDER_CONTRACT if pair[0] in DRIVERS])
def test_its_state_is_in_the_snapshot_of_the_core(driver: str, variant: str) -> None:
    kind = moving_kinds(rig_of(driver, variant))[0]
    stand, rig = operational(driver, variant, kind)
    state = snapshot.take(stand.driver, "a robot")
    restored = DRIVERS[driver](BUS, rig.specs(variant))
    assert snapshot.take(restored, "a robot") != state
    snapshot.put(restored, "a robot", state)
    assert snapshot.take(restored, "a robot") == state
    command, now_ns = [MotorCommand(kind, 1.0)] * 2, stand.now_ns
    assert restored.command(command, now_ns=now_ns) == stand.driver.command(command, now_ns=now_ns)
    assert restored.feedback(now_ns=now_ns) == stand.driver.feedback(now_ns=now_ns)


@every_variant
def test_every_frame_sent_and_heard_can_be_put_in_words(driver: str, variant: str) -> None:
    stand, _ = operational(driver, variant, moving_kinds(rig_of(driver, variant))[0])
    for _, frame in stand.sent:
        assert stand.driver.decode(frame) is not None
    for frame in stand.said():
        assert stand.driver.decode(frame) is not None


@every_variant
def test_traffic_counts_both_directions(driver: str, variant: str) -> None:
    stand, rig = bench(driver, variant)
    traffic = stand.driver.traffic(loop_rate_hz=200.0)
    assert len({item.name for item in traffic}) == len(traffic)
    assert all(item.extended == rig.extended and item.rate_hz > 0 for item in traffic)
    cyclic = spec(variant).feedback_rate is not None
    command, measurement = rig.lengths
    lengths = {rate: [item.length for item in traffic if item.rate_hz == rate] for rate in (200.0, 250.0)}
    assert lengths[200.0] == [command] * 2 + ([] if cyclic else [measurement] * 2)
    assert lengths[250.0] == ([measurement] * 2 * rig.cyclic if cyclic else [])


def uses(use: IdUse, frame: CanFrame) -> bool:
    return use.extended == frame.extended and not (use.id ^ frame.id) & use.mask


@every_variant
def test_every_id_sent_or_taken_is_declared_and_the_filters_ask_for_no_other(driver: str, variant: str) -> None:
    stand, rig = operational(driver, variant, moving_kinds(rig_of(driver, variant))[0])
    declared = stand.driver.ids()
    sent = [frame for _, frame in stand.sent]
    emergency = [*stand.driver.coast_frames(), *stand.driver.stop_frames(now_ns=stand.now_ns)]
    for frame in (*sent, *emergency, *stand.said()):
        assert any(uses(use, frame) for use in declared), frame
    for wanted in stand.driver.receive_filters():
        assert any(use.mask & wanted.mask == use.mask and not (use.id ^ wanted.id) & use.mask for use in declared)
    assert all(f"motor_{at}" in " ".join(use.user for use in declared) for at in rig.ids)
    assert id_conflicts([declared]) == []
    assert id_conflicts([declared, declared]) != []


@pytest.mark.parametrize("variant", ["0.5", "0.6"])
@pytest.mark.parametrize(
    ("node", "motor", "shared"),
    [
        (16, 1, "odrive node 16 of motor motor_16 (0x200 to 0x21F) and dji command of motor motor_1 (0x200)"),
        (16, 8, "odrive node 16 of motor motor_16 (0x200 to 0x21F) and dji feedback of motor motor_8 (0x208)"),
        (15, 5, "odrive node 15 of motor motor_15 (0x1E0 to 0x1FF) and dji command of motor motor_5 (0x1FF)"),
        (56, 1, "odrive node 56 of motor motor_56 (0x700 to 0x71F) and dji setting of ids (0x700)"),
        (15, 4, None),
        (17, 8, None),
        (3, 1, None),
    ],
)
def test_ids_of_two_drivers_on_one_bus(variant: str, node: int, motor: int, shared: str | None) -> None:
    first, second = DRIVERS["odrive"](BUS, [spec(variant, id=node)]), DRIVERS["dji"](BUS, [spec("c620", id=motor)])
    conflicts = id_conflicts([first.ids(), second.ids()])
    assert any(conflict.startswith(shared) for conflict in conflicts) if shared else conflicts == []
    assert len(id_conflicts([second.ids(), first.ids()])) == len(conflicts)


WILD = (math.nan, math.inf, -math.inf, 0.0, -1.0, 5e-324, 1e-300, 1e300)


@every_variant
@pytest.mark.parametrize("key", ["max_speed", "max_torque", "max_current", "feedback_rate"])
def test_wild_numbers_are_refused_by_motor_key_value_and_range(driver: str, variant: str, key: str) -> None:
    for value in WILD:
        with pytest.raises(ValueError, match=rf"motor_3: {key} = .*: must be "):
            DRIVER_TYPES[driver](BUS, [MotorSpec(**spec(variant)._asdict() | {key: value})])


@every_variant
def test_silence_is_noticed_within_half_a_second_at_the_slowest_feedback_that_is_taken(
    driver: str, variant: str
) -> None:
    if spec(variant).feedback_rate is None:
        return
    slow = spec(variant, id=3)._replace(feedback_rate=10.0)
    stand = Bench(DRIVER_TYPES[driver](BUS, [slow]), [rig_of(driver, variant).device(3, variant)])
    stand.run(COAST, ms=200)
    assert stand.feedback()[0].state is not MotorState.SILENT
    stand.now_ns += 500 * MS
    assert stand.feedback()[0].state is MotorState.SILENT
    with pytest.raises(ValueError, match=r"feedback_rate = 9.9: must be 10 to 1000 Hz: .*silent after 5 periods"):
        DRIVER_TYPES[driver](BUS, [slow._replace(feedback_rate=9.9)])


@every_variant
def test_feedback_is_cyclic_or_by_reply_and_a_rate_for_the_other_is_refused(driver: str, variant: str) -> None:
    if spec(variant).feedback_rate is None:
        with pytest.raises(ValueError, match=r"motor_3: feedback_rate = 250: must be left out: .* only replies"):
            DRIVER_TYPES[driver](BUS, [spec(variant)._replace(feedback_rate=250.0)])
    else:
        with pytest.raises(
            ValueError, match=r"motor_3: feedback_rate is missing: must be .* to 1000 Hz, as configured"
        ):
            DRIVER_TYPES[driver](BUS, [spec(variant)._replace(feedback_rate=None)])


@every_variant
def test_replies_are_missing_from_the_first_command_that_nobody_answered(driver: str, variant: str) -> None:
    """The loop stands still for ten seconds: who is asked nothing owes nothing. Then one reply is lost, then all."""
    if spec(variant).feedback_rate is not None:
        return
    kind = moving_kinds(rig_of(driver, variant))[0]
    stand, rig = operational(driver, variant, kind)
    stand.now_ns += 10_000 * MS
    assert [motor.state for motor in stand.feedback()] == [MotorState.OPERATIONAL] * 2
    assert all(motor.age_ns is not None and motor.age_ns >= 10_000 * MS for motor in stand.feedback())
    for lost in (True, False, True, False):
        power(stand, on=not lost)
        assert any(rig.asked(stand.cycle([MotorCommand(kind, 1.0)] * 2)))
    power(stand, on=False)
    states = [stand.cycle([MotorCommand(kind, 1.0)] * 2) and stand.feedback()[0].state for _ in range(20)]
    at_ms = (states.index(MotorState.SILENT) + 1) * 4
    assert 50 <= at_ms < 54
    assert stand.driver.command([COAST] * 2, now_ns=stand.now_ns), "a silent motor is asked on"


@pytest.mark.parametrize("rate", [10.0, 50.0, 250.0, 1000.0])
def test_a_watchdog_outlives_a_lost_frame_at_any_loop_rate(rate: float) -> None:
    def motor(timeout: float) -> MotorSpec:
        return watched()._replace(watchdog_s=timeout, command_rate=rate)

    DRIVERS["odrive"](BUS, [motor(3.0 / rate)])
    for wrong in (2.9 / rate, 1.1, 0.0, 1e-300, math.nan):
        with pytest.raises(
            ValueError, match=r"motor_3: watchdog.timeout = .*: must be .* to 1 s: 3 periods of loop.rate"
        ):
            DRIVERS["odrive"](BUS, [motor(wrong)])


SHORT_IDS = st.one_of(
    st.integers(0x60, 0x7F), st.integers(0, 0x1F), st.integers(0x1FE, 0x20B), st.integers(0, 0x1FFF_FFFF)
)
LONG_IDS = st.builds(lambda command, id: command << 8 | id, st.integers(0, 63), st.sampled_from([3, 0, 128, 131]))
ANSWERS = st.builds(
    lambda id, mask, value: pack(">BBBIB", id, 1, 50, 1 << mask, value),
    *(st.sampled_from([3, 0, 9]), st.sampled_from([15, 21, 7]), st.integers(0, 255)),
)
DATA = st.one_of(st.binary(max_size=12), st.binary(min_size=8, max_size=8), ANSWERS)


def frames(ids: st.SearchStrategy[int], *, extended: bool) -> st.SearchStrategy[CanFrame]:
    """Mostly of this form."""
    return st.builds(
        CanFrame,
        bus=st.sampled_from([BUS, BUS, BUS, "can1"]),
        id=ids,
        data=DATA,
        extended=st.sampled_from([extended, extended, extended, not extended]),
        remote=st.sampled_from([False, False, False, True]),
        received_ns=st.one_of(st.none(), st.integers(0, 3_000 * MS)),
    )


FRAMES = st.one_of(frames(SHORT_IDS, extended=False), frames(LONG_IDS, extended=True))
NUMBERS = st.floats(allow_nan=False)


@st.composite
def stories(draw: st.DrawFn) -> tuple[str, str, list[Any]]:
    """A driver, and a list of frames, commands and resets to throw at it."""
    driver, variant = draw(st.sampled_from(UNDER_CONTRACT))
    commands = st.tuples(st.sampled_from(rig_of(driver, variant).kinds), NUMBERS)
    return driver, variant, draw(st.lists(st.one_of(FRAMES, FRAMES, commands, st.none()), max_size=40))


@settings(max_examples=150, deadline=None)
@given(stories())
def test_any_bytes_at_any_time_never_raise_and_never_move_a_motor_that_is_not_operational(
    story: tuple[str, str, list[Any]],
) -> None:
    driver, variant, events = story
    stand, rig = bench(driver, variant)
    for event in events:
        if isinstance(event, CanFrame):
            stand.driver.receive(event)
            stand.driver.decode(event)
            continue
        if event is None:
            stand.driver.clear_faults()
            continue
        frames = stand.driver.command([MotorCommand(*event)] * 2, now_ns=stand.now_ns)
        feedback = stand.feedback()
        for motor in feedback:
            assert all(value is None or math.isfinite(value) for value in motor[1:6])
            assert motor.age_ns is None or motor.age_ns >= 0
        if MotorState.OPERATIONAL not in {motor.state for motor in feedback}:
            assert not any(rig.asked(frames))
        stand.now_ns += 50 * MS


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(UNDER_CONTRACT), FRAMES)
def test_what_receive_refuses_is_shown_as_no_measurement(pair: tuple[str, str], frame: CanFrame) -> None:
    agree(*bench(*pair), frame)


@every_variant
def test_decode_and_receive_agree_for_every_id_and_length(driver: str, variant: str) -> None:
    stand, rig = bench(driver, variant)
    for fill in (b"\x00", b"\xff", b"\x1f"):
        for identifier in rig.every_id:
            for length in range(9):
                frame = CanFrame(BUS, identifier, fill * length, rig.extended, received_ns=stand.now_ns)
                for each in (frame, frame._replace(remote=True), frame._replace(extended=not rig.extended)):
                    agree(stand, rig, each)


def agree(stand: Bench, rig: Rig, frame: CanFrame) -> None:
    """Taken: in words. Refused: no words, or those of a command or a request."""
    frame = frame._replace(received_ns=stand.now_ns)
    decoded = stand.driver.decode(frame)
    if stand.driver.receive(frame):
        assert decoded is not None
        assert not rig.from_host(decoded)
    else:
        assert decoded is None or rig.from_host(decoded), (frame, decoded)


@every_variant
def test_every_id_with_every_length_is_harmless(driver: str, variant: str) -> None:
    stand, rig = operational(driver, variant, moving_kinds(rig_of(driver, variant))[0])
    for fill in (b"\x00", b"\xff", b"\x7f", b"\x80"):
        for identifier in rig.every_id:
            for length in (0, 1, 4, 5, 7, 8):
                frame = CanFrame(BUS, identifier, fill * length, rig.extended, received_ns=stand.now_ns)
                try:
                    stand.driver.receive(frame)
                    stand.driver.decode(frame)
                except struct_error as error:
                    pytest.fail(f"{frame}: {error}")
    stand.run(COAST, ms=100)
