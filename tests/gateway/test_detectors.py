"""Each detector on hand-made samples: at its stated time, not one cycle before, and never on what is something else."""

from collections.abc import Callable, Iterable
from itertools import repeat

import pytest

from gateway.core.detectors import (
    Detector,
    FollowingDetector,
    FrozenEncoderDetector,
    Limits,
    ReversedDetector,
    RunawayDetector,
    Sample,
    StallDetector,
)

DT = 1 / 256  # s; exact in binary, so that sums of it are
LIMITS = Limits(speed=20.0, torque=10.0)
FULL, SOME = 9.0, 5.0  # N m: at the limit, and with torque to spare
LONG = 1000
FIELDS = ("setpoint", "speed", "position", "torque", "fresh", "driving", "dt", "expected")


def sample(
    *,
    setpoint: float | None = 10.0,
    speed: float | None = 0.0,
    position: float | None = 0.0,
    torque: float | None = SOME,
    fresh: bool = True,
    driving: bool = True,
    dt: float = DT,
    expected: float | None = None,
) -> Sample:
    return Sample(setpoint, speed, position, torque, fresh=fresh, driving=driving, dt=dt, expected=lambda: expected)


def but(x: Sample, **change: object) -> Sample:
    """The same with something else in it."""
    return Sample(**{name: getattr(x, name) for name in FIELDS} | change)


def trips(detector: Detector, samples: Iterable[Sample]) -> int | None:
    """How many samples it takes until the detector is sure; None: all of them are not enough."""
    return next((number for number, x in enumerate(samples, 1) if detector.look(x) is not None), None)


def steady(detector: Callable[[Limits], Detector], x: Sample) -> int | None:
    return trips(detector(LIMITS), repeat(x, LONG))


STALLED = sample(torque=FULL)


@pytest.mark.parametrize(
    ("x", "cycles"),
    [
        (STALLED, 64),  # 0.25 s
        (but(STALLED, torque=-8.0), 64),
        (but(STALLED, setpoint=-10.0), 64),
        (but(STALLED, setpoint=1.0, speed=0.1), 103),  # 0.02 s at top speed are 0.4 rad
        (but(STALLED, torque=None), 128),
        (but(STALLED, setpoint=1.0, torque=None), 205),
        (but(STALLED, speed=1.0), 64),
        (but(STALLED, speed=0.9), 64),
        (but(STALLED, setpoint=0.2), 256),  # by its crawl
        (but(STALLED, torque=7.9), None),
        (but(STALLED, speed=1.01), None),
        (but(STALLED, setpoint=0.19), None),
        (but(STALLED, setpoint=None), None),
        (but(STALLED, speed=None), None),
        (but(STALLED, driving=False), None),
    ],
)
def test_stall(x: Sample, cycles: int | None) -> None:
    assert steady(StallDetector, x) == cycles


def test_a_stall_that_gives_way_counts_anew() -> None:
    assert trips(StallDetector(LIMITS), [*[STALLED] * 63, sample(speed=5.0, torque=FULL), *[STALLED] * 63]) is None


def test_a_stall_is_over_once_nothing_is_asked_any_more() -> None:
    for x, cycles in ((STALLED, 63), (CRAWLING, 255)):
        for pause in (but(x, driving=False), but(x, setpoint=None), but(x, torque=SOME)):
            assert trips(StallDetector(LIMITS), [*[x] * cycles, pause, *[x] * cycles]) is None


def test_the_way_of_a_stall_is_inclusive() -> None:
    """At 50 rad/s the way is 1 rad: 128 cycles of 2 rad/s."""
    assert trips(StallDetector(Limits(50.0, 10.0)), repeat(but(STALLED, setpoint=2.0), LONG)) == 128


@pytest.mark.parametrize(
    ("torque", "text"),
    [
        (FULL, "stands still against 9.0 N m where 10.00 rad/s is commanded"),
        (None, "stands still where 10.00 rad/s is commanded"),
    ],
)
def test_a_stall_in_words(torque: float | None, text: str) -> None:
    detector = StallDetector(LIMITS)
    assert [detector.look(but(STALLED, torque=torque)) for _ in range(128)][-1] == text


CRAWLING = sample(setpoint=0.5, speed=0.9, torque=FULL)


@pytest.mark.parametrize(
    ("x", "cycles"),
    [
        (CRAWLING, 256),  # 1 s
        (but(CRAWLING, speed=-0.9), 256),
        (but(CRAWLING, speed=1.1), None),
        (but(CRAWLING, speed=1.0), None),
        (but(CRAWLING, speed=-1.1), None),
        (but(CRAWLING, torque=SOME), None),
        (but(CRAWLING, torque=None), None),
        (but(CRAWLING, setpoint=0.1), None),
        (but(CRAWLING, setpoint=None), None),
        (but(CRAWLING, driving=False), None),
    ],
)
def test_all_its_torque_and_hardly_any_motion_is_a_stall_after_a_second(x: Sample, cycles: int | None) -> None:
    """Wheels that work against each other, one of them with the wrong sign, do not stand still."""
    assert steady(StallDetector, x) == cycles
    assert trips(StallDetector(LIMITS), [*[x] * 255, sample(speed=5.0, torque=FULL), *[x] * 255]) is None


