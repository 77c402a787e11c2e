"""Simulated VESC (FOC, CAN mode "VESC"), written from the firmware's frame tables and behaviour only.

How this works
--------------
There is nothing to arm: the first command moves the motor, and every command feeds the timeout. When that expires the
motor is braked with `timeout_brake_current`, released where it is 0; the next command acts at once. A fault switches
the bridge off and ends by itself 500 ms after its cause; meanwhile nothing is obeyed. No status tells it, one asks.

The motor is electrical: what drives the current is the duty times the input voltage less the back-EMF, over the
resistance. Duty commands set that voltage; the other commands set the current, which takes whatever voltage there is.

Commissioned as the robot file says: pole pairs, minimum ERPM, current limit, status rate, timeout. STATUS_4 comes at
its default rate of 5 Hz. The tachometer starts at 0 with the supply, whatever the encoder is.
"""

from collections.abc import Callable, Sequence
from math import copysign, floor, pi
from struct import Struct

from drivers.contract import CanFrame
from replay.sim.controllers.contract import STEP_S, Clock, Emission, MotorSetup, Shaft

# Github vedderb/bldc: documentation/comm_can.md, comm/comm_can.c, comm/commands.c; all of it big-endian.
_VALUE = Struct(">i")
_STATUS = Struct(">ihh")  # ERPM; 0.1 A of motor current; 0.001 of duty
_STATUS_4 = Struct(">4h")  # 0.1 deg C bridge, motor; 0.1 A of input current; 0.02 deg
_STATUS_5 = Struct(">ih2x")  # sixths of an electrical turn; 0.1 V
_QUESTION = Struct(">BBBI")
_ANSWER = Struct(">BBBIB")

DUTY, CURRENT, BRAKE, RPM, CURRENT_REL = 0, 1, 2, 3, 10
_SHORT_BUFFER = 8
_PING, _PONG = 17, 18
_HARDWARE = 0  # HW_TYPE_VESC
_STATUS_ID, _STATUS_4_ID, _STATUS_5_ID = 9, 16, 27
_GET_VALUES_SELECTIVE = 50
_MASK_FAULT, _MASK_STATUS = 1 << 15, 1 << 21
_BROADCAST = 255
_SCALES = {DUTY: 1e5, CURRENT: 1e3, BRAKE: 1e3, RPM: 1.0, CURRENT_REL: 1e5}

# Defaults of the firmware: applications/appconf_default.h, motor/mcconf_default.h
_TIMEOUT_S = 1.0
_LEAST_CURRENT = 0.05  # A, cc_min_current: less releases the motor
_MAX_DUTY = 0.95
_FAULT_STOP_S = 0.5
_STATUS_4_HZ = 5.0
_HOT, _TOO_HOT = 85.0, 100.0  # deg C between which the current limit goes to 0
_LEAST_VOLTAGE = 8.0  # V
_TIMEOUT_CHECK_NS = 10_000_000  # timeout.c looks at it so often
UNDER_VOLTAGE, OVER_TEMP_FET = 2, 5

RESISTANCE = 0.05  # ohm, of the motor between two terminals; source: ours, a small outrunner of 500 rpm/V
INPUT_VOLTAGE = 24.0  # V
# Commissioned on the robot: the stock gains fit no motor.
_SPEED_BANDWIDTH = 60.0  # rad/s of the closed speed loop; source: ours
_INTEGRATOR_RATE = 10.0  # 1/s; source: ours

_INT16, _INT32 = 32767, 1 << 31


