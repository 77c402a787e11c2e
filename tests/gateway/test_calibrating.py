"""A calibration in virtual time, on simulated ODrives with wheels in the air: it ends well, or lets the motor go."""

from collections.abc import Callable
from math import pi

import pytest

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.setup.calibrating import Calibration, Outcome, Phase
from replay.sim.controllers.odrive import SimulatedODrive
from replay.sim.controllers.odrive_parameters import CALIBRATED, ENABLE_WATCHDOG, WATCHDOG_TIMEOUT
from tests.jogging import MS, Bench
from tests.setup_robots import kiwi

NODE = 5
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
        (Phase.TURNING, lambda device, _: device.unplug(), "is not heard"),
        (Phase.TURNING, lambda device, _: device.raise_error(0x20), "reports DRV_FAULT"),
        (Phase.TURNING, lambda device, _: setattr(device.axis, "calibration_speed", 30.0), "faster than 5 turns/s"),
        (Phase.TURNING, lambda _, procedure: procedure.stop("signal 2"), "signal 2"),
        (Phase.TURNING, lambda device, _: setattr(device.axis, "phase_connected", False), "PHASE_RESISTANCE_OUT_OF_R"),
        (Phase.ASKED, lambda device, _: setattr(device, "receive", lambda *_: ()), "did not begin"),
    ],
    ids=["no cable", "armed", "cable cut", "error", "too fast", "asked", "no motor", "deaf"],
)
def test_whatever_is_not_right_lets_the_motor_go(
    phase: Phase, act: Callable[[SimulatedODrive, Calibration], None], words: str
) -> None:
    tried = Tried(during(phase, act))
    assert not tried.outcome.ok
    assert words in tried.outcome.reason
    assert [frame.data[0] for frame in tried.sent if frame.id & 0x1F == 0x07][-1:] == [1]
    if tried.device.plugged:
        assert tried.state == 1
        assert tried.furthest < 4.0


def test_one_that_is_armed_at_its_end_did_not_end_well() -> None:
    def arm(device: SimulatedODrive, _: Calibration) -> None:
        device.receive = lambda *_: ()  # type: ignore[method-assign]
        device.axis.request(8)

    outcome = Tried(during(Phase.END, arm)).outcome
    assert (outcome, outcome.well) == (Outcome(ok=True, reason="", released=False), False)


def test_too_far_is_the_end() -> None:
    def never(device: SimulatedODrive, now: Phase, _: Calibration) -> None:
        device.axis.calibration_speed = 4.0
        if now is Phase.TURNING:
            device.axis._calibrating_from_ns = device.axis._now_ns  # always at its begin

    tried = Tried(never)
    assert "further than 20 turns" in tried.outcome.reason
    assert (tried.state, tried.furthest < 25.0) == (1, True)
