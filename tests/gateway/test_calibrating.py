"""A calibration in virtual time, on simulated ODrives with wheels in the air: it ends well, or lets the motor go."""

from collections.abc import Callable
from math import nan, pi
from struct import pack

import pytest

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.setup.calibrating import Calibration, Outcome, Phase
from replay.sim.controllers.odrive import SimulatedODrive
from replay.sim.controllers.odrive_parameters import CALIBRATED, ENABLE_WATCHDOG, WATCHDOG_TIMEOUT
from tests.jogging import MS, Bench
from tests.setup_robots import kiwi

NODE = 5
HEARTBEAT, ESTIMATES = 0x01, 0x09
LONGEST_NS = 70_000 * MS
Disturb = Callable[[SimulatedODrive, Phase, Calibration], None]


class Tried:
    """One calibration to its end. `furthest`: turns of the rotor away from its start."""

    def __init__(self, disturb: Disturb = lambda *_: None) -> None:
        bench = Bench(parse(kiwi(), "kiwi"))
        bench.wait(0.3)
        device = bench.bus.robot.devices["front"]
        assert isinstance(device, SimulatedODrive)
        device.axis.parameters.put(dict.fromkeys(CALIBRATED, 0.0))
        self.device = device
        self.bench = bench
        self.sent: list[CanFrame] = []
        self.furthest = 0.0
        procedure = Calibration("can0", NODE)
        begun_ns = bench.now_ns
        while not procedure.finished:
            assert bench.now_ns - begun_ns < LONGEST_NS
            disturb(device, procedure.phase, procedure)
            frames = procedure.step(bench.cycle(), bench.now_ns)
            self.sent += frames
            bench.send(frames)
            self.furthest = max(self.furthest, abs(bench.bus.robot.truth.joint_angles[0]) * 5.0 / (2.0 * pi))
        assert procedure.outcome is not None
        self.outcome: Outcome = procedure.outcome
        bench.wait(0.2)

    @property
    def state(self) -> int:
        return self.device.axis.state


def during(phase: Phase, act: Callable[[SimulatedODrive, Calibration], None]) -> Disturb:
    """Once, at the first cycle of this phase."""
    done: list[bool] = []

    def disturb(device: SimulatedODrive, now: Phase, procedure: Calibration) -> None:
        if now is phase and not done:
            done.append(True)
            act(device, procedure)

    return disturb


def without(command: int, device: SimulatedODrive) -> None:
    """This cyclic message comes no more; all others do."""
    device._clocks = tuple((one, clock) for one, clock in device._clocks if one != command)


def armed(device: SimulatedODrive) -> None:
    device.axis.parameters.put(dict.fromkeys(CALIBRATED, 1.0))
    device.axis.request(8)


def test_it_ends_calibrated_and_released() -> None:
    tried = Tried()
    assert tried.outcome == Outcome(ok=True, reason="", released=True)
    assert tried.outcome.well
    assert all(tried.device.axis.parameters[name] for name in CALIBRATED)
    assert tried.furthest > 0.1


def test_its_watchdog_is_fed_meanwhile() -> None:
    def guard(device: SimulatedODrive, _: Calibration) -> None:
        device.axis.parameters.put({ENABLE_WATCHDOG: 1.0, WATCHDOG_TIMEOUT: 0.05})
        device._firmware = device._firmware._replace(watchdog_when_idle=True)
        device.axis._firmware = device._firmware

    assert Tried(during(Phase.ASKED, guard)).outcome.ok


