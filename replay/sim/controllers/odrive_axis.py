"""The axis inside a simulated ODrive: states, errors, watchdog and encoder; the frames are in `odrive`.

How this works
--------------
Requests are stored and carried out in `step`. An error disarms, which is a coast, and stays until `clear_errors`;
while there is one, closed loop is refused. A full calibration (0.6) turns the motor slowly there and back, and marks it
as calibrated; without that closed loop is refused too. The watchdog differs: 0.5 is fed by any frame to the node and
expires in IDLE too; 0.6 is fed by setpoints and counts from arming. A power cycle forgets everything that was not saved
and, unless the encoder is absolute, the position. 0.5 tells estimates of exactly zero from power-on until it was first
in closed loop, whatever the encoder reads.
"""

from collections.abc import Mapping
from math import pi

from replay.sim.controllers.contract import SECOND_NS, MotorSetup, Shaft
from replay.sim.controllers.odrive_control import ControllerError, OdriveController
from replay.sim.controllers.odrive_parameters import CALIBRATED, Parameters
from replay.sim.controllers.odrive_tables import AxisState, Firmware, ProcedureResult

_TURN = 2.0 * pi
CALIBRATION_S = 1.0  # the device takes longer; source: ours
CALIBRATION_SPEED = 1.0  # turns/s; source: ours


