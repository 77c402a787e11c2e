"""The two firmware lines of ODrive: messages, heartbeat, error words and where each says why it refused.

Words and bits are those of the vendor's DBC files (see odrive_tables), against which the tests check every row.
"""

from collections.abc import Callable, Mapping
from functools import reduce
from operator import or_
from typing import Any, Final, NamedTuple

from drivers.odrive import tables
from drivers.odrive.tables import Message


class Heard(NamedTuple):
    """A heartbeat in the terms common to both firmware lines."""

    errors: int
    axis_state: int
    result: int


def _heartbeat_06(items: tuple[Any, ...]) -> Heard:
    return Heard(items[0], items[1], items[2])


# Version 0.5 has no room for sub-errors in its error word: its three flags follow above bit 31.
MOTOR_FLAG_BIT, ENCODER_FLAG_BIT, CONTROLLER_FLAG_BIT = 32, 33, 34


def _heartbeat_05(items: tuple[Any, ...]) -> Heard:
    axis_error, axis_state, motor, encoder, controller = items
    flags = (motor & 1) << MOTOR_FLAG_BIT | (encoder & 1) << ENCODER_FLAG_BIT | (controller & 1) << CONTROLLER_FLAG_BIT
    return Heard(axis_error | flags, axis_state, 0)


class Bit(NamedTuple):
    """One error bit: the vendor's word and our fault code."""

    word: str
    code: str


DEVICE_ERROR: Final = "device_error"

ERRORS_06: Final[dict[int, Bit]] = {
    0x0000_0001: Bit("INITIALIZING", DEVICE_ERROR),
    0x0000_0002: Bit("SYSTEM_LEVEL", DEVICE_ERROR),
    0x0000_0004: Bit("TIMING_ERROR", DEVICE_ERROR),
    0x0000_0008: Bit("MISSING_ESTIMATE", "encoder"),
    0x0000_0010: Bit("BAD_CONFIG", DEVICE_ERROR),
    0x0000_0020: Bit("DRV_FAULT", DEVICE_ERROR),
    0x0000_0040: Bit("MISSING_INPUT", DEVICE_ERROR),
    0x0000_0100: Bit("DC_BUS_OVER_VOLTAGE", "over_voltage"),
    0x0000_0200: Bit("DC_BUS_UNDER_VOLTAGE", "under_voltage"),
    0x0000_0400: Bit("DC_BUS_OVER_CURRENT", "over_current"),
    0x0000_0800: Bit("DC_BUS_OVER_REGEN_CURRENT", "over_current"),
    0x0000_1000: Bit("CURRENT_LIMIT_VIOLATION", "over_current"),
    0x0000_2000: Bit("MOTOR_OVER_TEMP", "over_temperature"),
    0x0000_4000: Bit("INVERTER_OVER_TEMP", "over_temperature"),
    0x0000_8000: Bit("VELOCITY_LIMIT_VIOLATION", "overspeed"),
    0x0001_0000: Bit("POSITION_LIMIT_VIOLATION", DEVICE_ERROR),
    0x0002_0000: Bit("REQUESTED_CURRENT_TOO_HIGH", "over_current"),  # since 0.6.11; not in the DBC of 0.6.10
    0x0100_0000: Bit("WATCHDOG_TIMER_EXPIRED", "watchdog"),
    0x0200_0000: Bit("ESTOP_REQUESTED", "estop"),
    0x0400_0000: Bit("SPINOUT_DETECTED", "encoder"),
    0x0800_0000: Bit("BRAKE_RESISTOR_DISARMED", DEVICE_ERROR),
    0x1000_0000: Bit("THERMISTOR_DISCONNECTED", DEVICE_ERROR),
    0x4000_0000: Bit("CALIBRATION_ERROR", DEVICE_ERROR),
}

ERRORS_05: Final[dict[int, Bit]] = {
    0x0000_0001: Bit("INVALID_STATE", DEVICE_ERROR),
    0x0000_0040: Bit("MOTOR_FAILED", "motor"),
    0x0000_0080: Bit("SENSORLESS_ESTIMATOR_FAILED", "encoder"),
    0x0000_0100: Bit("ENCODER_FAILED", "encoder"),
    0x0000_0200: Bit("CONTROLLER_FAILED", "controller"),
    0x0000_0800: Bit("WATCHDOG_TIMER_EXPIRED", "watchdog"),
    0x0000_1000: Bit("MIN_ENDSTOP_PRESSED", DEVICE_ERROR),
    0x0000_2000: Bit("MAX_ENDSTOP_PRESSED", DEVICE_ERROR),
    0x0000_4000: Bit("ESTOP_REQUESTED", "estop"),
    0x0002_0000: Bit("HOMING_WITHOUT_ENDSTOP", DEVICE_ERROR),
    0x0004_0000: Bit("OVER_TEMP", "over_temperature"),
    0x0008_0000: Bit("UNKNOWN_POSITION", "encoder"),
    1 << MOTOR_FLAG_BIT: Bit("motor error flag", "motor"),
    1 << ENCODER_FLAG_BIT: Bit("encoder error flag", "encoder"),
    1 << CONTROLLER_FLAG_BIT: Bit("controller error flag", "controller"),
}

