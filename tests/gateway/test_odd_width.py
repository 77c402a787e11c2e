"""Where the width is known from with a sensor of it, what is told, and what happens when it fails; in figures."""

from math import inf
from typing import NamedTuple

import pytest

from gateway.config import parse
from gateway.control.odd_width import BLIND_WAY, GATE, WidthEstimate
from gateway.core.reporter import GREETING_NS
from gateway.types import ZERO_TWIST, Event, Mode, Outputs, Status, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.plants.odd import OddPlant
from replay.sim.sensors.sender import Sender
from tests.gateway.test_snapshot import goes_on_byte_for_byte
from tests.world import robot_text

DT = 0.004
TURNING = Twist(0.3, 0.0, 0.2)
MM = 1e-3


def estimate(metres: float = 0.4, *, sensed: bool = True) -> WidthEstimate:
    return WidthEstimate(metres, narrowest=0.25, widest=0.6, gate=GATE + 0.016, sensed=sensed)


def known(metres: float = 0.4) -> WidthEstimate:
    """By its sensor, and driving."""
    one = estimate()
    told(one, metres, seconds=0.3)
    assert one.by == "sensor"
    one.drive()
    return one


def why(one: WidthEstimate) -> str | None:
    return one.unready


def told(one: WidthEstimate, metres: float | None, *, seconds: float, rate: float = 0.0) -> list[str]:
    """The codes of what it says."""
    events = [event for _ in range(round(seconds / DT)) for event in one.measure(rate, metres, DT)]
    return [event.code for event in events]


# one piece


def test_it_is_unknown_until_the_sensor_has_told_the_same_for_a_while() -> None:
    one = estimate(0.3)
    assert one.by == "unknown"
    assert why(one) == "the width is not known: its sensor is silent"
    assert told(one, 0.5, seconds=0.19) == []
    assert why(one) == "the width is not known: its sensor does not stand still yet"
    assert told(one, 0.5, seconds=0.02) == ["width_sensed"]
    assert (one.metres, why(one), one.freedom) == (0.5, None, (1.0, 0.0))


@pytest.mark.parametrize(("metres", "taken"), [(0.245, 0.25), (0.605, 0.6), (0.239, None), (0.611, None)])
def test_what_is_no_width_is_not_taken(metres: float, taken: float | None) -> None:
    one = estimate(0.3)
    told(one, metres, seconds=1.0)
    if taken is None:
        assert one.unready == f"the width is not known: its sensor tells {metres:.3f} m, must be from 0.25 to 0.6 m"
    else:
        assert (one.unready, one.metres) == (None, taken)


def test_wheels_that_turn_or_a_sensor_that_moves_are_not_at_rest() -> None:
    turning, moving = estimate(), estimate()
    told(turning, 0.5, seconds=1.0, rate=0.01)
    for place in range(250):
        moving.measure(0.0, 0.4 + 0.0002 * place, DT)
    assert turning.unready is not None
    assert moving.unready is not None


def test_the_sensor_draws_it_and_noise_of_it_does_little() -> None:
    one = known(0.4)
    told(one, 0.41, seconds=DT)
    assert one.metres == pytest.approx(0.4005)
    told(one, 0.41, seconds=0.5)
    assert one.metres == pytest.approx(0.41, abs=0.02 * MM)


def test_a_silent_sensor_leaves_it_to_the_wheels_for_a_way_and_with_a_growing_margin() -> None:
    one = known(0.3)
    assert told(one, None, seconds=DT, rate=0.1) == ["width_by_wheels"]
    assert one.freedom.share == 0.5
    assert told(one, None, seconds=1.0, rate=0.1) == []
    assert one.metres == pytest.approx(0.3 + 0.1004)
    assert one.freedom.margin == pytest.approx(0.0111, abs=1e-4), "a tenth of the way, and 1 mm/s"
    assert told(one, None, seconds=1.1, rate=0.1) == ["width_held"]
    assert one.freedom.share == 0.0
    assert told(one, one.metres + 0.03, seconds=DT) == ["width_sensed"]
    assert one.freedom == (1.0, 0.0)


