"""Simulated ODrive: the CANSimple tables and what distinguishes firmware 0.5 from 0.6.

Source: odrive-cansimple-0.5.6.dbc and -0.6.10.dbc, and github odriverobotics/ODrive f9b5419c,
Firmware/communication/can/can_simple.cpp. Not documented and ours: the rates of the slow cyclic frames.
"""

from enum import IntEnum
from struct import Struct
from typing import NamedTuple

from replay.sim.controllers.odrive_control import ControllerError

NODE_SHIFT, COMMAND_MASK, BROADCAST_NODE = 5, 0x1F, 0x3F
HEARTBEAT_HZ = 10.0

# Layouts, all little-endian.
HEARTBEAT = Struct("<I4B")  # axis error; state; 0.6: result, trajectory done, 0; 0.5: motor, encoder, controller flags
VERSION = Struct("<8B")  # protocol; hardware major, minor, variant; firmware major, minor, revision, unreleased
U32 = Struct("<I")
U64 = Struct("<Q")
TWO_U32 = Struct("<II")
FLOAT = Struct("<f")
TWO_FLOATS = Struct("<ff")
INPUT_POSITION = Struct("<fhh")  # turns, 0.001 turns/s, 0.001 N m
SDO = Struct("<BHB")  # opcode (1: write), endpoint, reserved; then the value
SDO_WRITE = 1
SDO_REPLY = Struct("<xHx4s")  # endpoint, value
SERIAL_BYTES = 6  # of Address, after the node id

PROTOCOL = 2
DEFAULT_HARDWARE = "5.2.0"  # S1
DEFAULT_FIRMWARE = "0.6.10"
TRAJECTORY_DONE_05 = 0x80


class AxisState(IntEnum):
    IDLE = 1
    FULL_CALIBRATION = 3
    CLOSED_LOOP = 8


class ProcedureResult(IntEnum):
    SUCCESS = 0
    BUSY = 1
    CANCELLED = 2
    DISARMED = 3
    PHASE_RESISTANCE_OUT_OF_RANGE = 6
    INVALID_STATE = 13
    NOT_CALIBRATED = 14


class Command(IntEnum):
    """CANSimple command ids; where the versions differ the suffix says which one."""

    GET_VERSION = 0x00
    HEARTBEAT = 0x01
    ESTOP = 0x02
    GET_ERROR = 0x03  # 0.5: motor error
    RX_SDO_06 = 0x04
    GET_ENCODER_ERROR_05 = 0x04
    TX_SDO_06 = 0x05
    GET_SENSORLESS_ERROR_05 = 0x05
    ADDRESS_06 = 0x06
    SET_AXIS_STATE = 0x07
    GET_ENCODER_ESTIMATES = 0x09
    SET_CONTROLLER_MODE = 0x0B
    SET_INPUT_POS = 0x0C
    SET_INPUT_VEL = 0x0D
    SET_INPUT_TORQUE = 0x0E
    SET_LIMITS = 0x0F
    GET_IQ = 0x14
    GET_TEMPERATURE_06 = 0x15
    REBOOT = 0x16
    GET_BUS_VOLTAGE_CURRENT = 0x17
    CLEAR_ERRORS = 0x18
    SET_ABSOLUTE_POSITION_06 = 0x19
    GET_TORQUES_06 = 0x1C
    GET_CONTROLLER_ERROR_05 = 0x1D


SETPOINTS = frozenset((Command.SET_INPUT_POS, Command.SET_INPUT_VEL, Command.SET_INPUT_TORQUE))


class Firmware(NamedTuple):
    """What distinguishes the two layouts, besides the frames themselves."""

    watchdog_error: int
    estop_error: int
    invalid_state_error: int  # 0: told by the procedure result instead
    controller_errors: dict[ControllerError, int]
    legacy: bool  # 0.5: any frame feeds the watchdog, an empty frame is a request, no Sdo
    watchdog_when_idle: bool
    watchdog_over_usb: bool  # taken as set over USB and saved, as there is no Sdo
    slow_cyclic: tuple[tuple[Command, float], ...]  # Hz


_CONTROLLER_FAILED_05 = 0x200
FIRMWARES = {
    "0.5": Firmware(
        watchdog_error=0x800,
        estop_error=0x4000,
        invalid_state_error=0x1,
        controller_errors=dict.fromkeys(ControllerError, _CONTROLLER_FAILED_05),
        legacy=True,
        watchdog_when_idle=True,
        watchdog_over_usb=True,
        slow_cyclic=((Command.GET_IQ, 10.0), (Command.GET_BUS_VOLTAGE_CURRENT, 2.0)),
    ),
    "0.6": Firmware(
        watchdog_error=0x01000000,
        estop_error=0x02000000,
        invalid_state_error=0,
        controller_errors={
            ControllerError.OVERSPEED: 0x8000,  # VELOCITY_LIMIT_VIOLATION
            ControllerError.INVALID_INPUT_MODE: 0x10,  # BAD_CONFIG
            ControllerError.INVALID_ESTIMATE: 0x40,  # MISSING_INPUT
        },
        legacy=False,
        watchdog_when_idle=False,
        watchdog_over_usb=False,
        slow_cyclic=(
            (Command.GET_TORQUES_06, 10.0),
            (Command.GET_TEMPERATURE_06, 2.0),
            (Command.GET_BUS_VOLTAGE_CURRENT, 2.0),
        ),
    ),
}