MOTOR_ERRORS_05: Final[dict[int, Bit]] = {
    0x0000_0001: Bit("PHASE_RESISTANCE_OUT_OF_RANGE", "motor"),
    0x0000_0002: Bit("PHASE_INDUCTANCE_OUT_OF_RANGE", "motor"),
    0x0000_0008: Bit("DRV_FAULT", "motor"),
    0x0000_0010: Bit("CONTROL_DEADLINE_MISSED", "motor"),
    0x0000_0080: Bit("MODULATION_MAGNITUDE", "motor"),
    0x0000_0400: Bit("CURRENT_SENSE_SATURATION", "over_current"),
    0x0000_1000: Bit("CURRENT_LIMIT_VIOLATION", "over_current"),
    0x0001_0000: Bit("MODULATION_IS_NAN", "motor"),
    0x0002_0000: Bit("MOTOR_THERMISTOR_OVER_TEMP", "over_temperature"),
    0x0004_0000: Bit("FET_THERMISTOR_OVER_TEMP", "over_temperature"),
    0x0008_0000: Bit("TIMER_UPDATE_MISSED", "motor"),
    0x0010_0000: Bit("CURRENT_MEASUREMENT_UNAVAILABLE", "motor"),
    0x0020_0000: Bit("CONTROLLER_FAILED", "motor"),
    0x0040_0000: Bit("I_BUS_OUT_OF_RANGE", "over_current"),
    0x0080_0000: Bit("BRAKE_RESISTOR_DISARMED", "motor"),
    0x0100_0000: Bit("SYSTEM_LEVEL", "motor"),  # bus voltage or current of the whole board
    0x0200_0000: Bit("BAD_TIMING", "motor"),
    0x0400_0000: Bit("UNKNOWN_PHASE_ESTIMATE", "encoder"),
    0x0800_0000: Bit("UNKNOWN_PHASE_VEL", "encoder"),
    0x1000_0000: Bit("UNKNOWN_TORQUE", "motor"),
    0x2000_0000: Bit("UNKNOWN_CURRENT_COMMAND", "motor"),
    0x4000_0000: Bit("UNKNOWN_CURRENT_MEASUREMENT", "motor"),
    0x8000_0000: Bit("UNKNOWN_VBUS_VOLTAGE", "motor"),
    0x1_0000_0000: Bit("UNKNOWN_VOLTAGE_COMMAND", "motor"),
    0x2_0000_0000: Bit("UNKNOWN_GAINS", "motor"),
    0x4_0000_0000: Bit("CONTROLLER_INITIALIZING", "motor"),
    0x8_0000_0000: Bit("UNBALANCED_PHASES", "motor"),
}

ENCODER_ERRORS_05: Final[dict[int, Bit]] = {
    0x0000_0001: Bit("UNSTABLE_GAIN", "encoder"),
    0x0000_0002: Bit("CPR_POLEPAIRS_MISMATCH", "encoder"),
    0x0000_0004: Bit("NO_RESPONSE", "encoder"),
    0x0000_0008: Bit("UNSUPPORTED_ENCODER_MODE", "encoder"),
    0x0000_0010: Bit("ILLEGAL_HALL_STATE", "encoder"),
    0x0000_0020: Bit("INDEX_NOT_FOUND_YET", "encoder"),
    0x0000_0040: Bit("ABS_SPI_TIMEOUT", "encoder"),
    0x0000_0080: Bit("ABS_SPI_COM_FAIL", "encoder"),
    0x0000_0100: Bit("ABS_SPI_NOT_READY", "encoder"),
    0x0000_0200: Bit("HALL_NOT_CALIBRATED_YET", "encoder"),
}

CONTROLLER_ERRORS_05: Final[dict[int, Bit]] = {
    0x0000_0001: Bit("OVERSPEED", "overspeed"),
    0x0000_0002: Bit("INVALID_INPUT_MODE", "controller"),
    0x0000_0004: Bit("UNSTABLE_GAIN", "controller"),
    0x0000_0008: Bit("INVALID_MIRROR_AXIS", "controller"),
    0x0000_0010: Bit("INVALID_LOAD_ENCODER", "encoder"),
    0x0000_0020: Bit("INVALID_ESTIMATE", "encoder"),
    0x0000_0040: Bit("INVALID_CIRCULAR_RANGE", "controller"),
    0x0000_0080: Bit("SPINOUT_DETECTED", "encoder"),
}