def test_after_a_bus_that_was_away_the_sensor_is_believed_wherever_the_wheels_went() -> None:
    one = known(0.4)
    for _ in range(75):
        one.measure(None, None, DT)
    assert one.freedom.share == 0.5
    assert one.freedom.margin == pytest.approx(0.3)
    assert told(one, 0.6, seconds=DT) == ["width_sensed"]
    assert one.metres == pytest.approx(0.41), "drawn there, without a step"
    assert told(one, 0.6, seconds=0.5) == []
    assert (one.by, one.freedom) == ("sensor", (1.0, 0.0))
    assert one.metres == pytest.approx(0.6, abs=1 * MM)


def test_short_silences_do_not_add_up() -> None:
    one = known(0.3)
    for _ in range(10):
        for rate in (0.1, -0.1):
            assert "width_held" not in told(one, None, seconds=1.5, rate=rate)
            told(one, one.metres, seconds=DT)
            assert one.by == "sensor"


def test_and_no_longer_than_ten_seconds() -> None:
    one = known()
    assert told(one, None, seconds=9.9) == ["width_by_wheels"]
    assert told(one, None, seconds=0.2) == ["width_held"]


@pytest.mark.parametrize("jump", [0.04, -0.04, 0.2, inf])
def test_a_jump_is_not_believed_and_what_comes_back_is(jump: float) -> None:
    one = known(0.4)
    assert told(one, 0.4 + jump, seconds=0.5) == ["width_by_wheels"]
    assert one.metres == 0.4
    assert told(one, 0.4, seconds=DT) == ["width_sensed"]


def test_a_jump_is_what_the_sensor_tells_once_the_robot_was_let_go_and_rests() -> None:
    one = known(0.4)
    told(one, 0.5, seconds=1.0)
    assert one.metres == 0.4
    one.release()
    assert why(one) == "the width is not known: its sensor jumped"
    assert told(one, 0.5, seconds=0.3) == ["width_sensed"]
    assert (one.metres, why(one)) == (0.5, None)


def test_a_slide_that_is_stuck_or_a_wire_that_is_caught_is_a_dispute() -> None:
    """The wheels go on and the sensor does not: 5 cm later neither is believed enough to go on."""
    one = known(0.3)
    assert told(one, 0.3, seconds=0.25, rate=0.2) == []
    assert told(one, 0.3, seconds=0.05, rate=0.2) == ["width_disputed"]
    assert one.freedom.share == 0.0
    assert one.metres == pytest.approx(0.315, abs=2 * MM), "that of the sensor, and what it is behind by"
    assert told(one, 0.3, seconds=60.0) == [], "time alone does not end it"
    assert told(one, 0.3, seconds=0.1, rate=-0.1) == [], "nor do a few mm"
    assert told(one, 0.3, seconds=0.3, rate=-0.2) == ["width_sensed"], "they agree again"


def test_wheels_that_slip_by_a_tenth_are_no_dispute() -> None:
    one = known(0.3)
    metres = 0.3
    for direction in (1.0, -1.0) * 5:
        for _ in range(375):
            metres += direction * 0.18 * DT
            assert [event.code for event in one.measure(direction * 0.2, metres, DT)] == []
    assert one.metres == pytest.approx(metres, abs=2 * MM)


def test_a_slip_that_is_always_the_same_way_is_forgotten_over_the_way() -> None:
    """A centimetre in each round of 20, eight times."""
    one = known(0.5)
    metres = 0.5
    for rate, share in ((0.1, 0.9), (-0.1, 1.0)) * 8:
        for _ in range(250):
            metres += rate * share * DT
            assert one.measure(rate, metres, DT) == ()
    assert metres == pytest.approx(0.42)


def test_without_a_sensor_nothing_is_doubted() -> None:
    one = estimate(sensed=False)
    assert told(one, None, seconds=20.0, rate=0.01) == []
    assert (one.by, one.unready, one.freedom) == ("robot file and wheels", None, (1.0, 0.0))
    assert one.metres == pytest.approx(0.6)


# through the whole core, on wheels


class Seen(NamedTuple):
    most: float  # of the true width, m
    least: float
    fastest: float  # of its rate, m/s


