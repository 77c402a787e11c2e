"""Simulated RoboMaster C620 (M3508), C610 (M2006) and GM6020, written from the manuals' frame tables only.

How this works
--------------
There is nothing to arm: the first command frame moves the motor. What the controller does when commands stop is
not in any manual, so the worst case is simulated: it holds the last current for ever, also with its CAN cable cut.

A GM6020 is in the mode of its `options`, as if DJI's tool had set it, and deaf to the frames of the other. Its windings
are those of a DC motor: i = (V - k_e w) / R. The inductance is left out: L / R is below the substep of 1 ms, by the
figures of a reseller. R is what the data sheet's torque-speed line says, which has all that is lost, and not that of a
phase. In voltage mode V is the command's share of the supply; in current mode V is what the current needs, up to the
supply. Either way the current stays within the controller's own scale (unverified, of voltage mode).
"""

from collections.abc import Sequence
from math import copysign, floor, pi
from struct import Struct
from typing import NamedTuple

from drivers.contract import CanFrame
from replay.sim.controllers.contract import Clock, Emission, MotorSetup, Shaft

_COMMAND = Struct(">4h")  # torque current raw of four motors; RoboMaster C610 manual p. 8
_FEEDBACK = Struct(">HhhBx")  # rotor angle ticks, rotor rpm, torque current raw, temperature; C610 manual p. 9

_TICKS = 8192  # per rotor turn
_TICKS_PER_RADIAN = _TICKS / (2.0 * pi)
_RPM = 60.0 / (2.0 * pi)
_INT16 = 32767
_SPEED_FADE = 0.8  # share of the no-load speed from which the back-EMF eats the torque; source: ours


class Winding(NamedTuple):
    """A DC motor as its terminals see it."""

    speed_constant: float  # rad/s per V without a load
    resistance: float  # ohm


class Esc(NamedTuple):
    """What distinguishes the controllers; torque constant at the rotor."""

    command_ids: tuple[int, int]  # motors 1-4, the others
    feedback_id: int  # + motor id
    last_id: int
    full_scale_raw: int
    full_scale_current: float  # A
    torque_constant: float  # N m/A
    no_load_speed: float  # rad/s of the rotor at 24 V
    temperature: bool
    winding: Winding | None = None  # None: the torque fades towards the no-load speed, by our own rule
    takes_voltage: bool = False


# Torque constants and scales as in public RoboMaster code (0.3 N m/A after 3591/187; 0.18 N m/A after 36).
# No-load speeds (482 and 500 rpm at the output) are general knowledge, unverified; they only shape a runaway.
# GM6020: 741 mN m/A, 13.33 rpm/V, 320 rpm, +-3 A, and 156 rpm per N m, which is R / (k_t k_e): its manual, v1.4, as
# public code quotes it. Full scale of a voltage: 25000, see the reference; that of the current in feedback: [U].
_GM6020 = Esc(
    command_ids=(0x1FE, 0x2FE),
    feedback_id=0x204,
    last_id=7,
    full_scale_raw=16384,
    full_scale_current=3.0,
    torque_constant=0.741,
    no_load_speed=320 / _RPM,
    temperature=True,
    winding=Winding(13.33 / _RPM, 156 / _RPM * 0.741 / (13.33 / _RPM)),
)
ESCS = {
    "c620": Esc((0x200, 0x1FF), 0x200, 8, 16384, 20.0, 0.3 * 187 / 3591, 482 / _RPM * 3591 / 187, temperature=True),
    "c610": Esc((0x200, 0x1FF), 0x200, 8, 10000, 10.0, 0.18 / 36, 500 / _RPM * 36, temperature=False),
    "gm6020": _GM6020,
}
_MODES = {"current": _GM6020, "voltage": _GM6020._replace(command_ids=(0x1FF, 0x2FF), takes_voltage=True)}
_FULL_VOLTAGE_RAW = 25000
_USUAL_SUPPLY = 24.0  # V


