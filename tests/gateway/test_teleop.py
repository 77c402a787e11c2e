"""What moves a robot that is driven by hand and what never does: keys, gamepads, and the hand of both."""

import platform
from collections.abc import Mapping
from importlib import import_module
from math import hypot, isfinite
from typing import NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.teleop import pad as codes
from gateway.teleop.hand import LATE_S, SCALES, Hand, Wish
from gateway.teleop.keys import KEYS, QUIT_KEYS, RELEASE_S, RESET_KEY, STOP_KEY, Keys
from gateway.teleop.pad import (
    LAYOUTS,
    SILENT_S,
    Axis,
    Device,
    InputEvent,
    Layout,
    Pad,
    is_pad,
    layout_of,
    what_it_has,
    wrong_ranges,
)
from gateway.types import ZERO_TWIST, Twist

TOP = Twist(0.3, 0.3, 0.6)
TICK_S = 0.02
FORWARD = Twist(1.0, 0.0, 0.0)

# the hand


def held(press: int | None, direction: Twist = FORWARD) -> Wish:
    return Wish(direction, press)


def looked(hand: Hand, *wishes: Wish, ready: bool = True, step: float = TICK_S) -> list[Twist]:
    return [hand.order(wish, number * step, ready=ready) for number, wish in enumerate(wishes)]


def test_a_press_while_the_robot_is_ready_drives_until_it_ends() -> None:
    sent = looked(Hand(TOP), held(None), held(1), held(1), held(None), held(2))
    go = Twist(0.3, 0.0, 0.0)
    assert sent == [ZERO_TWIST, go, go, ZERO_TWIST, go]


def test_what_is_held_at_the_start_does_not_count() -> None:
    assert looked(Hand(TOP), held(1), held(1), held(1)) == [ZERO_TWIST] * 3


@pytest.mark.parametrize(
    ("between", "ready", "later"),
    [(held(1), False, 0.0), (held(1)._replace(stop=True), True, 0.0), (held(1), True, LATE_S + 0.01)],
    ids=["not ready", "stop", "nobody looked"],
)
def test_what_ended_a_press_wants_another_one(between: Wish, ready: bool, later: float) -> None:
    hand = Hand(TOP)
    looked(hand, held(None), held(1))
    now = TICK_S + later
    assert hand.order(between, now + TICK_S, ready=ready) == ZERO_TWIST
    assert hand.order(held(1), now + 2 * TICK_S, ready=True) == ZERO_TWIST
    assert hand.order(held(2), now + 3 * TICK_S, ready=True) != ZERO_TWIST


def test_a_press_while_the_robot_is_not_ready_never_counts() -> None:
    hand = Hand(TOP)
    looked(hand, held(None), held(1), ready=False)
    assert hand.order(held(1), 2 * TICK_S, ready=True) == ZERO_TWIST
    assert not hand.counts


def test_the_scale_goes_down_to_the_least_and_up_to_the_top() -> None:
    hand = Hand(TOP)
    looked(hand, held(None), held(1))
    sizes = [hand.order(held(1)._replace(faster=-1), TICK_S * number, ready=True).vx for number in range(2, 8)]
    assert sizes == pytest.approx([0.3 * scale for scale in (0.75, 0.5, 0.25, 0.1, 0.1, 0.1)])
    assert hand.order(held(1)._replace(faster=9), TICK_S * 8, ready=True) == Twist(0.3, 0.0, 0.0)
    assert hand.scale == 1.0


def test_figures() -> None:
    """What else somebody would have to notice: of them the tests below are told in units of themselves."""
    assert SCALES == (1.0, 0.75, 0.5, 0.25, 0.1)
    assert (LATE_S, RELEASE_S, SILENT_S) == (0.5, 0.6, 2.0)
    assert not Hand(TOP).counts


def test_a_look_at_the_last_moment_is_in_time() -> None:
    hand = Hand(TOP)
    hand.order(held(None), 0.0, ready=True)
    assert hand.order(held(1), LATE_S, ready=True) == Twist(0.3, 0.0, 0.0)


