"""ODrive controllers over CANSimple: velocity, torque, brake (velocity 0 in closed loop) and coast (axis IDLE).

Firmware 0.5 and 0.6, 11-bit ids. The messages are in odrive_tables, the firmware lines in odrive_firmware, one axis
in odrive_axis and its bring-up in odrive_bringup; here is the group of axes on one bus.
"""

from collections.abc import Callable, Collection, Sequence
from math import isnan
from typing import Any, ClassVar, Final

from drivers.checks import check_count, check_specs, measuring_hz
from drivers.contract import (
    CanFrame,
    Capabilities,
    DecodedFrame,
    IdUse,
    MotorFeedback,
    MotorSpec,
    MotorState,
    ReceiveFilter,
    Renaming,
    Traffic,
)
from drivers.odrive import renaming, sighting, tables
from drivers.odrive.axis import Axis, Step
from drivers.odrive.bringup import advance
from drivers.odrive.firmware import FIRMWARES, every_word
from drivers.odrive.tables import AxisState, Control
from drivers.records import maker
from drivers.setpoint import CommandKind, MotorCommand
from drivers.sighting import Sighting

_made: Final = maker(MotorFeedback)
# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_SILENT: Final = MotorState.SILENT
_FAULT: Final = MotorState.FAULT
_OPERATIONAL: Final = MotorState.OPERATIONAL
_IDLE: Final = MotorState.IDLE
_STARTING: Final = MotorState.STARTING

NODES: Final = range(63)  # 0x3F is the address of controllers that have none yet
NODE_MASK: Final = 0x7FF & ~tables.COMMAND_MASK
HEARTBEAT_RATE_HZ: Final = 10.0  # firmware default

CONTROLS: Final[dict[CommandKind, Control | None]] = {
    CommandKind.COAST: None,
    CommandKind.BRAKE: Control.VELOCITY,
    CommandKind.VELOCITY: Control.VELOCITY,
    CommandKind.TORQUE: Control.TORQUE,
}

_ACTIVE: Final = Step.ACTIVE
_Route = tuple[Callable[[bytes], tuple[Any, ...]], int, int, Callable[[tuple[Any, ...], int], None]]


