"""All motors of the robot behind one face, in chassis order and at their outputs: drivers, gears, speed loops."""

from collections.abc import Callable, Sequence
from functools import partial

from drivers.contract import BRAKE, COAST, CanFrame, CommandKind, MotorCommand, MotorFeedback, MotorState
from gateway.core.assembly import Robot
from gateway.core.detectors import Sample
from gateway.types import MotorStatus

STANDSTILL = 0.005  # of the motor's top speed
SATURATED = 0.98  # of the torque limit
HEADROOM_FROM, HEADROOM_TO = 0.05, 0.08  # of top speed: lag at which the setpoint may grow slower, and not at all


class Motors:
    """Owns the drivers. `feedback`, `speeds` (rad/s) and `positions` (rad) are those of the last `measure`."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._receivers = {
            bus: tuple(group.driver.receive for group in robot.groups if group.bus == bus)
            for bus in {group.bus for group in robot.groups}
        }
        size = len(robot.names)
        self._standstill = tuple(STANDSTILL * limits.speed for limits in robot.limits)
        self.feedback: list[MotorFeedback] = [MotorFeedback(MotorState.SILENT)] * size
        self.speeds: list[float | None] = [None] * size
        self.positions: list[float | None] = [None] * size
        self.torques: list[float | None] = [None] * size  # N m
        self.setpoints: list[float | None] = [None] * size  # rad/s; None: released

    def receive(self, frames: Sequence[CanFrame]) -> None:
        """Hand every frame to the driver it belongs to; what belongs to nobody is left out."""
        for frame in frames:
            for receive in self._receivers.get(frame.bus, ()):
                if receive(frame):
                    break

    def measure(self, now_ns: int) -> None:
        """Bring feedback, speeds and positions up to date; those of a silent motor are unknown."""
        for group in self._robot.groups:
            for index, feedback in zip(group.indices, group.driver.feedback(now_ns=now_ns), strict=True):
                self.feedback[index] = feedback
                if feedback.state is MotorState.SILENT:
                    self.speeds[index] = self.positions[index] = self.torques[index] = None
                else:
                    gear = self._robot.transmissions[index]
                    self.speeds[index], self.positions[index] = gear.output(feedback.velocity, feedback.position)
                    self.torques[index] = gear.output_torque(feedback.torque)

    def command(self, setpoints: list[float | None], *, braking: bool, dt: float, now_ns: int) -> tuple[CanFrame, ...]:
        """Frames of this cycle. A setpoint of None releases its motor; `braking` asks the controllers' own brake."""
        self.setpoints = setpoints
        frames: list[CanFrame] = []
        for group in self._robot.groups:
            commands = [self._command(index, braking=braking, dt=dt) for index in group.indices]
            frames += group.driver.command(commands, now_ns=now_ns)
        return tuple(frames)

    def turning(self) -> bool | None:
        """Whether any measured wheel turns; None: not one is measured."""
        measured = None
        for speed, limit in zip(self.speeds, self._standstill, strict=True):
            if speed is not None:
                if abs(speed) > limit:
                    return True
                measured = False
        return measured

    def samples(self, *, driving: bool, dt: float, expected: Callable[[int], float | None]) -> list[Sample]:
        """What the detectors look at: the last measurement against the setpoint it answers to."""
        fresh_ns = dt * 1e9
        return [
            Sample(
                self.setpoints[index],
                self.speeds[index],
                self.positions[index],
                self.torques[index],
                feedback.age_ns is not None and feedback.age_ns <= fresh_ns,
                driving,
                dt,
                partial(expected, index),
            )
            for index, feedback in enumerate(self.feedback)
        ]

    def headroom(self) -> float:
        """How far the setpoint may still grow, 1 to 0: motors at their torque limit, or that lag, cannot follow."""
        lag = 0.0
        for setpoint, speed, torque, limits in zip(
            self.setpoints, self.speeds, self.torques, self._robot.limits, strict=True
        ):
            if setpoint is None or speed is None:
                continue
            behind = setpoint - speed
            if torque is not None and abs(torque) >= SATURATED * limits.torque and torque * behind > 0.0:
                return 0.0
            lag = max(lag, abs(behind) / limits.speed)
        return min(1.0, max(0.0, (HEADROOM_TO - lag) / (HEADROOM_TO - HEADROOM_FROM)))

    def not_operational(self, usable: Sequence[bool]) -> list[int]:
        """Places of the usable motors that do not obey yet."""
        return [
            index
            for index, (feedback, ok) in enumerate(zip(self.feedback, usable, strict=True))
            if ok and feedback.state is not MotorState.OPERATIONAL
        ]

    def on_buses(self, buses: Sequence[str]) -> set[int]:
        """Places of the motors on the named buses."""
        return {index for group in self._robot.groups if group.bus in buses for index in group.indices}

    def clear_faults(self) -> None:
        """Ask every controller to forget its latched faults; arms nothing."""
        for group in self._robot.groups:
            group.driver.clear_faults()

    def coast_frames(self) -> list[CanFrame]:
        """Frames that release every motor; valid in any state."""
        return [frame for group in self._robot.groups for frame in group.driver.coast_frames()]

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """Frames that brake every motor when the core can no longer be trusted."""
        return [frame for group in self._robot.groups for frame in group.driver.stop_frames(now_ns=now_ns)]

    def status(self) -> tuple[MotorStatus, ...]:
        """Every motor in words and numbers."""
        return tuple(map(self._status, range(len(self.feedback))))

    def _command(self, index: int, *, braking: bool, dt: float) -> MotorCommand:
        setpoint, loop, gear = self.setpoints[index], self._robot.speed_loops[index], self._robot.transmissions[index]
        if setpoint is None:
            if loop is not None:
                loop.reset()
            return COAST
        if loop is not None:
            return MotorCommand(CommandKind.TORQUE, gear.motor_torque(loop.torque(setpoint, self.speeds[index], dt)))
        return BRAKE if braking else MotorCommand(CommandKind.VELOCITY, gear.motor_speed(setpoint))

    def _status(self, index: int) -> MotorStatus:
        feedback = self.feedback[index]
        return MotorStatus(
            name=self._robot.names[index],
            state=feedback.state.value,
            commanded=self.setpoints[index],
            measured=self.speeds[index],
            torque=self._robot.transmissions[index].output_torque(feedback.torque),
            voltage=feedback.voltage,
            temperature_c=feedback.temperature_c,
            fault=feedback.fault.text if feedback.fault else None,
            age_s=None if feedback.age_ns is None else feedback.age_ns * 1e-9,
        )