class OdriveAxis:
    """State owner; `encoder_frozen`, `phase_connected` and `condition` are fault switches."""

    def __init__(self, setup: MotorSetup, firmware: Firmware, rates_ms: Mapping[str, float]) -> None:
        self.control = OdriveController(setup)
        self.parameters = Parameters(setup, over_usb=firmware.watchdog_over_usb, rates_ms=rates_ms)
        self.encoder_frozen = False  # position stuck, velocity 0: the velocity loop winds up to full torque
        self.encoder_shift = 0.0  # rad that the encoder tells too much
        self.phase_connected = True  # False: no torque, and the state drops with error 0 (ODrive issue 700)
        self.condition = 0  # error bits whose cause persists: they return after Clear_Errors
        self.calibration_speed = CALIBRATION_SPEED  # turns/s of the rotor
        self._calibrating_from_ns = 0
        self._laws = {
            AxisState.IDLE: _no_torque,
            AxisState.FULL_CALIBRATION: self._calibration_law,
            AxisState.CLOSED_LOOP: self._control_law,
        }
        self._firmware = firmware
        self._absolute = setup.absolute
        self._now_ns = 0
        self._sound = self._shaft = Shaft(0.0, 0.0)  # what a sound encoder tells, and what this one does
        self._origin = 0.0  # shaft angle at which the reading is 0
        self.reboot()

    @property
    def turns(self) -> float:
        """Encoder reading: since power-on, or of the shaft itself where the encoder is absolute."""
        return (self._shaft.position - self._origin) / _TURN

    @property
    def turns_per_second(self) -> float:
        return self._shaft.velocity / _TURN

    @property
    def estimates(self) -> tuple[float, float]:
        """Turns and turns/s as they are told on the bus."""
        return (self.turns, self.turns_per_second) if self._estimating else (0.0, 0.0)

    @property
    def mechanical_power(self) -> float:
        return self.torque * self._shaft.velocity

    def place(self, shaft: Shaft, now_ns: int) -> None:
        """First power-on at the given shaft angle."""
        self._shaft = self._sound = shaft
        self._origin = self._origin_here()
        self._now_ns = self._fed_ns = now_ns

    def reboot(self) -> None:
        """IDLE, no errors, saved parameters only; position 0 unless the encoder is absolute."""
        self._shaft = self._sound
        self._origin = self._origin_here()
        self._estimating = not self._firmware.legacy
        self._fed_ns = self._now_ns
        self._requested: int | None = None
        self.control.reboot()
        self.parameters.reboot()
        self.state = AxisState.IDLE
        self.result = ProcedureResult.SUCCESS
        self.torque = 0.0
        self.disarm_reason = 0
        self.clear_errors()

    def clear_errors(self) -> None:
        self.errors = self.disarm_reason = 0
        self.motor_error = self.encoder_error = self.controller_error = 0

    def fail(self, bits: int) -> None:
        """Latch error bits; an armed axis is disarmed."""
        self.errors |= bits
        if self.state is AxisState.CLOSED_LOOP:
            self.disarm_reason |= bits
            self._disarm()

    def estop(self) -> None:
        self.fail(self._firmware.estop_error)

    def request(self, state: int) -> None:
        """Ask for a state; carried out in the next step."""
        self._requested = state

    def feed_watchdog(self, now_ns: int) -> None:
        self._fed_ns = now_ns

    def set_position(self, turns: float) -> None:
        """Make the present angle read as this many turns."""
        self._origin = self._shaft.position - turns * _TURN

    def step(self, shaft: Shaft, now_ns: int, *, powered: bool) -> float:
        """Encoder, errors, watchdog, requested state, then the control law; the torque."""
        self._now_ns = now_ns
        self._sound = Shaft(shaft.position + self.encoder_shift, shaft.velocity) if self.encoder_shift else shaft
        self._shaft = Shaft(self._shaft.position, 0.0) if self.encoder_frozen else self._sound
        if not powered:
            return 0.0
        if self.condition:
            self.fail(self.condition)
        if self.parameters.watchdog_enabled:
            self._check_watchdog()
        if self._requested is not None:
            self._enter(self._requested)
        self.torque = self._laws[self.state]()
        return self.torque

    def _origin_here(self) -> float:
        return 0.0 if self._absolute else self._shaft.position + 0.0  # no minus zero, which would reach the wire

    def _check_watchdog(self) -> None:
        running = self._firmware.watchdog_when_idle or self.state is AxisState.CLOSED_LOOP
        if running and self._now_ns - self._fed_ns >= self.parameters.watchdog_timeout * SECOND_NS:
            self.fail(self._firmware.watchdog_error)

    def _enter(self, requested: int) -> None:
        self._requested = None
        if requested == AxisState.CLOSED_LOOP:
            self._arm()
            return
        if requested == AxisState.FULL_CALIBRATION and not self._firmware.legacy and not self.errors:
            self.state, self.result = AxisState.FULL_CALIBRATION, ProcedureResult.BUSY
            self._calibrating_from_ns = self._now_ns
            return
        known = requested == AxisState.IDLE
        if self.state is AxisState.FULL_CALIBRATION:
            self.state, self.result = AxisState.IDLE, ProcedureResult.CANCELLED
            return
        self.state = AxisState.IDLE
        self.result = ProcedureResult.SUCCESS if known else ProcedureResult.INVALID_STATE
        if not known:
            self.errors |= self._firmware.invalid_state_error

    def _arm(self) -> None:
        self.errors &= ~self._firmware.invalid_state_error  # the next request clears it, as in the firmware
        if self.errors:
            self._disarm()
        elif not self._firmware.legacy and not all(self.parameters[name] for name in CALIBRATED):
            self.state, self.result = AxisState.IDLE, ProcedureResult.NOT_CALIBRATED
        elif self.state is not AxisState.CLOSED_LOOP:
            self.state = AxisState.CLOSED_LOOP
            self.result = ProcedureResult.BUSY
            self._fed_ns = self._now_ns
            self._estimating = True
            self.control.arm(self.turns)

    def _disarm(self) -> None:
        self.state = AxisState.IDLE
        self.result = ProcedureResult.DISARMED
        self.torque = 0.0

    def _calibration_law(self) -> float:
        """Slowly forward, then back; then IDLE."""
        gone = (self._now_ns - self._calibrating_from_ns) / SECOND_NS
        if not self.phase_connected:
            self.state, self.result = AxisState.IDLE, ProcedureResult.PHASE_RESISTANCE_OUT_OF_RANGE
            return 0.0
        if gone >= CALIBRATION_S:
            self.state, self.result = AxisState.IDLE, ProcedureResult.SUCCESS
            self.parameters.put(dict.fromkeys(CALIBRATED, 1.0))
            return 0.0
        wanted = self.calibration_speed if gone < CALIBRATION_S / 2.0 else -self.calibration_speed
        return self.control.towards(wanted, self.turns_per_second)

    def _control_law(self) -> float:
        if not self.phase_connected:
            self._disarm()
            return 0.0
        torque, error = self.control.update(self.turns, self.turns_per_second)
        if error is not ControllerError.NONE:
            self.controller_error |= error
            self.fail(self._firmware.controller_errors[error])
        return torque


def _no_torque() -> float:
    return 0.0