class OdriveDriver:
    """The ODrive axes of one bus."""

    __slots__ = ("_axes", "_bus", "_by_node", "_routes")

    variants: ClassVar[tuple[str, ...]] = tuple(FIRMWARES)
    words: ClassVar[tuple[str, ...]] = every_word()

    def __init__(self, bus: str, motors: Sequence[MotorSpec]) -> None:
        check_specs(motors, driver="odrive", variants=self.variants, ids=NODES)
        self._bus = bus
        self._axes = tuple(Axis(bus, motor) for motor in motors)
        self._by_node = {axis.spec.id: axis for axis in self._axes}
        self._routes: dict[int, _Route] = {
            identifier: (message.layout.unpack, message.needed, message.layout.size, take)
            for axis in self._axes
            for identifier, (message, take) in axis.receivers().items()
        }

    @staticmethod
    def sighted(frame: CanFrame) -> list[Sighting]:
        """What this frame is to an ODrive."""
        found = sighting.sighted(frame)
        return [] if found is None else [found]

    @staticmethod
    def questions(bus: str, heard: Collection[int]) -> list[CanFrame]:
        """For the firmware of those that were heard."""
        return sighting.questions(bus, heard)

    @staticmethod
    def renaming(variant: str) -> Renaming:
        """By serial number from firmware 0.6 on; an older one is set over USB."""
        return Renaming(NODES, renaming.OVER_CAN if variant == "0.6" else renaming.over_usb)

    @property
    def capabilities(self) -> tuple[Capabilities, ...]:
        """Velocity with a torque added, torque and brake; a watchdog only where it can be read back.

        No limit with a command: Set_Limits is a frame of its own that nobody confirms, so one that is lost would
        leave too little torque to brake with; and a limit below the current that flows is a fault that disarms.
        """
        return tuple(
            Capabilities(
                velocity=True,
                torque=True,
                brake=True,
                feed_forward=True,
                device_watchdog=axis.firmware.tells_version,
            )
            for axis in self._axes
        )

    def receive(self, frame: CanFrame) -> bool:
        """Take one received frame; True when it was ours."""
        bus, identifier, data, extended, remote, received_ns, fd, _ = frame
        route = self._routes.get(identifier)
        if route is None or received_ns is None or extended or remote or fd or bus != self._bus:
            return False
        unpack, needed, size, take = route
        length = len(data)
        if length != size:
            if length < needed:
                return False
            data = data[:size].ljust(size, b"\0")
        take(unpack(data), received_ns)
        return True

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        """Advance every axis towards its command; one setpoint per axis, and what bring-up needs."""
        check_count(commands, self._axes)
        frames: list[CanFrame] = []
        for axis, command in zip(self._axes, commands):
            kind, value, feed_forward, limit = command.kind, command.value, command.feed_forward, command.limit
            if kind is not axis.kind or isnan(value) or feed_forward != 0.0 or limit is not None:
                _accept(axis, command)
            if (
                axis.step is _ACTIVE
                and axis.control is axis.wanted
                and now_ns < axis.heartbeat_until_ns
                and now_ns < axis.measured_until_ns
            ):
                frames.append(axis.setpoint(kind, value, feed_forward))
                continue
            frames += advance(axis, now_ns)
            frames.append(axis.zero_frame)
        return frames

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        """The latest measurement and state of each axis."""
        return [_feedback(axis, now_ns) for axis in self._axes]

    def clear_faults(self) -> None:
        """Forget latched faults; Clear_Errors goes out with the next command. Arms nothing."""
        for axis in self._axes:
            axis.clear_fault()

    def coast_frames(self) -> list[CanFrame]:
        """Frames that release every axis, and leave no setpoint behind."""
        frames: list[CanFrame] = []
        for axis in self._axes:
            frames += (axis.frame(tables.SET_AXIS_STATE, AxisState.IDLE), axis.zero_frame)
        return frames

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """Velocity 0: an axis in velocity control brakes, in torque control it gets torque 0; IDLE ones stay so."""
        return [axis.zero_frame for axis in self._axes]

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A sent or received frame in words, or None when it is not of these axes or too short."""
        axis = self._by_node.get(frame.id >> tables.NODE_SHIFT)
        if axis is None or frame.extended or frame.fd or frame.bus != self._bus:
            return None
        command = frame.id & tables.COMMAND_MASK
        asked = axis.firmware.from_device.get(command)
        if frame.remote:
            return None if asked is None else DecodedFrame(axis.spec.name, f"{asked.name} request", ())
        message = asked or axis.firmware.to_device.get(command)
        if message is None:
            return None
        values = message.values(frame.data)
        return None if values is None else DecodedFrame(axis.spec.name, message.name, values)

    def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
        """Setpoint, encoder estimates and heartbeat of each axis; what else is set to be cyclic is not known here."""
        traffic: list[Traffic] = []
        for axis in self._axes:
            name, rate = axis.spec.name, measuring_hz(axis.spec)
            traffic += (
                Traffic(f"{name} setpoint", extended=False, length=8, rate_hz=loop_rate_hz),
                Traffic(f"{name} Get_Encoder_Estimates", extended=False, length=8, rate_hz=rate),
                Traffic(f"{name} Heartbeat", extended=False, length=8, rate_hz=HEARTBEAT_RATE_HZ),
            )
        return tuple(traffic)

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """Every message of these axes, also what another host sends to them."""
        return tuple(ReceiveFilter(node << tables.NODE_SHIFT, NODE_MASK, extended=False) for node in self._by_node)

    def ids(self) -> tuple[IdUse, ...]:
        """Every message of each node: what is not in use by us would still mean something to the controller."""
        return tuple(
            IdUse(f"odrive node {node} of motor {axis.spec.name}", node << tables.NODE_SHIFT, NODE_MASK, extended=False)
            for node, axis in self._by_node.items()
        )


def _accept(axis: Axis, command: MotorCommand) -> None:
    kind, value, feed_forward, limit = command.kind, command.value, command.feed_forward, command.limit
    helped = feed_forward != 0.0 and kind is not CommandKind.VELOCITY
    if isnan(value) or isnan(feed_forward) or helped or limit is not None or kind not in CONTROLS:
        allowed = "a velocity, also with feed_forward, or a torque, brake or coast; no limit"
        raise ValueError(f"motor {axis.spec.name}: {command}: must be {allowed}")
    axis.kind = kind
    axis.wanted = CONTROLS[kind]


def _feedback(axis: Axis, now_ns: int) -> MotorFeedback:
    return _made(
        (
            _state(axis, now_ns),
            axis.position,
            axis.velocity,
            axis.torque,
            axis.voltage,
            axis.temperature_c,
            axis.fault,
            None if axis.measured_ns is None else max(0, now_ns - axis.measured_ns),
            axis.missing(now_ns),
            None if axis.torque_ns is None else max(0, now_ns - axis.torque_ns),
        )
    )


def _state(axis: Axis, now_ns: int) -> MotorState:
    if now_ns >= axis.heartbeat_until_ns or now_ns >= axis.measured_until_ns:
        return _SILENT
    if axis.fault is not None:
        return _FAULT
    if axis.step is Step.ACTIVE:
        return _OPERATIONAL
    if axis.step is Step.READY and axis.control is None and axis.axis_state == AxisState.IDLE:
        return _IDLE
    return _STARTING
