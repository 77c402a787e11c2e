"""ODrive CANSimple as tables: every message of firmware 0.5 and 0.6, never mixed.

The id of a frame is `node << 5 | command`. Names and layouts are those of the vendor's own DBC files,
odrive-cansimple-0.5.6.dbc and odrive-cansimple-0.6.10.dbc (as shipped by PyPI odrive-can 2.1.0), against which the
tests check every row. Everything is little-endian; a frame may be shorter than here as long as its values are whole.
"""

from enum import IntEnum
from struct import Struct, calcsize
from typing import Final, NamedTuple

NODE_SHIFT: Final = 5
COMMAND_MASK: Final = 0x1F

GET_VERSION: Final = 0x00
HEARTBEAT: Final = 0x01
RX_SDO: Final = 0x04
TX_SDO: Final = 0x05
ADDRESS: Final = 0x06
SET_AXIS_STATE: Final = 0x07
GET_ENCODER_ESTIMATES: Final = 0x09
SET_CONTROLLER_MODE: Final = 0x0B
SET_INPUT_VEL: Final = 0x0D
SET_INPUT_TORQUE: Final = 0x0E
SET_LIMITS: Final = 0x0F
REBOOT: Final = 0x16
CLEAR_ERRORS: Final = 0x18

SDO_READ, SDO_WRITE = 0, 1
REBOOT_SAVE: Final = 1  # save the settings first; ODriveResources, examples/can_simple_utils.py
INPUT_PASSTHROUGH: Final = 1  # the host makes the ramps


class AxisState(IntEnum):
    """The two axis states a host asks for; every other one (start-up, calibration, homing) is not ours."""

    IDLE = 1
    CLOSED_LOOP = 8


class Control(IntEnum):
    """Control modes in use."""

    TORQUE = 1
    VELOCITY = 2


class Field(NamedTuple):
    """One value of a message: the item of its Struct, or `mask` bits of it from `shift` on."""

    name: str
    item: int
    shift: int = 0
    mask: int = 0  # 0: the whole item
    scale: float = 1.0


class Message(NamedTuple):
    """Layout of one message; `needed` bytes carry its values, the rest is padding."""

    name: str
    layout: Struct
    needed: int
    fields: tuple[Field, ...]

    def values(self, data: bytes) -> tuple[tuple[str, float | int], ...] | None:
        """Names and values in wire order; None when the data is too short."""
        if len(data) < self.needed:
            return None
        items = self.layout.unpack_from(data.ljust(self.layout.size, b"\0"))
        return tuple((field.name, _value(field, items[field.item])) for field in self.fields)


def _value(field: Field, item: int | float) -> float | int:  # a whole number stays one, compiled too
    if field.mask:
        return int(item) >> field.shift & field.mask
    return item if field.scale == 1.0 else item * field.scale


def _message(name: str, items: str, *fields: str | Field, length: int = 8, needed: int | None = None) -> Message:
    size = calcsize(items)
    plain = tuple(Field(field, at) if isinstance(field, str) else field for at, field in enumerate(fields))
    return Message(name, Struct(f"{items}{length - size}x"), size if needed is None else needed, plain)


def _empty(name: str) -> Message:
    return Message(name, Struct("<"), 0, ())


COMMON_TO_DEVICE: Final[dict[int, Message]] = {
    0x02: _empty("Estop"),
    SET_AXIS_STATE: _message("Set_Axis_State", "<I", "Axis_Requested_State"),
    SET_CONTROLLER_MODE: _message("Set_Controller_Mode", "<II", "Control_Mode", "Input_Mode"),
    0x0C: _message(
        "Set_Input_Pos", "<fhh", "Input_Pos", Field("Vel_FF", 1, scale=0.001), Field("Torque_FF", 2, scale=0.001)
    ),
    SET_INPUT_VEL: _message("Set_Input_Vel", "<ff", "Input_Vel", "Input_Torque_FF"),
    SET_INPUT_TORQUE: _message("Set_Input_Torque", "<f", "Input_Torque"),
    SET_LIMITS: _message("Set_Limits", "<ff", "Velocity_Limit", "Current_Limit"),
    0x11: _message("Set_Traj_Vel_Limit", "<f", "Traj_Vel_Limit"),
    0x12: _message("Set_Traj_Accel_Limits", "<ff", "Traj_Accel_Limit", "Traj_Decel_Limit"),
    0x13: _message("Set_Traj_Inertia", "<f", "Traj_Inertia"),
    0x1A: _message("Set_Pos_Gain", "<f", "Pos_Gain"),
    0x1B: _message("Set_Vel_Gains", "<ff", "Vel_Gain", "Vel_Integrator_Gain"),
}

