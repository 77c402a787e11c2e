"""All motors behind one face, with drivers that only take notes: who hears, who is asked, and what is measured."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.contract import CanFrame, DriverFault, MotorFeedback, MotorState
from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from gateway.config import parse
from gateway.control import drive_law
from gateway.control.drive_law import JointCommand, Measured
from gateway.control.speed_loop import SpeedLoop
from gateway.control.transmission import Transmission, Winding
from gateway.core.assembly import Group, build
from gateway.core.detectors import Limits
from gateway.core.motors import Motors
from tests.world import robot_text

SILENT = MotorFeedback(MotorState.SILENT)
MEASURED = MotorFeedback(MotorState.OPERATIONAL, 3.0, 8.0, 0.5, age_ns=4_000_000)


@dataclass
class Notes:
    """A driver."""

    ids: set[int]
    motors: list[MotorFeedback]
    heard: list[int] = field(default_factory=list)
    commands: list[MotorCommand] = field(default_factory=list)
    cleared: int = 0

    def receive(self, frame: CanFrame) -> bool:
        self.heard.append(frame.id)
        return frame.id in self.ids

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        return self.motors

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        self.commands = list(commands)
        return [CanFrame("can", min(self.ids), b"command")]

    def clear_faults(self) -> None:
        self.cleared += 1

    def coast_frames(self) -> list[CanFrame]:
        return [CanFrame("can", min(self.ids), b"coast")]

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        return [CanFrame("can", min(self.ids), b"stop", received_ns=now_ns)]


def robot(winding: Winding | None = None) -> tuple[Motors, list[Notes]]:
    """Motors a, b and c of 20 rad/s and 10 N m: a and c on can0 have a driver each, b on can1 a loop on the host.

    `winding`: of b, which is then told voltages.
    """
    drivers: list[Any] = [Notes({1}, [SILENT]), Notes({1, 2}, [SILENT]), Notes({1, 3}, [SILENT])]
    built = build(parse(robot_text("omni4"), "omni4"))._replace(
        names=("a", "b", "c"),
        groups=(Group("can0", drivers[0], (0,)), Group("can0", drivers[1], (2,)), Group("can1", drivers[2], (1,))),
        transmissions=(Transmission(-4.0, 0.25), Transmission(2.0, 0.0, winding), Transmission(1.0, 0.0)),
        speed_loops=(None, SpeedLoop(kp=1.0, ki=10.0, max_torque=10.0), None),
        limits=(Limits(20.0, 10.0),) * 3,
    )
    return Motors(built), drivers


def measured(
    speeds: Sequence[float | None] = (None,) * 3, torques: Sequence[float | None] = (None,) * 3, *, dt: float = 0.1
) -> Measured:
    return Measured(0, dt, tuple(speeds), (None,) * 3, tuple(torques), (None,) * 3)


def test_a_frame_goes_to_the_first_driver_of_its_bus_that_takes_it() -> None:
    motors, drivers = robot()
    motors.receive([CanFrame(bus, id, b"") for bus, id in (("can0", 1), ("can0", 2), ("can1", 1), ("can9", 1))])
    assert [driver.heard for driver in drivers] == [[1, 2], [2], [1]]


def test_measurements_are_those_of_the_output_and_unknown_while_silent() -> None:
    motors, drivers = robot()
    assert (motors.setpoints, motors.feedback) == ((None,) * 3, (SILENT,) * 3)
    assert motors.measure(7, 0.5) == (7, 0.5, *([(None,) * 3] * 4), (), None, False, None, None, (), (None,) * 3)
    drivers[0].motors = [MEASURED]
    other = MEASURED._replace(velocity=1.0, torque_age_ns=5_000_000)
    drivers[1].motors = [other]
    found = motors.measure(0, 0.1)
    assert motors.feedback == (MEASURED, SILENT, other)
    assert found.speeds == (-2.0, None, 1.0)
    assert found.positions == (-1.0, None, 3.0)
    assert found.torques == (-2.0, None, 0.5)
    assert found.ages_ns == (4_000_000, None, 4_000_000)
    assert found.torque_ages_ns == (MEASURED.torque_age_ns, None, 5_000_000)
    drivers[0].motors = [MEASURED._replace(state=MotorState.SILENT)]
    found = motors.measure(0, 0.1)
    assert (found.speeds[0], found.positions[0], found.torques[0]) == (None, None, None)


@pytest.mark.parametrize(
    ("speeds", "turning"),
    [
        ([None, None, None], None),
        ([None, 0.0, None], False),
        ([0.1, -0.1, None], False),  # 0.005 of top speed
        ([None, 0.0, 0.11], True),
        ([-0.11, None, 0.0], True),
    ],
)
def test_what_turns(speeds: list[float | None], turning: bool | None) -> None:
    motors, _ = robot()
    assert motors.turning(measured(speeds)) is turning


@pytest.mark.parametrize(("age_ns", "fresh"), [(4_000_000, True), (4_000_001, False), (None, False), (0, True)])
def test_a_sample_is_fresh_for_a_cycle(age_ns: int | None, fresh: bool) -> None:
    motors, drivers = robot()
    drivers[0].motors = [MEASURED._replace(age_ns=age_ns)]
    motors.setpoints = (5.0, None, None)
    found = motors.measure(0, 0.004)
    x, other, _ = motors.samples(found, driving=True, expected=(lambda: 10.0, lambda: 11.0, lambda: 12.0))
    assert (x.setpoint, x.speed, x.position, x.torque) == (5.0, -2.0, -1.0, -2.0)
    assert (x.fresh, x.driving, x.dt) == (fresh, True, 0.004)
    assert (x.expected(), other.expected()) == (10.0, 11.0)


@pytest.mark.parametrize(
    ("setpoint", "speed", "torque", "headroom"),
    [
        (10.0, 9.0, 0.0, 1.0),  # a lag of 0.05 of top speed
        (10.0, 8.7, 0.0, 0.5),
        (10.0, 11.3, None, 0.5),
        (10.0, 8.4, 0.0, 0.0),
        (10.0, 0.0, 0.0, 0.0),
        (10.0, 9.79, 9.8, 0.0),  # all its torque, and behind
        (-10.0, -9.79, -9.8, 0.0),
        (10.0, 9.79, 9.7, 1.0),
        (10.0, 9.81, 9.8, 1.0),  # as in a launch
        (10.0, 10.21, 9.8, 1.0),
        (10.0, 9.79, -9.8, 1.0),
        (10.0, 9.79, None, 1.0),
        (None, 0.0, 9.8, 1.0),
        (10.0, None, 9.8, 1.0),
    ],
)
def test_headroom(setpoint: float | None, speed: float | None, torque: float | None, headroom: float) -> None:
    motors, _ = robot()
    found = measured((1.0, speed, 1.0), (0.0, torque, 0.0))
    assert motors.headroom(found) == 1.0
    motors.setpoints = (1.0, setpoint, 1.0)
    assert motors.headroom(found) == pytest.approx(headroom)
    motors.setpoints = (None, setpoint, 2.3)  # one released, another lags by 0.065
    assert motors.headroom(found) == pytest.approx(min(headroom, 0.5))


def test_who_does_not_obey_and_who_is_on_which_bus() -> None:
    motors, drivers = robot()
    drivers[0].motors = [MEASURED]
    motors.measure(0, 0.1)
    assert motors.not_operational((True, True, True)) == [1, 2]
    assert motors.not_operational((False, False, True)) == [2]
    assert motors.on_buses(["can0"]) == {0, 2}
    assert motors.on_buses(["can1", "can9"]) == {1}
    assert motors.on_buses([]) == set()


def test_what_is_for_all_drivers_reaches_all() -> None:
    motors, drivers = robot()
    motors.clear_faults()
    assert [driver.cleared for driver in drivers] == [1, 1, 1]
    assert [(frame.id, frame.data) for frame in motors.coast_frames()] == [(1, b"coast")] * 3
    assert [(frame.data, frame.received_ns) for frame in motors.stop_frames(now_ns=5)] == [(b"stop", 5)] * 3


def test_each_motor_gets_the_command_that_its_controller_knows() -> None:
    motors, drivers = robot()

    def told(*commands: JointCommand) -> list[MotorCommand]:
        frames = motors.command(commands, measured((None, 1.0, None)))
        assert [frame.data for frame in frames] == [b"command"] * 3
        return [drivers[place].commands[0] for place in (0, 2, 1)]

    velocity, torque, voltage = CommandKind.VELOCITY, CommandKind.TORQUE, CommandKind.VOLTAGE
    coast, brake = drive_law.COAST, drive_law.BRAKE
    two, nought = JointCommand(velocity, 2.0), JointCommand(velocity, 0.0)
    assert told(two, two, coast) == [MotorCommand(velocity, -8.0), MotorCommand(torque, 1.0), COAST]
    assert list(motors.setpoints) == [2.0, 2.0, None]
    assert told(brake, two, brake) == [BRAKE, MotorCommand(torque, 1.5), BRAKE]
    assert list(motors.setpoints) == [0.0, 2.0, 0.0]
    assert told(coast, coast, coast) == [COAST] * 3
    assert list(motors.setpoints) == [None] * 3
    assert told(coast, two, nought) == [COAST, MotorCommand(torque, 1.0), MotorCommand(velocity, 0.0)]
    assert told(nought, brake, nought)[1] == MotorCommand(torque, -0.5), "to rest, from half of it in the integrator"
    push, limited = JointCommand(torque, 6.0), JointCommand(torque, -6.0, limit=2.0)
    assert told(push, push, limited) == [
        MotorCommand(torque, -1.5),
        MotorCommand(torque, 3.0),
        MotorCommand(torque, -2.0),
    ]
    assert list(motors.setpoints) == [None] * 3
    assert told(coast, two, coast)[1] == MotorCommand(torque, 1.0), "a torque command empties the integrator"
    volts = JointCommand(voltage, 5.0)
    assert told(volts, coast, volts) == [MotorCommand(voltage, -5.0), COAST, MotorCommand(voltage, 5.0)]
    helped = JointCommand(velocity, 1.0, feed_forward=4.0)
    assert told(coast, coast, coast)[1] == COAST
    assert told(coast, helped, coast)[1] == MotorCommand(torque, 2.0)
    assert told(coast, JointCommand(velocity, 1.0, feed_forward=4.0, limit=3.0), coast)[1] == MotorCommand(torque, 1.5)
    (first, _, third) = told(JointCommand(velocity, 1.0, feed_forward=4.0, limit=6.0), coast, helped)
    assert first == MotorCommand(velocity, -4.0, -1.0, 1.5), "a speed loop in the controller gets both, at its shaft"
    assert third == MotorCommand(velocity, 1.0, 4.0)
    plain = told(two, coast, coast)[0].feed_forward
    assert str(plain) == "0.0", "no minus zero, which would reach the wire"


def test_status() -> None:
    motors, drivers = robot()
    fault = DriverFault("hot", "too hot", latched=True)
    drivers[0].motors = [MEASURED._replace(state=MotorState.FAULT, fault=fault, voltage=24.0, temperature_c=90.0)]
    motors.setpoints = (None, 7.0, None)
    found = motors.measure(0, 0.1)
    assert motors.status(found)[:2] == (
        ("a", "fault", None, -2.0, -2.0, 24.0, 90.0, "too hot", 0.004),
        ("b", "silent", 7.0, None, None, None, None, None, None),
    )
    assert len(motors.status(found)) == 3


def test_a_motor_that_is_told_voltages_counts_as_giving_the_torque_that_they_are_for() -> None:
    """b through a gear of 2, k = 0.5, R = 2: 2 N m at the output and 1 rad/s are 1 N m and 2 rad/s, so 4 + 1 V."""
    motors, drivers = robot(Winding(resistance=2.0, back_emf=0.5))
    two, coast = JointCommand(CommandKind.VELOCITY, 2.0), drive_law.COAST
    never = (lambda: None,) * 3

    def torque_seen(found: Measured) -> float | None:
        return motors.samples(found, driving=True, expected=never)[1].torque

    assert torque_seen(measured()) is None
    motors.command((coast, two, coast), measured((None, 1.0, None)))
    assert drivers[2].commands == [MotorCommand(CommandKind.VOLTAGE, 5.0)]
    assert torque_seen(measured()) == 2.0
    assert torque_seen(measured(torques=(None, 0.25, None))) == 0.25, "what is measured goes before it"
    assert motors.status(motors.measure(0, 0.1))[1].torque is None, "and nobody says that it was measured"
    motors.command((coast, JointCommand(CommandKind.VELOCITY, 20.0), coast), measured((None, 10.0, None)))
    assert motors.headroom(measured((None, 19.7, None))) == 0.0, "all its torque, and behind"
    motors.command((coast, JointCommand(CommandKind.TORQUE, 1.0), coast), measured((None, 1.0, None)))
    assert drivers[2].commands == [MotorCommand(CommandKind.VOLTAGE, 3.0)]
    assert torque_seen(measured()) is None
    motors.command((coast, two, coast), measured())
    assert drivers[2].commands == [MotorCommand(CommandKind.VOLTAGE, 0.0)], "its speed is unknown"
    motors.command((coast, coast, coast), measured((None, 1.0, None)))
    assert (drivers[2].commands, torque_seen(measured())) == ([COAST], None)