APART = sample(speed=3.9)


@pytest.mark.parametrize(
    ("x", "cycles"),
    [
        (APART, 128),  # 0.5 s
        (but(APART, torque=None), 128),
        (but(APART, speed=16.1), 128),
        (but(APART, speed=4.1), None),
        (but(APART, speed=4.0), None),
        (but(APART, torque=FULL), None),
        (but(APART, setpoint=None), None),
        (but(APART, speed=None), None),
        (but(APART, driving=False), None),
    ],
)
def test_following(x: Sample, cycles: int | None) -> None:
    assert steady(FollowingDetector, x) == cycles


def test_a_wheel_that_followed_meanwhile_counts_anew() -> None:
    assert trips(FollowingDetector(LIMITS), [*[APART] * 127, sample(speed=5.0), *[APART] * 127]) is None


MOVING = [sample(speed=2.1, position=0.0, driving=False), sample(speed=2.1, position=0.01, driving=False)]
STOPPED = sample(speed=0.0, position=0.01, setpoint=2.0, torque=0.0, driving=False)
STILL = sample(torque=0.0)


@pytest.mark.parametrize(
    ("before", "x", "cycles"),
    [
        (MOVING, STOPPED, 4),  # of the same position: 12 ms, and at least 3
        ([but(x, speed=0.61) for x in MOVING], but(STOPPED, driving=True), 4),
        ([but(x, speed=0.59) for x in MOVING], but(STOPPED, driving=True), None),
        ([but(x, speed=1.99) for x in MOVING], STOPPED, None),
        ([but(x, speed=-2.1) for x in MOVING], STOPPED, 4),
        ([but(x, speed=2.0) for x in MOVING], STOPPED, None),
        ([*MOVING, but(STOPPED, position=0.02)], but(STOPPED, position=0.02), 4),  # frozen a sample before
        ([*[MOVING[0]] * 3, MOVING[1]], but(STOPPED, dt=1 / 64), 3),
        (MOVING, but(STOPPED, dt=0.004), 3),  # 12 ms are enough
        ([STILL], STILL, None),
        ([STILL], but(STILL, torque=3.0), 39),  # 0.15 s
        ([STILL], but(STILL, torque=3.0, dt=0.15), 1),
        ([STILL], but(STILL, torque=3.0, setpoint=-10.0), 39),
        ([STILL], but(STILL, torque=3.0, setpoint=0.2), 39),
        ([STILL], but(STILL, torque=-3.0), 39),
        ([STILL], but(STILL, torque=2.9), None),
        ([STILL], but(STILL, torque=None), None),
        ([STILL], but(STILL, torque=3.0, setpoint=0.19), 77),  # 0.3 s: it is to stand, and its torque winds up
        ([STILL], but(STILL, torque=-0.2, setpoint=0.0), 77),
        ([STILL], but(STILL, torque=0.19, setpoint=0.0), None),
        ([STILL], but(STILL, torque=3.0, setpoint=0.0, driving=False), None),
        ([STILL], but(STILL, torque=3.0, setpoint=0.0, fresh=False), None),
        ([but(STILL, torque=2.0)], but(STILL, torque=2.1, setpoint=0.0), None),  # it holds a slope
        ([but(STILL, torque=None)], but(STILL, torque=3.0, setpoint=0.0), None),
        ([STILL], but(STILL, expected=lambda: -1.0), 13),  # 0.04 s, from the third of the same position on
        ([STILL] * 3, but(STILL, expected=lambda: -1.0, dt=0.04), 1),
        ([STILL], but(STILL, expected=lambda: 0.99), None),
        ([STILL], but(STILL, expected=lambda: 1.0, setpoint=0.0), None),
        ([STILL], but(STILL, torque=3.0, fresh=False), None),
        (MOVING, but(STOPPED, fresh=False), None),
        (MOVING, but(STOPPED, position=None), None),
        (MOVING, but(STOPPED, speed=None), None),
        (MOVING, but(STOPPED, setpoint=None), None),
    ],
)
def test_frozen_encoder(before: list[Sample], x: Sample, cycles: int | None) -> None:
    detector = FrozenEncoderDetector(LIMITS)
    assert trips(detector, before) is None
    assert trips(detector, repeat(x, LONG)) == cycles