class Drive:
    """The bundled robot on its plant, at this true width; the robot file says 0.4."""

    def __init__(self, width: float = 0.4) -> None:
        config = parse(robot_text("odd"), "odd")
        plant = OddPlant(config.robot)  # type: ignore[arg-type]
        plant.width = width
        self.plant, self.loop = plant, ClosedLoop(config, plant=plant)
        self.events: list[Event] = []
        self.records: list[tuple[object, Outputs]] = []

    @property
    def wire(self) -> Sender:
        return self.loop.bus.robot.sensors["wire"]

    def is_in(self, mode: Mode) -> bool:
        return self.loop.engine.mode is mode

    @property
    def codes(self) -> list[str]:
        return [event.code for event in self.events if event.code.startswith("width")]

    @property
    def status(self) -> Status:
        return next(outputs.status for _, outputs in reversed(self.records) if outputs.status)

    def run(
        self, seconds: float, twist: Twist | None = None, *, width: float | None = None, rate: float | None = None
    ) -> Seen:
        widths, rates = [], []
        for index in range(round(seconds / DT)):
            commands = []
            if twist is not None and index % 5 == 0:
                command = TwistCommand("teleop", twist, TwistFrame.BODY, None, self.loop.next_ns, "test")
                commands = [command._replace(width=width, width_rate=rate)]
            record = self.loop.cycle(commands=commands)
            self.records.append(record)
            self.events += record[1].events
            widths.append(self.plant.width)
            rates.append(abs(self.plant.width_rate))
        return Seen(max(widths), min(widths), max(rates))

    def start(self) -> "Drive":
        self.run(1.0, ZERO_TWIST)
        assert self.is_in(Mode.DRIVE)
        return self


def test_it_starts_at_the_width_that_the_sensor_tells() -> None:
    drive = Drive(0.52).start()
    assert drive.status.chassis["width"] == pytest.approx(0.52, abs=0.2 * MM)
    assert drive.codes == ["width_sensed"]


def test_nothing_arms_before_the_sensor_has_told() -> None:
    drive = Drive()
    drive.wire.unplug()
    drive.run(2.0 + GREETING_NS * 1e-9, ZERO_TWIST)
    assert drive.is_in(Mode.IDLE)
    assert drive.status.reason == "the width is not known: its sensor is silent"
    drive.wire.plug()
    drive.run(0.5, ZERO_TWIST)
    assert drive.is_in(Mode.DRIVE), "a zero is still commanded"


def test_a_width_is_gone_to_and_kept_while_it_drives_and_turns() -> None:
    """15 cm: within 1 mm after 2.5 s, without going beyond, and kept within 0.3 mm."""
    drive = Drive(0.5).start()
    assert drive.run(2.5, TURNING, width=0.35).least > 0.35 - 0.3 * MM
    held = drive.run(2.0, TURNING, width=0.35)
    assert 0.35 - 0.3 * MM < held.least <= held.most < 0.351
    assert drive.plant.twist.vx == pytest.approx(0.3, abs=0.01)
    assert drive.plant.twist.wz == pytest.approx(0.2, abs=0.01)
    back = drive.run(4.0, TURNING, width=0.6)
    assert 0.598 < back.most <= 0.6, "also to the end of its range"
    assert back.fastest < 0.21


def test_a_width_that_is_no_longer_asked_for_is_left() -> None:
    drive = Drive(0.5).start()
    drive.run(0.8, TURNING, width=0.35)
    drive.run(0.5, TURNING)
    stopped = drive.run(1.0, TURNING)
    assert stopped.most - stopped.least < 1 * MM
    assert stopped.least > 0.36


@pytest.mark.parametrize("width", [0.2499, 0.6001, 0.0, 5.0])
def test_a_width_beyond_the_range_is_refused_with_the_range(width: float) -> None:
    drive = Drive().start()
    drive.run(0.3, TURNING, width=width)
    texts = [event.text for event in drive.events if event.code == "refused_unsupported"]
    assert texts == [f"teleop: width = {width:g}: must be from 0.25 to 0.6 m on this robot"]


