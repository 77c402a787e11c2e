"""Simulated ODrive with CANSimple, firmware 0.5 and 0.6: the frames. What they act on is in `odrive_axis`.

Parameters and node ids written over CAN live in RAM: a power cycle forgets them unless they were saved (Reboot 1).
That is the device's behaviour and the driver's worst case. 0.5 has no Sdo: its watchdog counts as set over USB and
saved, and is enabled when the robot file gives one. A write is confirmed by a TxSdo from 0.6.11 on (github
odriverobotics/ODriveResources, examples/can_param_access.py). Assumed: no reply to a read of an unknown endpoint;
another rate of a cyclic message acts at once, another bit rate from the next start on; nothing cyclic from one that has
no node id.
"""

from collections.abc import Callable, Sequence
from zlib import crc32

from drivers.contract import CanFrame
from replay.sim.controllers import odrive_tables as wire
from replay.sim.controllers.contract import Clock, Emission, MotorSetup, Shaft
from replay.sim.controllers.odrive_axis import OdriveAxis
from replay.sim.controllers.odrive_parameters import (
    BAUD_RATE,
    BUS_VOLTAGE_MS,
    ENCODER_MS,
    HEARTBEAT_MS,
    TEMPERATURE_MS,
    TORQUES_MS,
)
from replay.sim.controllers.odrive_tables import Command

BOOT_NS = 500_000_000  # after a Reboot; source: ours
CONFIRMS_FROM = (0, 6, 11)
_RATES = {
    Command.HEARTBEAT: HEARTBEAT_MS,
    Command.GET_ENCODER_ESTIMATES: ENCODER_MS,
    Command.GET_TORQUES_06: TORQUES_MS,
    Command.GET_TEMPERATURE_06: TEMPERATURE_MS,
    Command.GET_BUS_VOLTAGE_CURRENT: BUS_VOLTAGE_MS,
}
_Handler = tuple[int, Callable[[bytes], None]]  # least payload, what to do


