"""When the angle of a steered joint is believed, and what takes that away."""

import pytest

from gateway.core.joint_trust import JointTrust

HICCUP_NS = 500_000_000
HICCUP_WAY = 0.05  # rad
JOINT, TOP_SPEED = 1, 7.0


def heard(*, absolute: bool, angle: float = 0.3) -> JointTrust:
    """A trusted joint that was last heard at time 0; place 0 is a wheel, which is not steered."""
    trust = JointTrust([JOINT], absolute=[False, absolute], top_speeds=[20.0, TOP_SPEED])
    if not absolute:
        trust.reference(JOINT, angle, angle)
    trust.watch([0.0, angle], [], 0)
    return trust


def silent(*, absolute: bool, moved: float, silence_ns: int) -> bool:
    """Whether it is still trusted when it comes back."""
    trust = heard(absolute=absolute)
    trust.watch([0.0, None], [], 1)
    trust.watch([0.0, 0.3 + moved], [], silence_ns)
    return trust.trusted([0.0, 0.3])[JOINT] is not None


def test_only_an_absolute_encoder_is_believed_from_the_start() -> None:
    for absolute in (True, False):
        trust = JointTrust([JOINT], absolute=[False, absolute], top_speeds=[20.0, TOP_SPEED])
        assert trust.trusted([1.0, 2.0]) == [1.0, 2.0 if absolute else None]


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_incremental_one_is_believed_after_a_hiccup_only(way: float) -> None:
    assert silent(absolute=False, moved=0.99 * way * HICCUP_WAY, silence_ns=HICCUP_NS)
    assert not silent(absolute=False, moved=0.0, silence_ns=HICCUP_NS + 1)
    assert not silent(absolute=False, moved=1.01 * way * HICCUP_WAY, silence_ns=HICCUP_NS)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_absolute_one_may_come_back_as_far_as_it_can_have_turned(way: float) -> None:
    for seconds in (0.1, 10.0):
        bound = HICCUP_WAY + TOP_SPEED * seconds
        assert silent(absolute=True, moved=0.999 * way * bound, silence_ns=round(seconds * 1e9))
        assert not silent(absolute=True, moved=1.001 * way * bound, silence_ns=round(seconds * 1e9))


@pytest.mark.parametrize("absolute", [True, False])
def test_a_jump_takes_trust_and_only_a_reference_gives_it_back(absolute: bool) -> None:
    trust = heard(absolute=absolute)
    trust.watch([0.0, 2.0], [JOINT], 1)
    trust.watch([0.0, 2.0], [], 2)
    assert trust.trusted([0.0, 2.0]) == [0.0, None]
    trust.reference(JOINT, 0.5, 2.0)
    assert trust.trusted(trust.angles([0.0, 2.25])) == [0.0, 0.75]


def test_the_first_angle_after_a_reference_is_compared_with_nothing() -> None:
    trust = heard(absolute=False)
    trust.watch([0.0, None], [], 1)
    trust.reference(JOINT, 3.0, 0.0)
    trust.watch([0.0, 3.0], [], 2 * HICCUP_NS)
    assert trust.trusted([0.0, 3.0]) == [0.0, 3.0]


def test_wheels_are_not_joints() -> None:
    trust = heard(absolute=True)
    trust.watch([100.0, 0.3], [0], 1)
    assert trust.trusted(trust.angles([100.0, 0.3])) == [100.0, 0.3]


def test_a_silent_joint_has_no_angle() -> None:
    trust = heard(absolute=True)
    trust.reference(JOINT, 1.0, 0.0)
    assert trust.angles([None, None]) == [None, None]


def test_only_the_silence_before_this_angle_counts() -> None:
    """Turning on without a pause is no jump, however far and late; nor are two hiccups one silence."""
    trust = heard(absolute=False)
    trust.watch([0.0, 2.0], [], 2 * HICCUP_NS)
    assert trust.trusted([0.0, 2.0]) == [0.0, 2.0]
    for back_ns in (3 * HICCUP_NS, 4 * HICCUP_NS):
        trust.watch([0.0, None], [], back_ns - 1)
        trust.watch([0.0, 2.0], [], back_ns)
        assert trust.unknown == {}
    trust.watch([0.0, 3.0], [], 5 * HICCUP_NS)
    assert trust.unknown == {}


@pytest.mark.parametrize("absolute", [True, False])
def test_at_the_bound_it_is_still_believed(absolute: bool) -> None:
    trust = JointTrust([JOINT], absolute=[False, absolute], top_speeds=[20.0, TOP_SPEED])
    trust.reference(JOINT, 0.0, 0.0)
    trust.watch([0.0, 0.0], [], 0)
    trust.watch([0.0, None], [], 1)
    trust.watch([0.0, HICCUP_WAY], [], 0 if absolute else HICCUP_NS)
    assert trust.unknown == {}