@pytest.mark.parametrize(
    ("x", "cycles", "pause"),
    [
        (but(STILL, torque=3.0), 38, but(STILL, position=None)),
        (but(STILL, torque=3.0), 38, STILL),
        (but(STILL, expected=lambda: 1.0), 12, but(STILL, setpoint=0.0)),
        (but(STILL, expected=lambda: 1.0), 12, STILL),
    ],
)
def test_a_doubt_about_an_encoder_that_is_interrupted_counts_anew(x: Sample, cycles: int, pause: Sample) -> None:
    again = 38 if cycles == 38 else 10
    assert trips(FrozenEncoderDetector(LIMITS), [*[x] * cycles, pause, *[x] * again]) is None


def growing(rate: float, *, cycles: int = 40, setpoint: float | None = 2.0, fresh: bool = True) -> list[Sample]:
    """A speed that leaves its setpoint at so many top speeds per second."""
    step = rate * LIMITS.speed * DT
    return [sample(setpoint=setpoint, speed=2.0 + step * cycle, fresh=fresh) for cycle in range(1, cycles)]


def test_runaway() -> None:
    assert trips(RunawayDetector(LIMITS), growing(1.0)) == 14  # the first begins the count; then 0.05 s
    assert trips(RunawayDetector(LIMITS), [but(x, driving=False) for x in growing(1.0)]) == 14
    assert trips(RunawayDetector(LIMITS), growing(0.79, cycles=LONG)) is None
    assert trips(RunawayDetector(LIMITS), growing(1.0, setpoint=None)) is None
    assert trips(RunawayDetector(LIMITS), [but(x, speed=None) for x in growing(1.0)]) is None
    assert trips(RunawayDetector(LIMITS), growing(1.0, fresh=False)) is None


def test_an_impact_or_a_lag_is_no_runaway() -> None:
    impact = [*growing(3.0, cycles=12), *growing(0.0)]
    lag = [sample(setpoint=1.0 + 0.2 * cycle, speed=1.0 + 0.1 * cycle) for cycle in range(100)]
    for samples in (impact, lag):
        assert trips(RunawayDetector(LIMITS), samples) is None


def test_a_setpoint_that_goes_away_is_no_runaway() -> None:
    """It gets faster with its setpoint, a little ahead of it, when an emergency stop takes that away."""
    ahead = speeds(cycles=30, setpoint=(4.0, 0.02), speed=(4.1, 0.021))
    stopped = [sample(setpoint=0.0, speed=4.1 + 0.021 * (30 + cycle)) for cycle in range(4)]
    assert trips(RunawayDetector(LIMITS), [*ahead, *stopped, *growing(0.0)]) is None
    assert trips(RunawayDetector(LIMITS), [*ahead, *speeds(cycles=30, setpoint=(0.0, 0.0), speed=(5.0, 0.1))]) == 58


def mirrored(samples: Iterable[Sample]) -> list[Sample]:
    return [but(x, setpoint=-(x.setpoint or 0.0), speed=-(x.speed or 0.0)) for x in samples]


def speeds(*, cycles: int, setpoint: tuple[float, float], speed: tuple[float, float]) -> list[Sample]:
    """Both from a value, by so much per cycle."""
    (a, by_a), (b, by_b) = setpoint, speed
    return [sample(setpoint=a + by_a * cycle, speed=b + by_b * cycle) for cycle in range(cycles)]


IMPACT = speeds(cycles=12, setpoint=(10.0, 0.0), speed=(13.0, 0.5))


@pytest.mark.parametrize(
    ("samples", "cycles"),
    [
        (growing(1.0), 14),
        (growing(0.9), 16),  # 0.05 of top speed
        (growing(0.79, cycles=LONG), None),
        (speeds(cycles=50, setpoint=(10.0, -0.5), speed=(10.0, -0.1)), None),  # brakes, and lags
        (speeds(cycles=50, setpoint=(10.0, -0.5), speed=(10.0, 0.0)), None),  # has not begun to brake
        ([*speeds(cycles=12, setpoint=(7.0, 0.25), speed=(11.5, 0.125)), *IMPACT], None),  # it catches up, then a push
        ([*speeds(cycles=12, setpoint=(7.0, 0.25), speed=(10.0, 0.25)), *IMPACT], None),
        ([*growing(1.0)[:13], sample(speed=None), *growing(1.0)[13:24]], None),
        ([sample(speed=0.0), *growing(1.0)], 15),
    ],
)
def test_runaway_is_the_same_both_ways(samples: list[Sample], cycles: int | None) -> None:
    assert trips(RunawayDetector(LIMITS), samples) == cycles
    both = [x if x.speed is None else mirrored([x])[0] for x in samples]
    assert trips(RunawayDetector(LIMITS), both) == cycles