class SimulatedVesc:
    """One VESC with its motor. Faults: those of the contract, `raise_fault`, and the attributes that come first."""

    def __init__(self, setup: MotorSetup) -> None:
        if setup.variant != "vesc" or not 0 <= setup.id < _BROADCAST:
            raise ValueError(f"motor {setup.name}: variant {setup.variant!r} id {setup.id}: want vesc, 0..254")
        self.setup = setup
        self.input_voltage = INPUT_VOLTAGE
        self.resistance = RESISTANCE
        self.temperature_c = 30.0
        self.timeout_s = _TIMEOUT_S if setup.watchdog_s is None else setup.watchdog_s  # 0: none
        self.timeout_brake_current = 0.0  # A
        self.kill_switch = False
        self.condition = 0  # a fault code whose cause persists
        self.encoder_frozen = False  # tachometer stuck, ERPM 0
        self.encoder_shift = 0.0  # rad that the sensor tells too much
        self.plugged = True
        self.powered = True
        self._pole_pairs = int(setup.options["pole_pairs"])
        self._min_erpm = int(setup.options["min_erpm"])
        self._erpm_per_speed = 60.0 / (2.0 * pi) * self._pole_pairs
        self._counts_per_radian = 6 * self._pole_pairs / (2.0 * pi)
        self._torque_constant = setup.max_torque / setup.max_current  # N m/A, and V s/rad
        self._speed_gain = _SPEED_BANDWIDTH * setup.inertia / self._torque_constant  # A per rad/s
        self._reports: dict[int, Callable[[], bytes]] = {
            _STATUS_ID: self._status,
            _STATUS_5_ID: self._status_5,
            _STATUS_4_ID: self._status_4,
        }
        fast = Clock(setup.feedback_rate, setup.id)
        self._clocks = (((_STATUS_ID, _STATUS_5_ID), fast), ((_STATUS_4_ID,), Clock(_STATUS_4_HZ, setup.id)))
        self._laws = {
            DUTY: self._duty_law,
            CURRENT: self._current_law,
            BRAKE: self._brake_law,
            RPM: self._speed_law,
        }
        self._now_ns = 0
        self._sound = self._seen = Shaft(0.0, 0.0)
        self._origin = 0.0
        self._boot()

    def _boot(self) -> None:
        self._command = (CURRENT, 0.0)
        self._running = False  # the bridge switches
        self._integral = 0.0  # A
        self._current = 0.0
        self._duty = 0.0
        self._fault = 0
        self._fault_until_ns = 0
        self._fed_ns = self._now_ns
        self._timed_out = False
        self._timeout_check_ns = self._now_ns

    @property
    def acknowledges(self) -> bool:
        return self.plugged and self.powered

    def start(self, shaft: Shaft, now_ns: int) -> None:
        """Power on: nothing commanded, tachometer at 0."""
        self._now_ns = now_ns
        self._sound = self._seen = shaft
        self._origin = 0.0 if self.setup.absolute else shaft.position
        self._boot()
        for _, clock in self._clocks:
            clock.start(now_ns)

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        """A command to this VESC or to all of them; a question is answered at once."""
        command, at = frame.id >> 8, frame.id & 0xFF
        if not frame.extended or frame.remote or frame.fd or at not in (self.setup.id, _BROADCAST):
            return ()
        if not self.acknowledges:
            return ()
        if command == _SHORT_BUFFER:
            return self._answer(frame.data, now_ns)
        if command == _PING and frame.data:
            return (self._emission_to(frame.data[0], now_ns),)
        scale = _SCALES.get(command)
        if scale is not None and len(frame.data) >= _VALUE.size:
            self._fed_ns = now_ns
            self._obey(command, _VALUE.unpack_from(frame.data)[0] / scale)
        return ()

    def poll(self, now_ns: int) -> Sequence[Emission]:
        """Status messages due by now."""
        emissions = []
        for messages, clock in self._clocks:
            while clock.due_ns <= now_ns:
                if self.acknowledges:
                    emissions += [self._emission(clock.due_ns, at, self._reports[at]()) for at in messages]
                clock.due_ns += clock.period_ns
        return sorted(emissions, key=lambda emission: emission.ready_ns) if len(emissions) > 1 else emissions

    def step(self, shaft: Shaft, now_ns: int) -> float:
        """Timeout, faults, then the law of the command in force; the torque."""
        self._now_ns = now_ns
        self._sound = Shaft(shaft.position + self.encoder_shift, shaft.velocity) if self.encoder_shift else shaft
        self._seen = Shaft(self._seen.position, 0.0) if self.encoder_frozen else self._sound
        if not self.powered:
            return 0.0
        self._watch_timeout(now_ns)
        self._watch_faults(now_ns)
        self._current = 0.0
        if self._fault == 0 and not self.kill_switch:
            kind, value = self._command
            self._current = self._possible(self._laws[kind](value), shaft.velocity)
        else:
            self._running = False
        if not self._running:
            self._integral = 0.0
        emf = self._torque_constant * shaft.velocity
        self._duty = (emf + self.resistance * self._current) / self.input_voltage if self._running else 0.0
        return self._current * self._torque_constant

    def raise_fault(self, code: int) -> None:
        """A fault whose cause is over at once."""
        self._fault = code
        self._fault_until_ns = self._now_ns + int(_FAULT_STOP_S * 1e9)

    def unplug(self) -> None:
        """Cut the CAN cable: silent and deaf; the timeout goes on."""
        self.plugged = False

    def plug(self) -> None:
        self.plugged = True

    def power_off(self) -> None:
        """Cut the supply: silent, no torque."""
        self.powered = False
        self._boot()

    def power_on(self) -> None:
        """Boot: the tachometer starts at 0."""
        self.powered = True
        self._seen = self._sound
        self._origin = 0.0 if self.setup.absolute else self._sound.position
        self._boot()

    def power_cycle(self) -> None:
        self.power_off()
        self.power_on()

    def freeze_encoder(self, frozen: bool) -> None:
        """Tachometer stuck, ERPM 0."""
        self.encoder_frozen = frozen

    def shift_encoder(self, angle: float) -> None:
        """So many radians of the shaft more than before."""
        self.encoder_shift += angle

    # -- commands -----------------------------------------------------------------------------------------------------

    def _obey(self, command: int, value: float) -> None:
        if self._fault or self.kill_switch:
            return
        if command == CURRENT_REL:
            command, value = CURRENT, value * self.setup.max_current
        if command != self._command[0]:
            self._integral = 0.0
        self._command = (command, value)
        if command in (CURRENT, BRAKE):
            self._running = abs(value) >= _LEAST_CURRENT
        elif command == RPM:
            self._running = self._running or abs(value) >= self._min_erpm
        else:
            self._running = True

    def _duty_law(self, duty: float) -> float:
        return self._current_at(_clamp(duty, _MAX_DUTY) * self.input_voltage)

    def _current_law(self, current: float) -> float:
        return current

    def _brake_law(self, current: float) -> float:
        """Against the motion; of a slow motor the shorted windings brake, with what its back-EMF drives."""
        return _clamp(self._current_at(0.0), abs(current))

    def _speed_law(self, erpm: float) -> float:
        """A PI speed loop. Below the minimum a running motor is braked with a duty of 0, and a released one left."""
        if abs(erpm) < self._min_erpm:
            self._integral = 0.0
            return self._current_at(0.0)
        error = erpm / self._erpm_per_speed - self._seen.velocity
        wanted = self._speed_gain * error + self._integral
        limit = self._current_limit()
        if abs(wanted) < limit:
            self._integral += self._speed_gain * _INTEGRATOR_RATE * STEP_S * error
        return _clamp(wanted, limit)

    def _current_at(self, voltage: float) -> float:
        """What flows with this voltage at the motor; a motor whose sensor is stuck is believed to stand."""
        return (voltage - self._torque_constant * self._sound.velocity) / self.resistance

    def _possible(self, current: float, velocity: float) -> float:
        """Of a current what limits and input voltage allow."""
        if not self._running:
            return 0.0
        limit = self._current_limit()
        most, emf = _MAX_DUTY * self.input_voltage, self._torque_constant * velocity
        low, high = (-most - emf) / self.resistance, (most - emf) / self.resistance
        return _clamp(max(low, min(high, current)), limit)

    def _current_limit(self) -> float:
        cool = (_TOO_HOT - self.temperature_c) / (_TOO_HOT - _HOT)
        return self.setup.max_current * max(0.0, min(1.0, cool))

    def _watch_timeout(self, now_ns: int) -> None:
        if now_ns < self._timeout_check_ns:
            return
        self._timeout_check_ns = now_ns + _TIMEOUT_CHECK_NS
        self._timed_out = self.timeout_s > 0.0 and now_ns - self._fed_ns > self.timeout_s * 1e9
        if self._timed_out:
            self._obey(BRAKE, self.timeout_brake_current)

    def _watch_faults(self, now_ns: int) -> None:
        cause = self.condition
        if self.input_voltage < _LEAST_VOLTAGE:
            cause = UNDER_VOLTAGE
        elif self.temperature_c >= _TOO_HOT:
            cause = OVER_TEMP_FET
        if cause:
            self.raise_fault(cause)
        elif self._fault and now_ns >= self._fault_until_ns:
            self._fault = 0

    # -- what it says -------------------------------------------------------------------------------------------------

    def _answer(self, data: bytes, now_ns: int) -> Sequence[Emission]:
        """COMM_GET_VALUES_SELECTIVE of one value, as far as the answer fits one frame."""
        if len(data) != _QUESTION.size:
            return ()
        host, what, packet, mask = _QUESTION.unpack(data)
        if (what, packet) != (0, _GET_VALUES_SELECTIVE) or mask not in (_MASK_FAULT, _MASK_STATUS):
            return ()
        value = self._fault if mask == _MASK_FAULT else self._timed_out | self.kill_switch << 1
        answer = _ANSWER.pack(self.setup.id, 1, _GET_VALUES_SELECTIVE, mask, value)
        return (Emission(now_ns, CanFrame(self.setup.bus, _SHORT_BUFFER << 8 | host, answer, extended=True)),)

    def _emission_to(self, host: int, now_ns: int) -> Emission:
        """The answer to a ping of this host."""
        frame = CanFrame(self.setup.bus, _PONG << 8 | host, bytes((self.setup.id, _HARDWARE)), extended=True)
        return Emission(now_ns, frame)

    def _emission(self, ready_ns: int, message: int, data: bytes) -> Emission:
        return Emission(ready_ns, CanFrame(self.setup.bus, message << 8 | self.setup.id, data, extended=True))

    def _status(self) -> bytes:
        erpm = int(_clamp(self._seen.velocity * self._erpm_per_speed, _INT32 - 1))
        return _STATUS.pack(erpm, _int16(self._current * 10.0), _int16(self._duty * 1000.0))

    def _status_4(self) -> bytes:
        heat = _int16(self.temperature_c * 10.0)
        return _STATUS_4.pack(heat, heat, _int16(self._current * self._duty * 10.0), 0)

    def _status_5(self) -> bytes:
        counts = floor((self._seen.position - self._origin) * self._counts_per_radian)
        return _STATUS_5.pack((counts + _INT32) % (2 * _INT32) - _INT32, _int16(self.input_voltage * 10.0))


def _clamp(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


def _int16(value: float) -> int:
    """As a C cast truncates it; beyond the range saturated."""
    return int(value) if abs(value) <= _INT16 else int(copysign(_INT16, value))