# keys


def test_a_held_key_drives_until_its_repeats_stop() -> None:
    keys, hand = Keys(), Hand(TOP)
    hand.order(keys.press("", 0.0), 0.0, ready=True)
    wish = keys.press("w", 0.0)
    assert hand.order(wish, 0.0, ready=True) == Twist(0.3, 0.0, 0.0)
    assert keys.press("", RELEASE_S) == wish
    assert keys.press("", RELEASE_S + 0.01) == Wish()


@pytest.mark.parametrize(
    ("read", "direction"),
    [("wwq", Twist(0.0, 0.0, 1.0)), ("qw ", ZERO_TWIST), ("w\x1b[D", FORWARD), ("www!", ZERO_TWIST)],
)
def test_of_several_keys_in_one_read_the_last_that_moves_counts(read: str, direction: Twist) -> None:
    wish = Keys().press(read, 0.0)
    assert wish.direction == direction
    assert (wish.press is None) is (direction == ZERO_TWIST)


def test_another_key_in_place_of_one_that_is_held_is_no_new_press() -> None:
    keys = Keys()
    first, second = keys.press("w", 0.0), keys.press("a", 0.1)
    assert first.press == second.press
    keys.press(" ", 0.2)
    assert keys.press("a", 0.3).press != first.press


@given(st.text("".join(KEYS) + STOP_KEY + RESET_KEY + "".join(QUIT_KEYS), max_size=20))
def test_a_stop_key_anywhere_in_a_read_wins(read: str) -> None:
    keys = Keys()
    keys.press("w", 0.0)
    wish = keys.press(read, 0.01)
    assert wish.stop is (STOP_KEY in read)
    assert wish.quit is bool(QUIT_KEYS & set(read))
    assert wish.reset is (RESET_KEY in read and STOP_KEY not in read)
    if wish.stop:
        assert (wish.direction, wish.press) == (ZERO_TWIST, None)
    later = keys.press("", 0.02)
    assert not (later.stop or later.reset or later.quit), "asked once"


@pytest.mark.parametrize(("read", "faster"), [("+", 1), ("=", 1), ("-", -1), ("w--+q-", -2), ("wx", 0)])
def test_keys_of_the_scale(read: str, faster: int) -> None:
    assert Keys().press(read, 0.0).faster == faster


# which pad is which

XBOX = Device(
    "/dev/input/event3",
    "Xbox",
    0x045E,
    0x028E,
    frozenset({*range(0x130, 0x132), 0x133, 0x134, 0x136, 0x137}),
    frozenset({0, 1, 2, 3, 4, 5, 16, 17}),
)
PADS = {
    "xpad": (XBOX, (0x136, "LB", 0x131, "B", 3)),
    "xbox by bluetooth": (
        XBOX._replace(
            product=0x0B13, buttons=frozenset(range(0x130, 0x13F)), axes=frozenset({0, 1, 2, 5, 9, 10, 16, 17})
        ),
        (0x136, "LB", 0x131, "B", 2),
    ),
    "dualsense": (XBOX._replace(vendor=0x054C, product=0x0CE6), (0x136, "L1", 0x131, "circle", 3)),
    "dualshock, numbered": (
        XBOX._replace(vendor=0x054C, product=0x09CC, buttons=frozenset(range(0x130, 0x13E))),
        (0x134, "L1", 0x132, "circle", 2),
    ),
    "any by the standard": (
        XBOX._replace(vendor=0x2DC8),
        (0x136, "the upper left shoulder button", 0x131, "the right one of the four buttons", 3),
    ),
    "any with z and rz": (
        XBOX._replace(vendor=0x2DC8, axes=frozenset({0, 1, 2, 5, 16, 17})),
        (0x136, "the upper left shoulder button", 0x131, "the right one of the four buttons", 2),
    ),
    "numbered joystick": (
        XBOX._replace(
            vendor=0x0079, product=6, buttons=frozenset(range(0x120, 0x12C)), axes=frozenset({0, 1, 2, 5, 16, 17})
        ),
        (0x124, "button 5", 0x122, "button 3", 2),
    ),
}


