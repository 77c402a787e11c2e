"""The position/velocity/torque controller inside a simulated ODrive: turns, N m at the motor shaft.

Behaviour, defaults and order of operations as in the open firmware: github odriverobotics/ODrive f9b5419c,
Firmware/MotorControl/controller.cpp and controller.hpp. Run at 1 kHz instead of 8 kHz.
"""

from enum import IntEnum, IntFlag
from math import isnan, pi

from replay.sim.controllers.contract import STEP_S, MotorSetup


class ControlMode(IntEnum):
    VOLTAGE = 0  # "not used internally": gives the torque setpoint, without velocity loop
    TORQUE = 1
    VELOCITY = 2
    POSITION = 3


class InputMode(IntEnum):
    """The modes simulated; asking for another one is a controller error here."""

    INACTIVE = 0
    PASSTHROUGH = 1
    VEL_RAMP = 2
    TORQUE_RAMP = 6


class ControllerError(IntFlag):
    NONE = 0
    OVERSPEED = 0x1
    INVALID_INPUT_MODE = 0x2
    INVALID_ESTIMATE = 0x20  # here also: a setpoint that is not a number


POSITION_GAIN = 20.0  # 1/s, firmware default
VELOCITY_LIMIT = 2.0  # turns/s, firmware default until Set_Limits
VELOCITY_TOLERANCE = 1.2  # overspeed error beyond this share of the limit, firmware default
CURRENT_LIMIT = 10.0  # A, firmware default until Set_Limits
WINDUP_DECAY = 0.99**8  # per 1 ms, firmware default 0.99 per 125 us

# Commissioned on the robot, not defaults (the firmware's 1 turn/s^2 ramp and 1/6 N m s gain fit no robot):
VELOCITY_BANDWIDTH = 60.0  # rad/s of the closed velocity loop; source: ours
INTEGRATOR_RATE = 10.0  # 1/s; source: ours
CALIBRATION_SHARE = 0.2  # of the torque; source: ours
RAMP_TIME = 0.1  # s to full speed, and to full torque, in the ramp modes; source: ours


class OdriveController:
    """Setpoints in, torque out. Inputs survive disarming, as on the device: a stale one acts on the next arming."""

    def __init__(self, setup: MotorSetup) -> None:
        self._velocity_gain = VELOCITY_BANDWIDTH * setup.inertia * 2.0 * pi  # N m per turn/s
        self._integrator_gain = self._velocity_gain * INTEGRATOR_RATE
        self._velocity_step = setup.max_speed / (2.0 * pi) / RAMP_TIME * STEP_S
        self._torque_step = setup.max_torque / RAMP_TIME * STEP_S
        self._max_torque = setup.max_torque
        self.torque_constant = setup.max_torque / setup.max_current
        self.reboot()

    def reboot(self) -> None:
        """Back to the stored defaults."""
        self.control_mode: int = ControlMode.POSITION
        self.input_mode: int = InputMode.PASSTHROUGH
        self.input_position = self.input_velocity = self.input_torque = 0.0
        self.velocity_limit = VELOCITY_LIMIT
        self.current_limit = CURRENT_LIMIT
        self.arm(0.0)

    def arm(self, position: float) -> None:
        """Reset the setpoints, not the inputs; position control starts where the shaft is."""
        self._velocity_setpoint = self._torque_setpoint = self._integrator = 0.0
        self.hold(position)

    def hold(self, position: float) -> None:
        """In position control, take the current position as setpoint (arming, change of mode)."""
        if self.control_mode >= ControlMode.POSITION:
            self.input_position = position

    def update(self, position: float, velocity: float) -> tuple[float, ControllerError]:
        """One control period: torque, and the error that makes the axis disarm."""
        inputs = self.input_position + self.input_velocity + self.input_torque
        if isnan(inputs + self.velocity_limit + self.current_limit):
            return 0.0, ControllerError.INVALID_ESTIMATE
        if not self._take_inputs():
            return 0.0, ControllerError.INVALID_INPUT_MODE
        if abs(velocity) > VELOCITY_TOLERANCE * self.velocity_limit:
            return 0.0, ControllerError.OVERSPEED
        limit = max(0.0, min(self._max_torque, self.current_limit * self.torque_constant))
        if self.control_mode < ControlMode.VELOCITY:
            return self._torque_control(velocity, limit), ControllerError.NONE
        return self._velocity_control(position, velocity, limit), ControllerError.NONE

    def towards(self, velocity: float, measured: float) -> float:
        """A gentle torque towards so many turns/s, as a calibration has it."""
        return _clamp(self._velocity_gain * (velocity - measured), CALIBRATION_SHARE * self._max_torque)

    def _take_inputs(self) -> bool:
        """Move the setpoints towards the inputs; False: an input mode the controller does not know."""
        mode = self.input_mode
        if mode == InputMode.PASSTHROUGH:
            self._velocity_setpoint, self._torque_setpoint = self.input_velocity, self.input_torque
        elif mode == InputMode.VEL_RAMP:  # torque feed-forward is the model's, and the default inertia is 0
            self._velocity_setpoint += _clamp(self.input_velocity - self._velocity_setpoint, self._velocity_step)
            self._torque_setpoint = 0.0
        elif mode == InputMode.TORQUE_RAMP:
            self._torque_setpoint += _clamp(self.input_torque - self._torque_setpoint, self._torque_step)
        return mode in _INPUT_MODES

    def _torque_control(self, velocity: float, limit: float) -> float:
        """Torque setpoint, held back by the velocity limiter of torque mode."""
        self._integrator = 0.0
        highest = (self.velocity_limit - velocity) * self._velocity_gain
        lowest = (-self.velocity_limit - velocity) * self._velocity_gain
        return _clamp(max(lowest, min(highest, _clamp(self._torque_setpoint, limit))), limit)

    def _velocity_control(self, position: float, velocity: float, limit: float) -> float:
        wanted = _clamp(self._velocity_setpoint, self.velocity_limit)
        if self.control_mode >= ControlMode.POSITION:
            wanted = _clamp(wanted + POSITION_GAIN * (self.input_position - position), self.velocity_limit)
        error = wanted - velocity
        torque = _clamp(self._torque_setpoint, limit) + self._velocity_gain * error + self._integrator
        if abs(torque) > limit:
            self._integrator *= WINDUP_DECAY
            return _clamp(torque, limit)
        self._integrator += self._integrator_gain * STEP_S * error
        return torque


_INPUT_MODES = frozenset(InputMode)


def _clamp(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