def _esc(setup: MotorSetup) -> Esc:
    """The controller as it was set up. Raises ValueError."""
    if setup.variant not in ESCS:
        raise ValueError(f"motor {setup.name}: variant {setup.variant!r}: want {list(ESCS)}")
    esc = ESCS[setup.variant]
    if not 1 <= setup.id <= esc.last_id:
        raise ValueError(f"motor {setup.name}: id {setup.id}: want 1..{esc.last_id}")
    if esc.winding is None:
        return esc
    mode = setup.options.get("mode")
    if mode not in _MODES:
        raise ValueError(f"motor {setup.name}: options.mode {mode!r}: want {list(_MODES)}")
    return _MODES[str(mode)]


class SimulatedDji:
    """One controller with its motor. Faults: unplug/plug, power_off/power_on/power_cycle, encoder_frozen."""

    def __init__(self, setup: MotorSetup) -> None:
        esc = _esc(setup)
        self.setup = setup
        self.temperature_c = 30.0
        self.encoder_frozen = False  # angle stuck and, as it comes from the same sensor, rpm 0
        self.encoder_shift = 0.0  # rad that the sensor tells too much
        self.plugged = True
        self.powered = True
        self._esc = esc
        amperes_per_raw = esc.full_scale_current / esc.full_scale_raw
        self._torque_per_raw = amperes_per_raw * esc.torque_constant
        self._max_torque = setup.max_torque
        self._supply = setup.supply or _USUAL_SUPPLY
        self._full_scale = _FULL_VOLTAGE_RAW if esc.takes_voltage else esc.full_scale_raw
        self._command_id = esc.command_ids[(setup.id - 1) // 4]
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
            limit = self._full_scale
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
                frame = CanFrame(self.setup.bus, self._esc.feedback_id + self.setup.id, self._feedback())
                emissions.append(Emission(clock.due_ns, frame))
            clock.due_ns += clock.period_ns
        return emissions

    def step(self, shaft: Shaft, now_ns: int) -> float:
        """Torque of the held command, within what motor and back-EMF allow."""
        if self.encoder_frozen:
            self._seen = Shaft(self._seen.position, 0.0)
        else:
            self._seen = Shaft(shaft.position + self.encoder_shift, shaft.velocity) if self.encoder_shift else shaft
        if not self.powered:
            return 0.0
        winding = self._esc.winding
        torque = self._faded(shaft.velocity) if winding is None else self._torque(winding, shaft.velocity)
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

    def _faded(self, velocity: float) -> float:
        """That of a current, which the back-EMF eats towards the no-load speed."""
        torque = self._command_raw * self._torque_per_raw
        limit = self._max_torque
        if torque * velocity > 0.0:
            spare = (1.0 - abs(velocity) / self._esc.no_load_speed) / (1.0 - _SPEED_FADE)
            if spare < 1.0:
                limit *= max(0.0, spare)
        return copysign(limit, torque) if abs(torque) > limit else torque

    def _torque(self, winding: Winding, velocity: float) -> float:
        """That of the current that a voltage drives through the windings, or that the supply lets through."""
        esc, back_emf = self._esc, velocity / winding.speed_constant
        if esc.takes_voltage:
            volts = self._command_raw / _FULL_VOLTAGE_RAW * self._supply
        else:
            volts = self._command_raw / esc.full_scale_raw * esc.full_scale_current * winding.resistance + back_emf
            volts = max(-self._supply, min(self._supply, volts))
        current = (volts - back_emf) / winding.resistance
        return esc.torque_constant * max(-esc.full_scale_current, min(esc.full_scale_current, current))

    def _feedback(self) -> bytes:
        position, velocity = self._seen
        ticks = floor(position * _TICKS_PER_RADIAN) % _TICKS
        rpm = int(velocity * _RPM)
        if abs(rpm) > _INT16:
            rpm = int(copysign(_INT16, rpm))
        return _FEEDBACK.pack(ticks, rpm, round(self._measured_raw), self._temperature_byte())

    def _temperature_byte(self) -> int:
        return max(0, min(255, int(self.temperature_c))) if self._esc.temperature else 0