@pytest.mark.parametrize("name", PADS)
def test_known_pads(name: str) -> None:
    device, (deadman, deadman_name, stop, stop_name, turn) = PADS[name]
    layout = layout_of(device)
    assert layout is not None
    assert layout[:5] == (deadman, deadman_name, stop, stop_name, turn)


@pytest.mark.parametrize("name", PADS)
def test_a_pad_needs_what_its_layout_uses_and_no_more(name: str) -> None:
    device, _ = PADS[name]
    layout = layout_of(device)
    assert layout is not None
    (row,) = (row for row in LAYOUTS if row.layout is layout)
    buttons, axes_ = row.buttons | {layout.deadman, layout.stop}, row.axes | {0, 1, layout.turn, layout.other}
    least = device._replace(buttons=buttons, axes=axes_)
    assert layout_of(least) is layout
    assert [one for one in buttons if layout_of(least._replace(buttons=buttons - {one})) is layout] == []
    assert [one for one in axes_ if layout_of(least._replace(axes=axes_ - {one})) is layout] == []


def test_every_row_is_somebodys() -> None:
    assert {layout_of(device) for device, _ in PADS.values()} == {row.layout for row in LAYOUTS}


@pytest.mark.parametrize(
    ("device", "pad"),
    [
        (XBOX._replace(axes=frozenset({0, 1})), True),
        (XBOX._replace(buttons=frozenset({0x130})), True),
        (XBOX._replace(buttons=frozenset(range(0x120, 0x12C)), axes=frozenset({0, 1, 5, 6})), True),  # a flight stick
        (XBOX._replace(buttons=frozenset(), axes=frozenset(range(6))), False),  # motion sensors of a pad
        (XBOX._replace(buttons=frozenset({0x110, 0x145, 0x14A}), axes=frozenset({0, 1, 0x2F})), False),  # its touchpad
        (XBOX._replace(buttons=frozenset(range(1, 120)), axes=frozenset()), False),  # a keyboard
    ],
)
def test_what_has_no_known_sticks_has_no_layout(device: Device, pad: bool) -> None:
    assert layout_of(device) is None
    assert is_pad(device) is pad


def test_what_a_device_has_in_words() -> None:
    device = XBOX._replace(buttons=frozenset({0x130}), axes=frozenset({1, 0x28}))
    assert what_it_has(device) == "axes Y, 0x28; buttons 0x130"
    assert what_it_has(device._replace(buttons=frozenset(), axes=frozenset())) == "axes none; buttons none"


def test_a_range_that_is_none_is_told() -> None:
    assert wrong_ranges({0: Axis(0, -5, 5, 0), 1: Axis(0, 3, 3, 0)}) == ["axis Y goes from 3 to 3"]


# a pad

LAYOUT = LAYOUTS[2].layout  # Xbox
X, Y, TURN = codes.ABS_X, codes.ABS_Y, LAYOUT.turn
SYN = InputEvent(codes.EV_SYN, 0, 0)
DROPPED = InputEvent(codes.EV_SYN, codes.SYN_DROPPED, 0)
PRESS, RELEASE = (InputEvent(codes.EV_KEY, LAYOUT.deadman, value) for value in (1, 0))
STOP = InputEvent(codes.EV_KEY, LAYOUT.stop, 1)


def axes(flat: int = 128, **values: int) -> dict[int, Axis]:
    given_ = {"x": 0, "y": 0, "turn": 0} | values
    return {code: Axis(given_[name], -32768, 32767, flat) for name, code in (("x", X), ("y", Y), ("turn", TURN))}


def pad(found: Mapping[int, Axis] | None = None, layout: Layout = LAYOUT) -> Pad:
    return Pad(layout, dict(found or axes()))