PROCEDURE_RESULTS_06: Final[dict[int, str]] = {
    0: "SUCCESS",
    1: "BUSY",
    2: "CANCELLED",
    3: "DISARMED",
    4: "NO_RESPONSE",
    5: "POLE_PAIR_CPR_MISMATCH",
    6: "PHASE_RESISTANCE_OUT_OF_RANGE",
    7: "PHASE_INDUCTANCE_OUT_OF_RANGE",
    8: "UNBALANCED_PHASES",
    9: "INVALID_MOTOR_TYPE",
    10: "ILLEGAL_HALL_STATE",
    11: "TIMEOUT",
    12: "HOMING_WITHOUT_ENDSTOP",
    13: "INVALID_STATE",
    14: "NOT_CALIBRATED",
    15: "NOT_CONVERGING",
    16: "REQUESTED_CURRENT_TOO_HIGH",  # not in the DBC of 0.6.10
}


class Reason(NamedTuple):
    """A message to ask for when an axis refused: what it tells, in which item, by which table."""

    title: str
    item: int
    words: Mapping[int, Bit]


class Firmware(NamedTuple):
    """One firmware line."""

    to_device: Mapping[int, Message]
    from_device: Mapping[int, Message]
    heartbeat: Callable[[tuple[Any, ...]], Heard]
    errors: Mapping[int, Bit]
    booting: int  # error bits that only say that the controller is not up yet
    host_silent: int  # the bit of the controller's watchdog: it missed our frames, nothing is broken
    results: Mapping[int, str]
    reasons: Mapping[int, Reason]
    tells_version: bool  # and has parameters that can be written and read back over CAN
    zero_until_closed_loop: bool  # estimates are exactly 0 from boot to the first closed loop, then jump to the truth
    estimates_setting: str  # of the controller: how often it sends them, in ms
    heartbeat_setting: str

    def heard(self, data: bytes) -> Heard | None:
        """What the data of a heartbeat tells; None: too short."""
        message = self.from_device[tables.HEARTBEAT]
        if len(data) < message.needed:
            return None
        return self.heartbeat(message.layout.unpack_from(data.ljust(message.layout.size, b"\0")))


FIRMWARES: Final[dict[str, Firmware]] = {
    "0.5": Firmware(
        to_device=tables.TO_DEVICE_05,
        from_device=tables.FROM_DEVICE_05,
        heartbeat=_heartbeat_05,
        errors=ERRORS_05,
        booting=0,
        host_silent=0x0000_0800,
        results={},
        reasons={
            0x03: Reason("motor", 0, MOTOR_ERRORS_05),
            0x04: Reason("encoder", 0, ENCODER_ERRORS_05),
            0x1D: Reason("controller", 0, CONTROLLER_ERRORS_05),
        },
        tells_version=False,
        zero_until_closed_loop=True,
        estimates_setting="axis.config.can.encoder_rate_ms",
        heartbeat_setting="axis.config.can.heartbeat_rate_ms",
    ),
    "0.6": Firmware(
        to_device=tables.TO_DEVICE_06,
        from_device=tables.FROM_DEVICE_06,
        heartbeat=_heartbeat_06,
        errors=ERRORS_06,
        booting=0x0000_0001,
        host_silent=0x0100_0000,
        results=PROCEDURE_RESULTS_06,
        reasons={0x03: Reason("disarm reason", 1, ERRORS_06)},
        tells_version=True,
        zero_until_closed_loop=False,
        estimates_setting="axis.config.can.encoder_msg_rate_ms",
        heartbeat_setting="axis.config.can.heartbeat_msg_rate_ms",
    ),
}


def told_versions(items: tuple[Any, ...]) -> tuple[str, str]:
    """Firmware and hardware in Get_Version, as the vendor's flat_endpoints.json has them."""
    _, *hardware, major, minor, revision, unreleased = items
    firmware = f"{major}.{minor}.{revision}" + ("-unreleased" if unreleased else "")
    return firmware, ".".join(str(part) for part in hardware)


def every_word() -> tuple[str, ...]:
    """Of the vendor, in both firmware lines."""
    tables = [table for line in FIRMWARES.values() for table in (line.errors, *_of_reasons(line))]
    words = [bit.word for table in tables for bit in table.values()]
    words += [result for line in FIRMWARES.values() for result in line.results.values()]
    return tuple(dict.fromkeys(words))


def _of_reasons(line: Firmware) -> list[Mapping[int, Bit]]:
    return [reason.words for reason in line.reasons.values()]


def error_words(bits: int, table: Mapping[int, Bit]) -> str:
    """Every set bit in the vendor's words; a bit the table lacks as a number."""
    words = [bit.word for mask, bit in table.items() if bits & mask]
    unknown = bits & ~reduce(or_, table, 0)
    if unknown:
        words.append(f"unknown 0x{unknown:x}")
    return ", ".join(words)


def error_code(bits: int, table: Mapping[int, Bit]) -> str:
    """Our code of the first set bit that has one of its own."""
    codes = [bit.code for mask, bit in table.items() if bits & mask]
    return next((code for code in codes if code != DEVICE_ERROR), DEVICE_ERROR)
