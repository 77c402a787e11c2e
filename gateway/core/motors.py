"""All motors of the robot behind one face, in chassis order and at their outputs: drivers, gears, speed loops."""

from collections.abc import Callable, Sequence
from typing import Final

from drivers.contract import CanFrame, MotorFeedback, MotorState
from drivers.records import maker
from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from gateway.control.drive_law import JointCommand, Measured
from gateway.core.assembly import Robot
from gateway.core.detectors import Sample
from gateway.types import MotorStatus

_measured: Final = maker(Measured)
# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_SILENT: Final = MotorState.SILENT
_OPERATIONAL: Final = MotorState.OPERATIONAL
_VELOCITY: Final = CommandKind.VELOCITY
_BRAKE: Final = CommandKind.BRAKE
_COAST: Final = CommandKind.COAST

STANDSTILL: Final = 0.005  # of the motor's top speed
SATURATED: Final = 0.98  # of the torque limit
TAKE_UP_FROM: Final = 0.02  # of top speed; less is no step, whatever becomes of it
_SPEEDS: Final = (CommandKind.VELOCITY, CommandKind.BRAKE)  # the kinds whose value is a speed to be reached
TORQUE_AGE_NS: Final = 30_000_000  # an older torque says nothing of now
BEHIND: Final = 0.01  # of top speed, from which a motor at its limit does not follow; a launch takes all it has
HEADROOM_FROM: Final = 0.05  # of top speed: lag at which the setpoint may grow slower ...
HEADROOM_TO: Final = 0.08  # ... and not at all