@pytest.mark.parametrize(
    ("phase", "act", "words"),
    [
        (Phase.LISTEN, lambda device, _: device.unplug(), "is not heard"),
        (Phase.LISTEN, lambda device, _: armed(device), "it is not idle"),
        (Phase.ASKED, lambda device, _: device.unplug(), "is not heard"),
        (Phase.TURNING, lambda device, _: device.unplug(), "is not heard"),
        (Phase.TURNING, lambda device, _: without(HEARTBEAT, device), "is not heard"),
        (Phase.TURNING, lambda device, _: without(ESTIMATES, device), "is not heard"),
        (Phase.TURNING, lambda device, _: device.raise_error(0x20), "reports DRV_FAULT"),
        (Phase.TURNING, lambda device, _: setattr(device.axis, "calibration_speed", 30.0), "faster than 5 turns/s"),
        (Phase.TURNING, lambda _, procedure: procedure.stop("signal 2"), "signal 2"),
        (Phase.TURNING, lambda device, _: setattr(device.axis, "phase_connected", False), "PHASE_RESISTANCE_OUT_OF_R"),
        (Phase.ASKED, lambda device, _: setattr(device, "receive", lambda *_: ()), "did not begin"),
    ],
    ids=[
        *("no cable", "armed", "cable cut at its begin", "cable cut", "no heartbeat", "no estimate"),
        *("error", "too fast", "asked", "no motor", "deaf"),
    ],
)
def test_whatever_is_not_right_lets_the_motor_go(
    phase: Phase, act: Callable[[SimulatedODrive, Calibration], None], words: str
) -> None:
    tried = Tried(during(phase, act))
    assert not tried.outcome.ok
    assert words in tried.outcome.reason
    assert [frame.data[0] for frame in tried.sent if frame.id & 0x1F == 0x07][-1:] == [1]
    heard = tried.device.plugged and any(command == HEARTBEAT for command, _ in tried.device._clocks)
    assert tried.outcome.released is heard  # what it told last may be over
    if tried.device.plugged:
        assert tried.state == 1
        assert tried.furthest < 4.0


def test_one_that_is_armed_at_its_end_did_not_end_well() -> None:
    def arm(device: SimulatedODrive, _: Calibration) -> None:
        device.receive = lambda *_: ()  # type: ignore[method-assign]
        device.axis.request(8)

    outcome = Tried(during(Phase.END, arm)).outcome
    assert (outcome, outcome.well) == (Outcome(ok=True, reason="", released=False), False)


def endless(speed: float) -> Disturb:
    """Turns/s, always at its begin."""

    def disturb(device: SimulatedODrive, now: Phase, _: Calibration) -> None:
        device.axis.calibration_speed = speed
        if now is Phase.TURNING:
            device.axis._calibrating_from_ns = device.axis._now_ns

    return disturb


def test_too_far_is_the_end() -> None:
    tried = Tried(endless(4.0))
    assert "further than 20 turns" in tried.outcome.reason
    assert (tried.state, tried.furthest < 25.0) == (1, True)


def test_too_long_is_the_end() -> None:
    tried = Tried(endless(0.1))
    assert "longer than 60 s" in tried.outcome.reason
    assert (tried.state, tried.furthest < 7.0) == (1, True)


def test_what_is_over_is_no_error() -> None:
    assert Tried(during(Phase.LISTEN, lambda device, _: device.raise_error(0x20))).outcome.ok


def tells(device: SimulatedODrive, *speeds: float) -> None:
    """These next, turns/s, instead of the true ones."""
    told, true = list(speeds), device._reports[ESTIMATES]
    device._reports[ESTIMATES] = lambda: pack("<ff", 0.0, told.pop(0)) if told else true()


@pytest.mark.parametrize(
    ("speeds", "ok"),
    [((30.0, 30.0), True), ((-30.0, 30.0, 0.0, 30.0), True), ((30.0, 30.0, -30.0), False)],
)
def test_fast_once_or_twice_may_be_its_encoder_being_found(speeds: tuple[float, ...], ok: bool) -> None:
    assert Tried(during(Phase.TURNING, lambda device, _: tells(device, *speeds))).outcome.ok is ok


def test_no_speed_at_all_hides_no_way() -> None:
    """It tells none while its encoder is being found."""
    turning, nothing = endless(4.0), during(Phase.TURNING, lambda device, _: tells(device, nan))

    def disturb(device: SimulatedODrive, now: Phase, procedure: Calibration) -> None:
        turning(device, now, procedure)
        nothing(device, now, procedure)

    assert "further than 20 turns" in Tried(disturb).outcome.reason