def stick(code: int, value: int) -> InputEvent:
    return InputEvent(codes.EV_ABS, code, value)


@pytest.mark.parametrize(
    ("event", "direction"),
    [
        (stick(Y, -32768), Twist(1.0, 0.0, 0.0)),  # away from the hand: forward
        (stick(Y, 32767), Twist(-1.0, 0.0, 0.0)),
        (stick(X, -32768), Twist(0.0, 1.0, 0.0)),  # to the left
        (stick(X, 32767), Twist(0.0, -1.0, 0.0)),
        (stick(TURN, -32768), Twist(0.0, 0.0, 1.0)),  # to the left: counter-clockwise
        (stick(TURN, 32767), Twist(0.0, 0.0, -1.0)),
        # half way: (0.5 - 0.1) / 0.9 = 0.444; 0.6 * 0.444 + 0.4 * 0.444^3 and 0.4 * 0.444 + 0.6 * 0.444^3
        (stick(Y, -16384), Twist(0.30178, 0.0, 0.0)),
        (stick(TURN, 16384), Twist(0.0, 0.0, -0.23045)),
        (stick(X, 3000), ZERO_TWIST),  # within the zone of rest
    ],
)
def test_sticks_go_where_people_expect(event: InputEvent, direction: Twist) -> None:
    found = pad()
    found.hear([event], 0.0)
    assert found.direction == pytest.approx(direction, abs=1e-4)


def test_a_corner_is_no_faster_than_a_side_and_keeps_its_direction() -> None:
    found = pad()
    found.hear([stick(X, 32767), stick(Y, -32768)], 0.0)
    assert hypot(*found.direction[:2]) == pytest.approx(1.0)
    assert found.direction.vx == pytest.approx(-found.direction.vy, rel=1e-3)


def test_the_range_that_the_device_tells_counts() -> None:
    """A pad of 0 to 255, whose middle is 127.5, and one that calls a quarter of it flat."""
    found = pad({X: Axis(128, 0, 255, 0), Y: Axis(0, 0, 255, 0), TURN: Axis(127, 0, 255, 0)})
    assert found.direction == pytest.approx(FORWARD, abs=0.005)  # x rests half a step beside its middle
    wide = pad({X: Axis(128, 0, 255, 0), Y: Axis(100, 0, 255, 32), TURN: Axis(127, 0, 255, 0)})
    assert wide.direction == ZERO_TWIST


def test_the_deadman_counts_from_its_press_to_its_release() -> None:
    found = pad()
    assert found.wish(0.0).press is None
    found.hear([PRESS, SYN, stick(Y, -32768), SYN], 0.0)
    wish = found.wish(0.0)
    assert wish.press == 1
    assert wish.direction == pytest.approx(FORWARD, abs=1e-4)
    assert found.hear([RELEASE], 0.1), "sent at once"
    assert found.wish(0.1).press is None
    found.hear([stick(Y, 0), PRESS], 0.2)
    assert found.wish(0.2).press == 2


def test_pressed_with_a_stick_out_it_does_not_count() -> None:
    """Nor where a trigger, which rests at its end, is called a stick by somebody's driver."""
    for found in (pad(axes(y=-20000)), pad(axes(turn=-32768))):
        found.hear([PRESS], 0.0)
        assert found.wish(0.0).press is None
        assert found.why == "a stick was out when it was pressed"
        found.hear([stick(Y, 0), stick(TURN, 0), SYN], 0.1)
        assert found.wish(0.1).press is None, "it has to be pressed anew"
        found.hear([RELEASE, PRESS], 0.2)
        assert (found.wish(0.2).press, found.why) == (1, "")


@pytest.mark.parametrize(
    "events", [[STOP], [STOP, DROPPED], [DROPPED, STOP]], ids=["alone", "lost behind", "lost before"]
)
def test_a_stop_is_asked_for_once_and_at_once(events: list[InputEvent]) -> None:
    found = pad()
    assert found.hear([*events, InputEvent(codes.EV_KEY, LAYOUT.stop, 0)], 0.0)
    assert found.wish(0.0).stop
    assert not found.wish(0.1).stop