def test_a_silent_wire_leaves_half_the_rate_a_way_and_a_margin() -> None:
    """From 0.35 m at 0.2 m/s outward: 0.1 m/s for 0.2 m, then held; told each time."""
    drive = Drive(0.35).start()
    drive.wire.unplug()
    seen = drive.run(5.0, TURNING, rate=0.2)
    assert drive.codes == ["width_sensed", "width_by_wheels", "width_held"]
    assert 0.35 + BLIND_WAY < seen.most < 0.35 + BLIND_WAY + 0.03
    assert drive.is_in(Mode.DRIVE)
    assert drive.plant.twist.vx == pytest.approx(0.3, abs=0.01), "the motion goes on"
    assert drive.status.chassis["width"] == pytest.approx(drive.plant.width, abs=1 * MM)
    assert drive.status.chassis["width_by"] == "wheels, held"
    drive.wire.plug()
    drive.run(2.0, TURNING, rate=0.2)
    assert drive.codes[-1] == "width_sensed"
    assert drive.plant.width == pytest.approx(0.6, abs=3 * MM)


def test_a_silent_wire_keeps_away_from_the_end() -> None:
    """From 0.5 m outward: it ends 1 to 2 cm before the end."""
    drive = Drive(0.5).start()
    drive.wire.unplug()
    assert 0.575 < drive.run(4.0, TURNING, rate=0.2).most < 0.592


@pytest.mark.parametrize("jump", [0.1, -0.1, 1.0])
def test_a_wire_that_jumps_moves_nothing(jump: float) -> None:
    drive = Drive(0.4).start()
    drive.wire.shift("range", jump)
    seen = drive.run(2.0, TURNING)
    assert seen.most - seen.least < 1 * MM
    assert drive.plant.twist.wz == pytest.approx(0.2, abs=0.01)
    assert drive.codes[-1] == "width_by_wheels"


def test_a_wire_that_is_caught_ends_the_change_of_width_within_12_cm() -> None:
    """At full rate: a quarter of a second until it is seen, and the way to stop."""
    drive = Drive(0.3).start()
    drive.wire.stick(True)
    seen = drive.run(4.0, TURNING, rate=0.2)
    assert drive.codes[-1] == "width_disputed"
    assert seen.most - 0.3 < 0.125
    assert drive.is_in(Mode.DRIVE)
    assert drive.status.chassis["width_by"] == "sensor, held"


def test_a_sender_that_hangs_is_as_good_as_a_silent_one() -> None:
    drive = Drive(0.35).start()
    drive.wire.hang(True)
    drive.run(1.0, TURNING, rate=0.1)
    assert drive.codes[-1] == "width_by_wheels"
    assert "wire: its counter stands still" in [event.text for event in drive.events]


@pytest.mark.parametrize("width_rate", [0.0, 0.1])
def test_the_odometry_tells_what_errs_more(width_rate: float) -> None:
    """0.6 m along each axis, the heading by the wheels: to the side, and while the width changes, it is less sure."""

    def grown(twist: Twist, rate: float) -> tuple[float, float]:
        drive = Drive(0.3).start()
        drive.loop.bus.robot.sensors["gyro"].unplug()
        drive.run(2.3, twist, rate=rate)
        told = next(outputs.odometry for _, outputs in reversed(drive.records) if outputs.odometry)
        return told.covariance[0] + told.covariance[4], told.covariance[8]

    forward, turned = grown(Twist(0.3, 0.0, 0.0), 0.0)
    other, other_turned = grown(Twist(0.3, 0.0, 0.0) if width_rate else Twist(0.0, 0.3, 0.0), width_rate)
    assert other > 1.15 * forward
    assert other_turned > 1.8 * turned


def test_all_of_it_is_in_the_snapshot() -> None:
    drive = Drive(0.5)
    drive.run(0.6, ZERO_TWIST)
    drive.run(0.2, TURNING, width=0.35)
    drive.wire.unplug()
    drive.run(0.3, TURNING, width=0.35)
    assert goes_on_byte_for_byte(drive.records, drive.loop.config, every=5) > 40  # type: ignore[arg-type]