class SimulatedODrive:
    """One node. Faults: unplug/plug, power_off/power_on/power_cycle, raise_error, and the switches of `axis`."""

    def __init__(self, setup: MotorSetup) -> None:
        known = list(wire.FIRMWARES)
        if setup.variant not in known or not 0 <= setup.id < wire.BROADCAST_NODE:
            raise ValueError(f"motor {setup.name}: variant {setup.variant!r} id {setup.id}: want {known}, 0..62")
        self.setup = setup
        self.serial = crc32(setup.name.encode())
        self.node = self._kept_node = setup.id
        self.bus_voltage = 48.0
        self.temperature_c = 30.0
        self.plugged = True
        self.powered = True
        self._firmware = wire.FIRMWARES[setup.variant]
        told = str(setup.options.get("endpoints_of", ""))
        firmware, hardware = told.split() if told else (setup.options.get("firmware"), None)
        self._version = _three(str(firmware or wire.DEFAULT_FIRMWARE))
        self._hardware = _three(hardware or wire.DEFAULT_HARDWARE)
        own_cyclic = ((Command.HEARTBEAT, wire.HEARTBEAT_HZ), (Command.GET_ENCODER_ESTIMATES, setup.feedback_rate))
        cyclic = (*own_cyclic, *self._firmware.slow_cyclic)
        self._clocks = tuple((command, Clock(hz, setup.id)) for command, hz in cyclic)
        self._rates_ms = {_RATES[command]: 1e3 / hz for command, hz in cyclic if command in _RATES and hz is not None}
        self.axis = OdriveAxis(setup, self._firmware, self._rates_ms)
        self.answers_sdo = True
        self._baud_rate = self.axis.parameters[BAUD_RATE]
        self._booted_ns = 0
        self._now_ns = 0
        self._next_due_ns = 0
        self._handlers = self._handler_table()
        self._reports = self._report_table() | (self._reports_05() if self._firmware.legacy else self._reports_06())
        self._sdo_reply: bytes | None = None

    @property
    def acknowledges(self) -> bool:
        here = self.setup.bitrate in (None, self._baud_rate) and self._now_ns >= self._booted_ns
        return self.plugged and self.powered and here

    def start(self, shaft: Shaft, now_ns: int) -> None:
        """Power on in IDLE; the reading starts at the given shaft angle."""
        self._now_ns = now_ns
        self.axis.place(shaft, now_ns)
        for _, clock in self._clocks:
            clock.start(now_ns)
        self._next_due_ns = now_ns

    def receive(self, frame: CanFrame, now_ns: int) -> Sequence[Emission]:
        """Take a frame to our node; a request is answered at once."""
        self._now_ns = now_ns
        node, command = frame.id >> wire.NODE_SHIFT, frame.id & wire.COMMAND_MASK
        if frame.extended or node not in (self.node, wire.BROADCAST_NODE) or not self.acknowledges:
            return ()
        if self._firmware.legacy or command in wire.SETPOINTS:
            self.axis.feed_watchdog(now_ns)
        if frame.remote or (self._firmware.legacy and not frame.data and command in self._reports):
            report = self._reports.get(command)
            return () if report is None else (self._emission(command, report(), now_ns),)
        least, handle = self._handlers.get(command, (0, _ignore))
        if len(frame.data) >= least:
            handle(frame.data)
        if self._sdo_reply is None:
            return ()
        reply, self._sdo_reply = self._sdo_reply, None
        return (self._emission(Command.TX_SDO_06, reply, now_ns),)

    def poll(self, now_ns: int) -> Sequence[Emission]:
        """Cyclic frames due by now."""
        self._now_ns = now_ns
        if now_ns < self._next_due_ns:
            return ()
        emissions = []
        for command, clock in self._clocks:
            while clock.due_ns <= now_ns:
                emissions.append(self._emission(command, self._reports[command](), clock.due_ns))
                clock.due_ns += clock.period_ns
        self._next_due_ns = min((clock.due_ns for _, clock in self._clocks), default=now_ns + BOOT_NS)
        return sorted(emissions) if self.acknowledges and self.node != wire.BROADCAST_NODE else ()

    def step(self, shaft: Shaft, now_ns: int) -> float:
        """One control period of the axis."""
        return self.axis.step(shaft, now_ns, powered=self.powered)

    def raise_error(self, axis: int, *, motor: int = 0, encoder: int = 0, controller: int = 0) -> None:
        """A fault that is over at once but stays latched; the detail words exist in 0.5 only."""
        self.axis.motor_error |= motor
        self.axis.encoder_error |= encoder
        self.axis.controller_error |= controller
        self.axis.fail(axis)

    def unplug(self) -> None:
        """Cut the CAN cable: silent and deaf; motor and watchdog carry on."""
        self.plugged = False

    def plug(self) -> None:
        self.plugged = True

    def power_off(self) -> None:
        """Cut the supply: silent, no torque."""
        self.powered = False

    def power_on(self) -> None:
        """Boot: IDLE, no errors, position 0 unless the encoder is absolute, saved parameters only."""
        self.powered = True
        self.node = self._kept_node
        self._booted_ns = 0
        self.axis.reboot()
        self._baud_rate = self.axis.parameters[BAUD_RATE]
        self._follow_rates()

    def power_cycle(self) -> None:
        self.power_off()
        self.power_on()

    def freeze_encoder(self, frozen: bool) -> None:
        """Position stuck, velocity 0."""
        self.axis.encoder_frozen = frozen

    def shift_encoder(self, angle: float) -> None:
        """So many radians of the shaft more than before."""
        self.axis.encoder_shift += angle

    def _emission(self, command: int, data: bytes, ready_ns: int) -> Emission:
        return Emission(ready_ns, CanFrame(self.setup.bus, self.node << wire.NODE_SHIFT | command, data))

    # -- host to device ----------------------------------------------------------------------------------------------

    def _handler_table(self) -> dict[int, _Handler]:
        table: dict[int, _Handler] = {
            Command.ESTOP: (0, lambda _: self.axis.estop()),
            Command.SET_AXIS_STATE: (4, lambda data: self.axis.request(wire.U32.unpack_from(data)[0])),
            Command.SET_CONTROLLER_MODE: (8, self._set_controller_mode),
            Command.SET_INPUT_POS: (8, self._set_input_position),
            Command.SET_INPUT_VEL: (8, self._set_input_velocity),
            Command.SET_INPUT_TORQUE: (4, self._set_input_torque),
            Command.SET_LIMITS: (8, self._set_limits),
            Command.REBOOT: (0, self._reboot),
            Command.CLEAR_ERRORS: (0, lambda _: self.axis.clear_errors()),
        }
        if self._firmware.legacy:
            return table
        absolute: _Handler = (4, lambda data: self.axis.set_position(wire.FLOAT.unpack_from(data)[0]))
        return table | {
            Command.RX_SDO_06: (wire.SDO.size, self._sdo),
            Command.SET_ABSOLUTE_POSITION_06: absolute,
            Command.ADDRESS_06: (1 + wire.SERIAL_BYTES, self._take_address),
        }

    def _set_controller_mode(self, data: bytes) -> None:
        self.axis.control.control_mode, self.axis.control.input_mode = wire.TWO_U32.unpack_from(data)
        self.axis.control.hold(self.axis.turns)

    def _set_input_position(self, data: bytes) -> None:
        control = self.axis.control
        control.input_position, velocity_milli, torque_milli = wire.INPUT_POSITION.unpack_from(data)
        control.input_velocity, control.input_torque = velocity_milli * 1e-3, torque_milli * 1e-3

    def _set_input_velocity(self, data: bytes) -> None:
        self.axis.control.input_velocity, self.axis.control.input_torque = wire.TWO_FLOATS.unpack_from(data)

    def _set_input_torque(self, data: bytes) -> None:
        (self.axis.control.input_torque,) = wire.FLOAT.unpack_from(data)

    def _set_limits(self, data: bytes) -> None:
        self.axis.control.velocity_limit, self.axis.control.current_limit = wire.TWO_FLOATS.unpack_from(data)

    def _reboot(self, data: bytes) -> None:
        """0: reboot, 1: save and reboot, 2: erase and reboot; 0.5 knows only the first."""
        action = 0 if self._firmware.legacy or not data else data[0]
        if action == 1:
            self._kept_node = self.node
            self.axis.parameters.save()
        if action == 2:
            self.axis.parameters.erase()
        self.power_cycle()
        self._booted_ns = self._now_ns + BOOT_NS

    def _take_address(self, data: bytes) -> None:
        """A node id for us, or for another one, which ours is then no more."""
        if int.from_bytes(data[1 : 1 + wire.SERIAL_BYTES], "little") == self.serial:
            self.node = data[0]
        elif data[0] == self.node:
            self.node = wire.BROADCAST_NODE

    def _sdo(self, data: bytes) -> None:
        if not self.answers_sdo:
            return
        opcode, endpoint, _ = wire.SDO.unpack_from(data)
        if opcode == wire.SDO_WRITE:
            self.axis.parameters.write(endpoint, data[wire.SDO.size :])
            self._follow_rates()
            if self._version < CONFIRMS_FROM:
                return
        value = self.axis.parameters.read(endpoint)
        if value is not None:
            self._sdo_reply = wire.SDO_REPLY.pack(endpoint, value)

    def flat_endpoints(self) -> dict[str, object]:
        """What the vendor's file of this firmware and hardware says."""
        versions = {"fw_version": self._version, "hw_version": self._hardware}
        told = {key: ".".join(map(str, version)) for key, version in versions.items()}
        return told | {"endpoints": self.axis.parameters.document()}

    def _follow_rates(self) -> None:
        """Cyclic messages whose parameter has changed begin anew; 0 ms: none."""
        parameters = self.axis.parameters
        if self._firmware.legacy or all(parameters[name] == ms for name, ms in self._rates_ms.items()):
            return
        self._rates_ms = {name: parameters[name] for name in _RATES.values()}
        rates = {command: self._rates_ms[name] for command, name in _RATES.items()}
        self._clocks = tuple((command, Clock(1e3 / ms, self.setup.id)) for command, ms in rates.items() if ms > 0.0)
        for _, clock in self._clocks:
            clock.start(self._now_ns)
        self._next_due_ns = self._now_ns

    # -- device to host ----------------------------------------------------------------------------------------------

    def _report_table(self) -> dict[int, Callable[[], bytes]]:
        axis, pack = self.axis, wire.TWO_FLOATS.pack
        return {
            Command.GET_ENCODER_ESTIMATES: lambda: pack(*axis.estimates),
            Command.GET_IQ: lambda: pack(*(axis.torque / axis.control.torque_constant,) * 2),
            Command.GET_BUS_VOLTAGE_CURRENT: lambda: pack(self.bus_voltage, axis.mechanical_power / self.bus_voltage),
        }

    def _reports_06(self) -> dict[int, Callable[[], bytes]]:
        axis, floats = self.axis, wire.TWO_FLOATS.pack
        version = wire.VERSION.pack(wire.PROTOCOL, *self._hardware, *self._version, 0)
        return {
            Command.GET_VERSION: lambda: version,
            Command.ADDRESS_06: lambda: bytes([self.node]) + self.serial.to_bytes(wire.SERIAL_BYTES, "little"),
            Command.HEARTBEAT: lambda: wire.HEARTBEAT.pack(axis.errors, axis.state, axis.result, 0, 0),
            Command.GET_ERROR: lambda: wire.TWO_U32.pack(axis.errors, axis.disarm_reason),
            Command.GET_TEMPERATURE_06: lambda: floats(self.temperature_c, self.temperature_c),
            Command.GET_TORQUES_06: lambda: floats(axis.torque, axis.torque),
        }

    def _reports_05(self) -> dict[int, Callable[[], bytes]]:
        axis = self.axis
        return {
            Command.HEARTBEAT: self._heartbeat_05,
            Command.GET_ERROR: lambda: wire.U64.pack(axis.motor_error),
            Command.GET_ENCODER_ERROR_05: lambda: wire.TWO_U32.pack(axis.encoder_error, 0),
            Command.GET_SENSORLESS_ERROR_05: lambda: wire.TWO_U32.pack(0, 0),
            Command.GET_CONTROLLER_ERROR_05: lambda: wire.TWO_U32.pack(axis.controller_error, 0),
        }

    def _heartbeat_05(self) -> bytes:
        axis = self.axis
        controller = wire.TRAJECTORY_DONE_05 | (axis.controller_error != 0)
        flags = (axis.motor_error != 0, axis.encoder_error != 0, controller)
        return wire.HEARTBEAT.pack(axis.errors, axis.state, *flags)


def _three(version: str) -> tuple[int, int, int]:
    major, minor, revision = map(int, version.split("."))
    return major, minor, revision


def _ignore(_data: bytes) -> None:
    """Commands that are not simulated."""