COMMON_FROM_DEVICE: Final[dict[int, Message]] = {
    GET_ENCODER_ESTIMATES: _message("Get_Encoder_Estimates", "<ff", "Pos_Estimate", "Vel_Estimate"),
    0x14: _message("Get_Iq", "<ff", "Iq_Setpoint", "Iq_Measured"),
    0x17: _message("Get_Bus_Voltage_Current", "<ff", "Bus_Voltage", "Bus_Current"),
}

TO_DEVICE_06: Final = COMMON_TO_DEVICE | {
    RX_SDO: _message("RxSdo", "<BHBI", "Opcode", "Endpoint_ID", "Reserved", "Value"),
    ADDRESS: _message(
        "Address", "<Q", Field("Node_ID", 0, 0, 0xFF), Field("Serial_Number", 0, 8, 0xFFFF_FFFF_FFFF), needed=7
    ),
    REBOOT: _message("Reboot", "<B", "Action", length=1),
    CLEAR_ERRORS: _message("Clear_Errors", "<B", "Identify", length=1),
    0x19: _message("Set_Absolute_Position", "<f", "Position"),
    0x1F: _empty("Enter_DFU_Mode"),
}

FROM_DEVICE_06: Final = COMMON_FROM_DEVICE | {
    GET_VERSION: _message(
        "Get_Version",
        "<8B",
        "Protocol_Version",
        *("Hw_Version_Major", "Hw_Version_Minor", "Hw_Version_Variant"),
        *("Fw_Version_Major", "Fw_Version_Minor", "Fw_Version_Revision", "Fw_Version_Unreleased"),
    ),
    HEARTBEAT: _message(
        "Heartbeat", "<IBBB", "Axis_Error", "Axis_State", "Procedure_Result", Field("Trajectory_Done_Flag", 3, 0, 1)
    ),
    0x03: _message("Get_Error", "<II", "Active_Errors", "Disarm_Reason"),
    # The length of the value depends on the parameter: a bool has one byte.
    TX_SDO: _message("TxSdo", "<BHBI", "Reserved0", "Endpoint_ID", "Reserved1", "Value", needed=5),
    0x15: _message("Get_Temperature", "<ff", "FET_Temperature", "Motor_Temperature"),
    0x1C: _message("Get_Torques", "<ff", "Torque_Target", "Torque_Estimate"),
    0x1D: _message("Get_Powers", "<ff", "Electrical_Power", "Mechanical_Power"),
}

TO_DEVICE_05: Final = COMMON_TO_DEVICE | {
    0x06: _message("Set_Axis_Node_ID", "<I", "Axis_Node_ID"),
    0x10: _empty("Start_Anticogging"),
    0x16: _empty("Reboot"),
    CLEAR_ERRORS: _empty("Clear_Errors"),  # clears both axes of the board
    0x19: _message("Set_Linear_Count", "<i", "Position"),
}

FROM_DEVICE_05: Final = COMMON_FROM_DEVICE | {
    HEARTBEAT: _message(
        "Heartbeat",
        "<IBBBB",
        *("Axis_Error", "Axis_State"),
        Field("Motor_Error_Flag", 2, 0, 1),
        Field("Encoder_Error_Flag", 3, 0, 1),
        Field("Controller_Error_Flag", 4, 0, 1),
        Field("Trajectory_Done_Flag", 4, 7, 1),
    ),
    0x03: _message("Get_Motor_Error", "<Q", "Motor_Error"),
    0x04: _message("Get_Encoder_Error", "<I", "Encoder_Error"),
    0x05: _message("Get_Sensorless_Error", "<I", "Sensorless_Error"),
    0x0A: _message("Get_Encoder_Count", "<ii", "Shadow_Count", "Count_in_CPR"),
    0x15: _message("Get_Sensorless_Estimates", "<ff", "Sensorless_Pos_Estimate", "Sensorless_Vel_Estimate"),
    0x1C: _message("Get_ADC_Voltage", "<f", "ADC_Voltage"),
    0x1D: _message("Get_Controller_Error", "<I", "Controller_Error"),
}