class Motors:
    """Owns the drivers. `feedback` is that of the last `measure`; `setpoints`, `wanted` those of the last `command`."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._receivers = {
            bus: tuple(group.driver.receive for group in robot.groups if group.bus == bus)
            for bus in {group.bus for group in robot.groups}
        }
        size = len(robot.names)
        self._untold = tuple(index for index, gear in enumerate(robot.transmissions) if gear.winding is not None)
        self._standstill = tuple(STANDSTILL * limits.speed for limits in robot.limits)
        self.feedback: tuple[MotorFeedback, ...] = (MotorFeedback(_SILENT),) * size
        self.setpoints: tuple[float | None, ...] = (None,) * size  # rad/s; None: released, or not told a speed
        self.wanted: list[float | None] = [None] * size  # N m at the output that our speed loops asked for

    def receive(self, frames: Sequence[CanFrame]) -> None:
        """Hand every frame to the driver it belongs to; what belongs to nobody is left out."""
        for frame in frames:
            for receive in self._receivers.get(frame.bus, ()):
                if receive(frame):
                    break

    def measure(self, now_ns: int, dt: float) -> Measured:
        """What the joints report now; of a silent one nothing is known."""
        gears = self._robot.transmissions
        size = len(gears)
        feedbacks = list(self.feedback)
        speeds: list[float | None] = [None] * size
        positions: list[float | None] = [None] * size
        torques: list[float | None] = [None] * size
        ages_ns: list[int | None] = [None] * size
        torque_ages_ns: list[int | None] = [None] * size
        for group in self._robot.groups:
            for index, feedback in zip(group.indices, group.driver.feedback(now_ns=now_ns)):
                feedbacks[index] = feedback
                state, position, velocity, torque, _, _, _, age_ns, _, torque_age_ns = feedback
                ages_ns[index], torque_ages_ns[index] = age_ns, torque_age_ns
                if state is not _SILENT:
                    gear = gears[index]
                    speeds[index], positions[index] = gear.output(velocity, position)
                    torques[index] = gear.output_torque(torque)
        self.feedback = tuple(feedbacks)
        known = tuple(speeds), tuple(positions), tuple(torques), tuple(ages_ns)
        return _measured((now_ns, dt, *known, (), None, False, None, None, (), tuple(torque_ages_ns)))

    def command(self, commands: Sequence[JointCommand], measured: Measured) -> tuple[CanFrame, ...]:
        """Frames of this cycle."""
        self.setpoints = tuple([command.value if command.kind in _SPEEDS else None for command in commands])
        frames: list[CanFrame] = []
        for group in self._robot.groups:
            told = [self._command(index, commands[index], measured) for index in group.indices]
            frames += group.driver.command(told, now_ns=measured.now_ns)
        return tuple(frames)

    def turning(self, measured: Measured) -> bool | None:
        """Whether any measured wheel turns; None: not one is measured."""
        known = None
        for speed, limit in zip(measured.speeds, self._standstill):
            if speed is not None:
                if abs(speed) > limit:
                    return True
                known = False
        return known

    def samples(
        self, measured: Measured, *, driving: bool, expected: Sequence[Callable[[], float | None]]
    ) -> list[Sample]:
        """What the detectors look at: the last measurement against the setpoint it answers to.

        `expected`: the speed of each as the other wheels have it, asked only where it matters.
        """
        fresh_ns = measured.dt * 1e9
        torques = self.torques(measured)
        return [
            Sample(
                self.setpoints[index],
                measured.speeds[index],
                measured.positions[index],
                torques[index],
                fresh=age_ns is not None and age_ns <= fresh_ns,
                driving=driving,
                dt=measured.dt,
                expected=expected[index],
            )
            for index, age_ns in enumerate(measured.ages_ns)
        ]

    def headroom(self, measured: Measured) -> float:
        """How far the setpoint may still grow, 1 to 0: motors at their torque limit, or that lag, cannot follow."""
        worst = 0.0
        for setpoint, speed, torque, limits in zip(
            self.setpoints, measured.speeds, self.torques(measured), self._robot.limits
        ):
            if setpoint is None or speed is None:
                continue
            behind = setpoint - speed
            lag = abs(behind) / limits.speed
            pulls = torque is not None and torque * behind > 0.0 and abs(torque) >= SATURATED * limits.torque
            if pulls and lag > BEHIND:
                return 0.0
            worst = lag if lag > worst else worst
        return min(1.0, max(0.0, (HEADROOM_TO - worst) / (HEADROOM_TO - HEADROOM_FROM)))

    def share_driven(self, measured: Measured, obeying: Sequence[bool]) -> float | None:
        """How much of its setpoint the motor turns that has kept most of it, 0 to 1; so none is braked by a step.

        Of the motors that obey and were asked for more than TAKE_UP_FROM; None: there are none.
        """
        shares = [
            speed / setpoint
            for setpoint, speed, ok, feedback, limits in zip(
                self.setpoints, measured.speeds, obeying, self.feedback, self._robot.limits, strict=True
            )
            if ok and feedback.state is _OPERATIONAL
            if setpoint is not None and speed is not None and abs(setpoint) > TAKE_UP_FROM * limits.speed
        ]
        return min(1.0, max(0.0, *shares)) if shares else None

    def not_operational(self, usable: Sequence[bool]) -> list[int]:
        """Places of the usable motors that do not obey yet."""
        places = []
        for index, feedback in enumerate(self.feedback):
            if feedback.state is not _OPERATIONAL and usable[index]:
                places.append(index)
        return places

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

    def status(self, measured: Measured) -> tuple[MotorStatus, ...]:
        """Every motor in words and numbers."""
        return tuple([self._status(index, measured) for index in range(len(self.feedback))])

    def torques(self, measured: Measured) -> Sequence[float | None]:
        """As measured; of a motor that is told voltages and tells no torque, that which its voltage was meant for."""
        if not self._untold:
            return measured.torques
        torques = list(measured.torques)
        for index in self._untold:
            if torques[index] is None:
                torques[index] = self.wanted[index]
        return torques

    def torques_now(self, measured: Measured) -> Sequence[float | None]:
        """The same, where it was told just now: an ODrive tells it ten times a second unless it is set up for more."""
        torques = list(self.torques(measured))
        for index, feedback in enumerate(self.feedback):
            if feedback.torque is not None:
                age_ns = feedback.torque_age_ns
                if age_ns is None or age_ns > TORQUE_AGE_NS:
                    torques[index] = None
        return torques

    def _command(self, index: int, command: JointCommand, measured: Measured) -> MotorCommand:
        """From the joint to the shaft. Without a speed loop of its own the controller gets what ours wants."""
        loop, gear = self._robot.speed_loops[index], self._robot.transmissions[index]
        kind, speed = command.kind, measured.speeds[index]
        if loop is not None:
            if kind is _VELOCITY or kind is _BRAKE:
                dt = measured.dt
                torque = loop.torque(command.value, speed, dt, feed_forward=command.feed_forward, limit=command.limit)
                self.wanted[index] = torque
                return gear.torque_command(torque, speed)
            loop.reset()
            self.wanted[index] = None
        if kind is _COAST:
            return COAST
        return BRAKE if kind is _BRAKE else gear.motor_command(command, speed)

    def _status(self, index: int, measured: Measured) -> MotorStatus:
        feedback = self.feedback[index]
        return MotorStatus(
            name=self._robot.names[index],
            state=feedback.state.value,
            commanded=self.setpoints[index],
            measured=measured.speeds[index],
            torque=self._robot.transmissions[index].output_torque(feedback.torque),
            voltage=feedback.voltage,
            temperature_c=feedback.temperature_c,
            fault=feedback.fault.text if feedback.fault else None,
            age_s=None if feedback.age_ns is None else feedback.age_ns * 1e-9,
        )
