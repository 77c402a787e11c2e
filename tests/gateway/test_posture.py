"""How a robot that balances stands: each request, each time and each lean to its last step."""

from itertools import count

import pytest

from gateway.control.posture import BLIND_NS, FALLING_NS, LOWERING_NS, READY_NS, STUCK_NS, Posture, Stance
from gateway.types import Attitude

PITCH = pytest.mark.parametrize("way", [1.0, -1.0])


_swayed = count()


def leaning(pitch: float = 0.0) -> Attitude:
    """Never the very same twice: a body that balances sways."""
    return Attitude(0.0, pitch, pitch_rate=1e-6 * next(_swayed))


def ready() -> Posture:
    posture = Posture(catch=0.1, fall=0.5)
    posture.look(leaning(), 0)
    assert posture.stand_up() is None
    return posture


def up() -> Posture:
    posture = ready()
    posture.rise()
    return posture


def test_it_begins_down() -> None:
    posture = Posture(catch=0.1, fall=0.5)
    posture.look(leaning(), 0)
    assert (posture.stance, posture.stands) == (Stance.DOWN, False)
    assert posture.objection() == "it is down: hold it upright and ask it to stand up"
    assert posture.let_down() == "it does not stand"


def test_ready_is_forgotten() -> None:
    posture = ready()
    posture.look(leaning(), READY_NS)
    assert posture.objection() is None
    posture.look(leaning(), READY_NS + 1)
    assert posture.stance is Stance.DOWN


@PITCH
def test_it_comes_up_from_what_it_can_catch_alone(way: float) -> None:
    posture = Posture(catch=0.1, fall=0.5)
    posture.look(leaning(way * 0.101), 0)
    assert "must be from -0.1 to 0.1" in (posture.stand_up() or "")
    posture.look(leaning(way * 0.1), 1)
    assert posture.stand_up() is None
    posture.look(leaning(way * 0.101), 2)
    assert "hold it upright: pitch" in (posture.objection() or "")


@PITCH
def test_it_falls_beyond_its_limit(way: float) -> None:
    posture = up()
    posture.look(leaning(way * 0.5), 1)
    assert (posture.stance, posture.fallen) == (Stance.UP, None)
    posture.look(leaning(way * 0.501), 2)
    assert posture.stance is Stance.DOWN
    assert "must be from -0.5 to 0.5" in (posture.fallen or "")
    posture.look(leaning(), 1 + FALLING_NS)
    posture.lies()
    assert posture.fallen is not None
    posture.look(leaning(), 2 + FALLING_NS)
    posture.lies()
    assert not posture.fallen


@pytest.mark.parametrize("told", [None, Attitude(0.0, 0.0)])
def test_it_falls_when_nobody_knows_how_it_leans(told: Attitude | None) -> None:
    posture = up()
    last = leaning(0.02)
    posture.look(last, 5)
    posture.look(told, 5 + BLIND_NS)
    assert (posture.stance, posture.attitude) == (Stance.UP, last)
    posture.look(told, 6 + BLIND_NS)
    assert (posture.stance, posture.fallen) == (Stance.DOWN, "how it leans is not known any more")


def test_a_sensor_that_tells_the_very_same_for_long_tells_nothing() -> None:
    posture, same = up(), leaning(0.02)
    for now_ns in range(0, STUCK_NS + 1, 4_000_000):
        posture.look(same, now_ns)
    assert posture.stance is Stance.UP
    for now_ns in range(STUCK_NS + 4_000_000, STUCK_NS + BLIND_NS + 8_000_000, 4_000_000):
        posture.look(same, now_ns)
    assert posture.fallen == "how it leans is not known any more"


def test_on_its_stand_it_may_tell_the_same_for_ever() -> None:
    posture, same = ready(), leaning(0.02)
    for now_ns in (0, STUCK_NS, 2 * STUCK_NS):
        posture.look(same, now_ns)
    assert posture.objection() is None


def test_let_down_it_gives_way_within_its_time() -> None:
    posture = up()
    posture.look(leaning(), 7)
    assert (posture.strength, posture.let_down()) == (1.0, None)
    posture.look(leaning(), 7 + LOWERING_NS // 4)
    assert posture.strength == pytest.approx(0.75)
    assert posture.let_down() is None, "asked again it goes on"
    posture.look(leaning(), 7 + LOWERING_NS // 2)
    assert posture.strength == pytest.approx(0.5)
    posture.look(leaning(), 7 + LOWERING_NS)
    assert posture.stance is Stance.DOWN


def test_it_is_not_asked_twice() -> None:
    assert up().stand_up() == "it stands"