def test_a_pad_that_says_nothing_with_a_stick_out_is_silent() -> None:
    found = pad()
    found.hear([PRESS, stick(Y, -32768)], 0.0)
    assert found.wish(SILENT_S).press == 1
    assert found.wish(SILENT_S + 0.01).press is None
    assert found.why == "the pad has said nothing for 2 s with a stick out"
    found.hear([stick(Y, -32000)], SILENT_S + 0.1)
    assert found.wish(SILENT_S + 0.1).press is None, "it has to be pressed anew"


def test_a_hand_that_rests_on_a_pad_may_do_so() -> None:
    found = pad()
    found.hear([PRESS], 0.0)
    assert found.wish(60.0).press == 1


def test_behind_lost_events_the_deadman_wants_another_press_and_the_sticks_are_as_they_are() -> None:
    found = pad()
    found.hear([PRESS, stick(Y, -32768), DROPPED, PRESS, stick(Y, 0)], 0.0)
    assert found.lost
    assert found.wish(0.0).press is None
    found.catch_up(axes(x=32767))
    assert found.direction == pytest.approx(Twist(0.0, -1.0, 0.0), abs=1e-4)
    found.hear([stick(X, 0), PRESS], 0.1)
    assert found.wish(0.1).press is not None


@pytest.mark.parametrize(
    ("event", "faster"),
    [
        (stick(codes.ABS_HAT0Y, -1), 1),
        (stick(codes.ABS_HAT0Y, 1), -1),
        (stick(codes.ABS_HAT0Y, 0), 0),
        (InputEvent(codes.EV_KEY, codes.BTN_DPAD_UP, 1), 1),
        (InputEvent(codes.EV_KEY, codes.BTN_DPAD_DOWN, 1), -1),
        (InputEvent(codes.EV_KEY, codes.BTN_DPAD_UP, 0), 0),
    ],
)
def test_the_cross_sets_the_scale_as_axis_or_as_buttons(event: InputEvent, faster: int) -> None:
    found = pad()
    found.hear([event, event], 0.0)
    assert found.wish(0.0).faster == 2 * faster
    assert found.wish(0.0) == Wish()


@pytest.mark.parametrize(
    "event",
    [
        *(
            InputEvent(codes.EV_KEY, X, 32767),
            InputEvent(codes.EV_ABS, LAYOUT.stop, 1),
            InputEvent(codes.EV_ABS, LAYOUT.deadman, 1),
        ),
        *(InputEvent(4, X, 32767), InputEvent(4, LAYOUT.stop, 1), InputEvent(4, LAYOUT.deadman, 1)),  # of kind EV_MSC
        *(InputEvent(codes.EV_KEY, LAYOUT.stop, 0), InputEvent(codes.EV_KEY, LAYOUT.deadman, 2), SYN),
    ],
)
def test_what_is_neither_stick_nor_button_is_nothing(event: InputEvent) -> None:
    found = pad()
    assert not found.hear([event], 0.0)
    assert found.wish(0.0) == Wish()
    found.hear([PRESS], 0.0)
    assert not found.hear([event._replace(kind=codes.EV_ABS)], 0.0)
    assert found.wish(0.0).press == 1


def test_only_what_ends_something_is_sent_at_once() -> None:
    found = pad()
    assert not found.hear([], 0.0)
    assert not found.hear([PRESS], 0.0)
    assert not found.hear([stick(Y, -32768)], 0.0)
    assert found.hear([RELEASE, PRESS], 0.0), "another press, also"


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the other library has wheels for x86-64 only")
def test_codes_are_those_of_another_library() -> None:
    ecodes = import_module("evdev").ecodes
    ours = {name: value for name, value in vars(codes).items() if name.startswith(("EV_", "SYN_", "ABS_", "BTN_"))}
    del ours["BTN_LAST"]
    assert len(ours) > 20
    assert ours == {name: ecodes.ecodes[name] for name in ours}
    assert ecodes.BTN_GAMEPAD <= codes.BTN_LAST < ecodes.BTN_DIGI
    assert {number: ecodes.ecodes[f"ABS_{name}"] for number, name in codes.AXIS_NAMES.items()} == {
        number: number for number in codes.AXIS_NAMES
    }