def test_time_and_growth_of_a_runaway_are_inclusive() -> None:
    for time, last in ((0.05, 5.0), (0.0625, 4.0)):  # s, rad/s where 2 are commanded
        course = [(3.0, 0.0), (3.125, time), (3.25, 0.0), (3.375, 0.0), (3.5, 0.0), (3.625, 0.0), (last, 0.0)]
        samples = [sample(setpoint=2.0, speed=speed, dt=dt) for speed, dt in course]
        assert trips(RunawayDetector(LIMITS), samples) == 7


def test_a_single_sample_over_much_time_is_no_runaway() -> None:
    samples = [but(x, dt=0.02) for x in growing(6.0, cycles=10)]
    assert trips(RunawayDetector(LIMITS), samples) == 7  # six in a row


def wheels(
    rates: list[float], torques: list[float | None], *, cycles: int = 40, offset: float = 0.0
) -> list[list[Sample]]:
    """Wheels at 10 rad/s, that are to stay there, and change their speeds by so many top speeds per second."""
    gain = LIMITS.speed * DT
    return [
        [
            sample(speed=10.0 + offset + rate * gain * cycle, torque=torque)
            for rate, torque in zip(rates, torques, strict=True)
        ]
        for cycle in range(cycles)
    ]


def blamed(drive: list[list[Sample]]) -> tuple[int, int] | None:
    """Which wheel, and after how many cycles."""
    detector = ReversedDetector([LIMITS] * len(drive[0]))
    answers = ((detector.look(samples), number) for number, samples in enumerate(drive, 1))
    return next(((answer[0], number) for answer, number in answers if answer is not None), None)


def test_the_wheel_that_moves_against_its_torque_is_reversed() -> None:
    all_well = [SOME] * 3
    # 0.05 s are 13 periods.
    assert blamed(wheels([-1.0, -0.2, 0.0, 0.0], [FULL, *all_well])) == (0, 13)
    assert blamed(wheels([0.2, 0.0, 1.0, 0.0], [-SOME, SOME, -FULL, SOME])) == (2, 13)
    assert blamed(wheels([-1.0, -0.2, 0.0, 0.0], [7.9, *all_well])) is None, "it has torque to spare"
    assert blamed(wheels([1.0, 0.2, 0.0, 0.0], [FULL, *all_well])) is None, "it moves with its torque"
    assert blamed(wheels([-1.0, -1.0, 0.0, 0.0], [FULL, FULL, SOME, SOME])) is None, "two wheels: something pushes"
    assert blamed(wheels([-1.0, -0.2, 0.0, 0.0], [FULL, FULL, SOME, SOME])) is None, "another strained as long"
    assert blamed(wheels([-1.0, -0.2, 0.0, 0.0], [FULL, SOME, SOME, None])) is None, "not all of them are known"
    # Within the time of one strain, 0.15 s, it was 4 % of top speed off: 0.8 rad/s, after 0.16 s at this rate.
    assert blamed(wheels([-0.25, 0.0, 0.0, 0.0], [FULL, *all_well])) is None
    assert blamed(wheels([-1.0, -0.2, 0.0, 0.0], [FULL, *all_well], cycles=10)) is None, "an impact is over by then"
    assert blamed(wheels([-1.0, -0.6, 0.0, 0.0], [FULL, 7.9, SOME, SOME])) is None, "another goes half as far back"
    assert blamed(wheels([-1.0, -0.5, 0.0, 0.0], [FULL, 7.9, SOME, SOME])) == (0, 13)


def test_a_wheel_that_strained_before_or_in_between_gave_way_is_not_reversed() -> None:
    against = wheels([-1.0, -0.2, 0.0, 0.0], [FULL, SOME, SOME, SOME])
    stalled = wheels([0.0, 0.0, 0.0, 0.0], [FULL, SOME, SOME, SOME], cycles=32)
    assert blamed([*stalled, *against]) is None, "an overload"
    assert blamed([*stalled[:16], *against]) == (0, 16 + 12), "so short a strain is no overload"
    recovered = [samples[:1] + samples[1:] for samples in against]
    recovered[8] = [but(against[8][0], speed=against[7][0].speed), *against[8][1:]]  # a standing reading is none
    assert blamed(recovered) == (0, 13)
    recovered[8] = [but(against[8][0], speed=against[6][0].speed), *against[8][1:]]
    assert blamed(recovered) == (0, 9 + 13)


@pytest.mark.parametrize(
    "change",
    [
        lambda x: but(x, driving=False),
        lambda x: but(x, setpoint=None),
        lambda x: but(x, speed=None),
        lambda x: but(x, torque=None),
        lambda x: but(x, fresh=False),
    ],
)
def test_a_wheel_that_is_not_driven_or_not_known_is_not_reversed(change: Callable[[Sample], Sample]) -> None:
    drive = wheels([-1.0, -0.2, 0.0, 0.0], [FULL, SOME, SOME, SOME])
    assert blamed([[change(one) for one in samples] for samples in drive]) is None
