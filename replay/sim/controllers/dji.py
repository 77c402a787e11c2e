"""Simulated RoboMaster C620 (M3508) and C610 (M2006), written from the manuals' frame tables only.

How this works
--------------
There is nothing to arm: the first command frame moves the motor. What the controller does when commands stop is
not in any manual, so the worst case is simulated: it holds the last current for ever, also with its CAN cable cut.
"""

from collections.abc import Sequence
from math import copysign, floor, pi
from struct import Struct
from typing import NamedTuple

from drivers.contract import CanFrame
from replay.sim.controllers.contract import Clock, Emission, MotorSetup, Shaft

_COMMAND = Struct(">4h")  # torque current raw of four motors; RoboMaster C610 manual p. 8
_FEEDBACK = Struct(">HhhBx")  # rotor angle ticks, rotor rpm, torque current raw, temperature; C610 manual p. 9

_FIRST_COMMAND_ID, _SECOND_COMMAND_ID = 0x200, 0x1FF  # motors 1-4, motors 5-8
_FEEDBACK_ID = 0x200  # + motor id
_TICKS = 8192  # per rotor turn
_TICKS_PER_RADIAN = _TICKS / (2.0 * pi)
_RPM = 60.0 / (2.0 * pi)
_INT16 = 32767
_SPEED_FADE = 0.8  # share of the no-load speed from which the back-EMF eats the torque; source: ours


class Esc(NamedTuple):
    """What distinguishes the two controllers; torque constant at the rotor."""

    full_scale_raw: int
    full_scale_current: float  # A
    torque_constant: float  # N m/A
    no_load_speed: float  # rad/s of the rotor at 24 V
    temperature: bool


# Torque constants and scales as in public RoboMaster code (0.3 N m/A after 3591/187; 0.18 N m/A after 36).
# No-load speeds (482 and 500 rpm at the output) are general knowledge, unverified; they only shape a runaway.
ESCS = {
    "c620": Esc(16384, 20.0, 0.3 * 187 / 3591, 482 / _RPM * 3591 / 187, temperature=True),
    "c610": Esc(10000, 10.0, 0.18 / 36, 500 / _RPM * 36, temperature=False),
}


class SimulatedDji:
    """One C620 or C610 with its motor. Faults: unplug/plug, power_off/power_on/power_cycle, encoder_frozen."""

    def __init__(self, setup: MotorSetup) -> None:
        if setup.variant not in ESCS or not 1 <= setup.id <= 8:
            raise ValueError(f"motor {setup.name}: variant {setup.variant!r} id {setup.id}: want {list(ESCS)}, 1..8")
        self.setup = setup
        self.temperature_c = 30.0
        self.encoder_frozen = False  # angle stuck and, as it comes from the same sensor, rpm 0
        self.encoder_shift = 0.0  # rad that the sensor tells too much
        self.plugged = True
        self.powered = True
        self._esc = ESCS[setup.variant]
        amperes_per_raw = self._esc.full_scale_current / self._esc.full_scale_raw
        self._torque_per_raw = amperes_per_raw * self._esc.torque_constant
        self._max_torque = setup.max_torque
        self._command_id = _FIRST_COMMAND_ID if setup.id <= 4 else _SECOND_COMMAND_ID
        self._slot = (setup.id - 1) % 4
        self._clock = Clock(setup.feedback_rate, setup.id)
        self._command_raw = 0
        self._measured_raw = 0.0
        self._seen = Shaft(0.0, 0.0)

    @property
    def acknowledges(self) -> bool:
        return self.plugged and self.powered

    def start(self, shaft: Shaft, now_ns: int) -> None:
        """Power on: no command yet; the angle is absolute within one rotor turn."""
        self._command_raw = 0
        self._measured_raw = 0.0
        self._seen = shaft
        self._clock.start(now_ns)

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        """Take our slot of a command frame; beyond full scale saturates."""
        if (
            frame.id != self._command_id
            or frame.extended
            or frame.remote
            or frame.fd
            or len(frame.data) != _COMMAND.size
        ):
            return ()
        if self.acknowledges:
            limit = self._esc.full_scale_raw
            self._command_raw = max(-limit, min(limit, _COMMAND.unpack(frame.data)[self._slot]))
        return ()

    def poll(self, now_ns: int) -> Sequence[Emission]:
        """Feedback frames due by now."""
        clock = self._clock
        if clock.due_ns > now_ns:
            return ()
        emissions = []
        while clock.due_ns <= now_ns:
            if self.acknowledges:
                frame = CanFrame(self.setup.bus, _FEEDBACK_ID + self.setup.id, self._feedback())
                emissions.append(Emission(clock.due_ns, frame))
            clock.due_ns += clock.period_ns
        return emissions

    def step(self, shaft: Shaft, now_ns: int) -> float:
        """Torque of the held current command, within what motor and back-EMF allow."""
        if self.encoder_frozen:
            self._seen = Shaft(self._seen.position, 0.0)
        else:
            self._seen = Shaft(shaft.position + self.encoder_shift, shaft.velocity) if self.encoder_shift else shaft
        if not self.powered:
            return 0.0
        esc = self._esc
        torque = self._command_raw * self._torque_per_raw
        limit = self._max_torque
        if torque * shaft.velocity > 0.0:
            spare = (1.0 - abs(shaft.velocity) / esc.no_load_speed) / (1.0 - _SPEED_FADE)
            if spare < 1.0:
                limit *= max(0.0, spare)
        if abs(torque) > limit:
            torque = copysign(limit, torque)
        self._measured_raw = torque / self._torque_per_raw
        return torque

    def unplug(self) -> None:
        """Cut the CAN cable: silent and deaf, but the last command stays in force."""
        self.plugged = False

    def plug(self) -> None:
        self.plugged = True

    def power_off(self) -> None:
        """Cut the supply: silent, no torque, command forgotten."""
        self.powered = False
        self._command_raw = 0
        self._measured_raw = 0.0

    def power_on(self) -> None:
        """Restore the supply; only the angle within one turn survives, and that is all the frame ever had."""
        self.powered = True

    def power_cycle(self) -> None:
        self.power_off()
        self.power_on()

    def freeze_encoder(self, frozen: bool) -> None:
        """Angle stuck, rpm 0."""
        self.encoder_frozen = frozen

    def shift_encoder(self, angle: float) -> None:
        """So many radians of the rotor more than before."""
        self.encoder_shift += angle

    def _feedback(self) -> bytes:
        position, velocity = self._seen
        ticks = floor(position * _TICKS_PER_RADIAN) % _TICKS
        rpm = int(velocity * _RPM)
        if abs(rpm) > _INT16:
            rpm = int(copysign(_INT16, rpm))
        return _FEEDBACK.pack(ticks, rpm, round(self._measured_raw), self._temperature_byte())

    def _temperature_byte(self) -> int:
        return max(0, min(255, int(self.temperature_c))) if self._esc.temperature else 0