# all of it, whatever comes


class Look(NamedTuple):
    events: list[InputEvent]
    step: float
    ready: bool


EVENTS = st.one_of(
    st.sampled_from([PRESS, PRESS, RELEASE, STOP, SYN, DROPPED, stick(codes.ABS_HAT0Y, -1), stick(codes.ABS_HAT0Y, 1)]),
    st.builds(stick, st.sampled_from([X, Y, TURN]), st.sampled_from([0, 0, -32768, 32767, 9000])),
    st.builds(InputEvent, st.integers(0, 0x1F), st.integers(0, 0x2FF), st.integers(-(2**31), 2**31 - 1)),
)
LOOKS = st.lists(
    st.builds(
        Look,
        st.lists(EVENTS, max_size=6),
        st.sampled_from([0.02, 0.02, 0.02, 0.4, LATE_S + 0.01, SILENT_S + 0.01]),
        st.sampled_from([True, True, True, False]),
    ),
    max_size=40,
)
RANGES = st.tuples(st.integers(-(2**31), 2**31 - 2), st.integers(1, 2**16), st.integers(0, 2**31 - 1))


@given(looks=LOOKS, ranges=st.lists(RANGES, min_size=3, max_size=3))
@example(looks=[Look([], 0.02, True), Look([PRESS, stick(Y, -32768)], 0.02, True)], ranges=[(-32768, 65535, 0)] * 3)
@settings(max_examples=400)
def test_nothing_moves_without_a_press_since_all_that_ends_one(
    looks: list[Look], ranges: list[tuple[int, int, int]]
) -> None:
    """An oracle of its own: of each look it is told from the whole past whether a twist may be sent at all."""
    found = pad(
        {code: Axis(low, low, low + span, flat) for code, (low, span, flat) in zip((X, Y, TURN), ranges, strict=True)}
    )
    hand, now, quiet, may = Hand(TOP), 0.0, 0.0, False
    for number, look in enumerate(looks):
        now += look.step
        quiet = 0.0 if look.events else quiet + look.step
        found.hear(look.events, now)
        if found.lost:
            found.catch_up(dict(found.axes))
        sent = hand.order(found.wish(now), now, ready=look.ready)
        may = allowed(may, look) and number > 0 and quiet <= SILENT_S
        assert may or sent == ZERO_TWIST, look
        assert all(isfinite(part) for part in sent)
        assert hypot(sent.vx, sent.vy) <= TOP.vx * (1.0 + 1e-12)
        assert abs(sent.wz) <= TOP.wz


def allowed(before: bool, look: Look) -> bool:
    """Whether the dead-man is down, by its last press, since the robot is ready and nothing has ended that press."""
    down = before
    for event in look.events:
        if event == DROPPED:
            return False
        if event in {PRESS, RELEASE}:
            down = event == PRESS
    return down and look.ready and STOP not in look.events and look.step <= LATE_S


@given(looks=LOOKS)
def test_a_press_drives_where_nothing_ends_it(looks: list[Look]) -> None:
    """The other way round: whatever was before, at rest and ready a press and a stick drive in the next look."""
    found, hand, now = pad(), Hand(TOP), 0.0
    for look in looks:
        now += look.step
        found.hear(look.events, now)
        if found.lost:
            found.catch_up(axes())
        hand.order(found.wish(now), now, ready=look.ready)
    found.hear([RELEASE, stick(X, 0), stick(Y, 0), stick(TURN, 0), PRESS, stick(Y, -32768)], now + 0.02)
    assert hand.order(found.wish(now + 0.02), now + 0.02, ready=True).vx > 0.0 or not looks
