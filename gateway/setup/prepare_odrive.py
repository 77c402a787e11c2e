"""What a robot file needs of an ODrive: by listening, by its parameters (0.6), or in words for odrivetool (0.5). Pure.

How this works
--------------
`settings` is the table of what is needed. Of 0.6 each parameter is read over CAN by the number that the vendor's file
has for exactly its firmware and hardware; with another one nothing is asked and nothing written. What the driver sets
at each arming (modes, limits) and at each start (the watchdog) is in the table too: saved in the controller it is right
before the first frame, and for other tools.
"""

from collections.abc import Callable, Mapping, Sequence
from math import isclose, tau
from typing import Final, NamedTuple

from drivers.odrive import tables
from drivers.odrive.endpoints import Endpoint, EndpointError, FlatEndpoints, Value
from drivers.odrive.firmware import FIRMWARES, error_words, told_versions
from drivers.odrive.tables import AxisState, Control
from drivers.odrive.watchdog import OPTIONS, PROOF
from gateway.config import Bus, Motor, RobotConfig
from gateway.setup.preparation import Ear, Line, Verdict, rate_line
from gateway.setup.sdo import Job

SLOWEST_HEARTBEAT_MS: Final = 100  # the driver takes three of them for silence
SLOWEST_TORQUES_MS: Final = 100
GRIP_TORQUES_MS: Final = 10  # a launch without slip learns from them
ENABLE: Final = "axis0.config.enable_watchdog"
TIMEOUT: Final = "axis0.config.watchdog_timeout"
BAUD_RATE: Final = "can.config.baud_rate"
A_YES: Final = "a yes sets it"
IN_FILE: Final = "endpoints in the robot file"
WHEREABOUTS: Final = (
    "flat_endpoints.json of exactly this firmware and hardware: the vendor publishes it with the firmware"
)


class Setting(NamedTuple):
    """One parameter as the robot file needs it.

    `writes`: it is set to `wanted` where it is not accepted; else a person has to see to it, as `todo` says. `needed`:
    every firmware 0.6 has it.
    """

    path: str
    wanted: Value
    accepts: Callable[[Value], bool]
    writes: bool = True
    needed: bool = True
    todo: str = ""


class Versions(NamedTuple):
    """As Get_Version tells them."""

    firmware: str
    hardware: str


def rate_ms(motor: Motor) -> int:
    """Of the encoder estimates, as the controller takes it."""
    return max(1, int(1e3 / (motor.feedback_rate or 100.0)))


def settings(config: RobotConfig, motor: Motor) -> list[Setting]:
    """In the order in which they are written: a watchdog that is enabled with 0 s expires at once."""
    speed, control = motor.max_speed * motor.gear_ratio / tau, _control(motor)
    torques_ms = GRIP_TORQUES_MS if getattr(config.robot, "grip", None) is not None else SLOWEST_TORQUES_MS
    can = "axis0.config.can"
    return [
        _exactly(f"{can}.node_id", motor.id, writes=False, todo="an id is given by itself, with one on the bus"),
        _up_to(f"{can}.heartbeat_msg_rate_ms", SLOWEST_HEARTBEAT_MS),
        _exactly(f"{can}.encoder_msg_rate_ms", rate_ms(motor)),
        _up_to(f"{can}.torques_msg_rate_ms", torques_ms),
        *_watchdog(motor),
        _exactly("axis0.controller.config.control_mode", int(control)),
        _exactly("axis0.controller.config.input_mode", tables.INPUT_PASSTHROUGH),
        _nearly("axis0.controller.config.vel_limit", speed),
        _nearly("axis0.config.motor.current_soft_max", motor.max_current),
        Setting(
            "axis0.config.motor.current_hard_max",
            motor.max_current,
            lambda value: value > motor.max_current,
            writes=False,
            todo=f"above max_current = {motor.max_current:g} A, as far as motor and board bear: it disarms there",
        ),
        *[_exactly(f"axis0.config.startup_{name}", False, needed=False) for name in _STARTUPS],
        *[
            Setting(
                path, True, bool, writes=False, needed=False, todo="calibrate it: --calibrate, wheels off the ground"
            )
            for path in CALIBRATED
        ],
    ]


_STARTUPS: Final = ("motor_calibration", "encoder_offset_calibration", "closed_loop_control", "homing")  # all turn it
CALIBRATED: Final = (
    "axis0.config.motor.phase_resistance_valid",
    "axis0.config.motor.phase_inductance_valid",
    "axis0.commutation_mapper.config.offset_valid",
)


def bit_rate(bus: Bus) -> Setting:
    """Written last, and to all controllers of a bus at once: they no longer hear each other."""
    return _exactly(BAUD_RATE, bus.bitrate)


def _control(motor: Motor) -> Control:
    return Control.VELOCITY if motor.speed_loop is None else Control.TORQUE


def _watchdog(motor: Motor) -> list[Setting]:
    if motor.watchdog is None:
        return []
    return [_nearly(TIMEOUT, motor.watchdog.timeout), _exactly(ENABLE, True)]


def _exactly(path: str, wanted: Value, *, writes: bool = True, needed: bool = True, todo: str = "") -> Setting:
    return Setting(path, wanted, lambda value: value == wanted, writes, needed, todo)


def _up_to(path: str, slowest_ms: int) -> Setting:
    return Setting(path, slowest_ms, lambda value: 0 < value <= slowest_ms)


def _nearly(path: str, wanted: float) -> Setting:
    return Setting(path, wanted, lambda value: isclose(value, wanted, rel_tol=1e-6))  # f32 has 24 bits


def versions(ear: Ear, motor: Motor) -> Versions | None:
    """None: it did not tell any."""
    heard = ear.of(motor.id << tables.NODE_SHIFT | tables.GET_VERSION)
    message = tables.FROM_DEVICE_06[tables.GET_VERSION]
    if heard is None or len(heard.data) < message.needed:
        return None
    return Versions(*told_versions(message.layout.unpack_from(heard.data)))


def idle(ear: Ear, motor: Motor) -> bool:
    """Whether its last heartbeat said so: nobody commands it, and nothing turns."""
    heartbeat = ear.of(motor.id << tables.NODE_SHIFT | tables.HEARTBEAT)
    told = None if heartbeat is None else FIRMWARES[motor.variant].heard(heartbeat.data)
    return told is not None and told.axis_state == AxisState.IDLE


def heard_lines(ear: Ear, motor: Motor, _bus: Bus) -> list[Line]:
    """By listening alone."""
    firmware = FIRMWARES[motor.variant]
    heartbeat = ear.of(motor.id << tables.NODE_SHIFT | tables.HEARTBEAT)
    estimates = ear.of(motor.id << tables.NODE_SHIFT | tables.GET_ENCODER_ESTIMATES)
    if heartbeat is None and estimates is None:
        todo = "power, cable, bit rate (from the factory 250k), id: `drivegate setup scan` tells who is there"
        return [Line(motor.name, "answers", f"node {motor.id}", "silent", Verdict.NO, todo)]
    lines = [
        rate_line(
            *(motor.name, "Heartbeat", 1e3 / SLOWEST_HEARTBEAT_MS, heartbeat),
            f"set {firmware.heartbeat_setting} to {SLOWEST_HEARTBEAT_MS}",
            at_least=True,
        ),
        rate_line(
            *(motor.name, "Get_Encoder_Estimates", 1e3 / rate_ms(motor), estimates),
            f"set {firmware.estimates_setting} to {rate_ms(motor)}",
        ),
    ]
    told = None if heartbeat is None else firmware.heard(heartbeat.data)
    if told is not None:
        # That nobody feeds its watchdog now is as it should be.
        words = error_words(told.errors & ~firmware.host_silent, firmware.errors)
        todo = "`drivegate doctor --explain` it; an arming clears what is over" if words else ""
        lines.append(Line(motor.name, "error", "none", words or "none", Verdict.NO if words else Verdict.OK, todo))
    return lines if firmware.tells_version else [*lines, _untold(motor)]


def _untold(motor: Motor) -> Line:
    """What of 0.5 nobody can read over CAN."""
    found = f"firmware {motor.variant} tells none over CAN"
    todo = "type what is told below into odrivetool"
    return Line(motor.name, "settings", "as the robot file", found, Verdict.UNKNOWN, todo)


# -- by its parameters, 0.6 -------------------------------------------------------------------------------------------


class Chosen(NamedTuple):
    """The vendor's file that fits a controller; None: none does, and `line` says why."""

    flat: FlatEndpoints | None
    line: Line


def chosen(motor: Motor, told: Versions | None, given: Mapping[str, FlatEndpoints]) -> Chosen:
    """Of the files given, by name, the one of exactly this firmware and hardware."""
    if told is None:
        todo = 'firmware older than 0.6 (variant = "0.5"), or a line that is broken in one direction'
        return Chosen(None, Line(motor.name, "firmware", "0.6", "does not answer Get_Version", Verdict.NO, todo))
    found = f"{told.firmware}, hardware {told.hardware}"
    fits = next((flat for flat in given.values() if (flat.firmware, flat.hardware) == told), None)
    wanted = str(motor.options.get("firmware", "0.6"))
    if fits is not None:
        return Chosen(fits, Line(motor.name, "firmware", "that of the endpoints", found, Verdict.OK))
    if given:
        others = ", ".join(f"{name}: {flat.firmware}, hardware {flat.hardware}" for name, flat in given.items())
        line = Line(motor.name, "firmware", others, found, Verdict.NO, f"nothing is asked or written; {WHEREABOUTS}")
        return Chosen(None, line)
    right = told.firmware.startswith("0.6.") and wanted in ("0.6", told.firmware)
    todo = "" if right else f"other endpoints: --endpoints with {WHEREABOUTS}"
    return Chosen(None, Line(motor.name, "firmware", wanted, found, Verdict.OK if right else Verdict.NO, todo))


def unread_line(motor: Motor) -> Line:
    """Where no file of the vendor was given."""
    todo = f"--endpoints with {WHEREABOUTS}"
    return Line(motor.name, "settings", "as the robot file", "not read", Verdict.UNKNOWN, todo)


def jobs(flat: FlatEndpoints, wanted: Sequence[Setting], *, write: bool = False) -> list[Job]:
    """To read them all, or to write them first; what this firmware has not is left out."""
    known = [(flat.endpoints.get(one.path), one) for one in wanted]
    return [Job(endpoint, one.wanted if write else None) for endpoint, one in known if endpoint is not None]


def setting_lines(
    motor: Motor, flat: FlatEndpoints, wanted: Sequence[Setting], values: Mapping[str, Value], silent: Endpoint | None
) -> list[Line]:
    """One for each, and one where the controller fell silent."""
    lines = [line for one in wanted if (line := _setting_line(motor, flat, one, values)) is not None]
    if silent is not None:
        todo = "look at the line and at other programs on the bus; nothing more was asked, nothing is written"
        lines.append(Line(motor.name, silent.path, "an answer", "does not answer RxSdo", Verdict.NO, todo))
    return lines


def _setting_line(motor: Motor, flat: FlatEndpoints, one: Setting, values: Mapping[str, Value]) -> Line | None:
    if one.path not in flat.endpoints:
        missing = Line(motor.name, one.path, words(one.wanted), "this firmware has none", Verdict.UNKNOWN)
        return missing if one.needed else None
    if one.path not in values:
        return Line(motor.name, one.path, words(one.wanted), "not read", Verdict.UNKNOWN)
    value = values[one.path]
    right = one.accepts(value)
    todo = "" if right else one.todo or A_YES
    return Line(motor.name, one.path, words(one.wanted), words(value), Verdict.OK if right else Verdict.NO, todo)


def to_set(wanted: Sequence[Setting], values: Mapping[str, Value]) -> list[Setting]:
    """What is not as needed and can be set."""
    return [one for one in wanted if one.writes and one.path in values and not one.accepts(values[one.path])]


def words(value: Value) -> str:
    """As a person writes it."""
    return str(value).lower() if isinstance(value, bool) else f"{value:.7g}"


# -- the numbers in the robot file ------------------------------------------------------------------------------------


def file_options(flat: FlatEndpoints) -> dict[str, str | int]:
    """`options` of a motor whose endpoints are those of this file. Raises EndpointError where it has none."""
    missing = [path for path in (ENABLE, TIMEOUT) if path not in flat.endpoints]
    if missing:
        raise EndpointError(f"flat_endpoints.json of {flat.firmware} has no {', '.join(missing)}")
    enable, timeout = flat.endpoints[ENABLE].number, flat.endpoints[TIMEOUT].number
    return {
        "firmware": flat.firmware,
        "watchdog_enable_endpoint": enable,
        "watchdog_timeout_endpoint": timeout,
        PROOF: f"{flat.firmware} {flat.hardware}",
    }


def file_line(motor: Motor, flat: FlatEndpoints | None) -> Line:
    """Whether the numbers in the robot file are those of the controller."""
    what = IN_FILE
    if motor.watchdog is None:
        found = f"no watchdog: {motor.watchdog_waiver}"
        todo = "--watchdog SECONDS with --endpoints gives it one"
        return Line(motor.name, what, "a command timeout", found, Verdict.UNKNOWN, todo)
    found = _numbers(motor.options)
    if flat is None:
        proven = PROOF in motor.options
        todo = "" if proven else "typed by hand: --endpoints compares them with the vendor's file"
        return Line(motor.name, what, "", found, Verdict.OK if proven else Verdict.UNKNOWN, todo)
    wanted = file_options(flat)
    right = {**motor.options} == wanted
    return Line(
        *(motor.name, what, _numbers(wanted), found), Verdict.OK if right else Verdict.NO, "" if right else A_YES
    )


def _numbers(options: Mapping[str, Value | str]) -> str:
    """Options in words."""
    firmware, *numbers = (str(options.get(key, "none")) for key in OPTIONS)
    return f"{', '.join(numbers)} of {options.get(PROOF, f'{firmware}, hardware unknown')}"


def unproven(config: RobotConfig) -> list[str]:
    """A warning where nobody has compared the numbers with the vendor's file: in another firmware they mean others."""
    names = [
        motor.name for motor in config.motor if motor.options.keys() >= OPTIONS.keys() and PROOF not in motor.options
    ]
    if not names:
        return []
    return [
        f"{', '.join(names)}: nobody knows for which firmware and hardware their endpoints were read; "
        "`drivegate setup prepare FILE --endpoints flat_endpoints.json` compares them and notes it"
    ]


# -- in words, 0.5 ----------------------------------------------------------------------------------------------------


def by_hand(motor: Motor, bus: Bus) -> list[str]:
    """What to type into odrivetool for firmware 0.5; names as in its odrive-interface.yaml."""
    if FIRMWARES[motor.variant].tells_version:
        return []
    speed, control = motor.max_speed * motor.gear_ratio / tau, _control(motor)
    return [
        f"axis = odrv0.axis0   # or axis1: that which drives {motor.name}",
        f"odrv0.can.config.baud_rate = {bus.bitrate}",
        f"axis.config.can.node_id = {motor.id}",
        f"axis.config.can.heartbeat_rate_ms = {SLOWEST_HEARTBEAT_MS}",
        f"axis.config.can.encoder_rate_ms = {rate_ms(motor)}",
        f"axis.controller.config.control_mode = {control.value}   # CONTROL_MODE_{control.name}_CONTROL",
        f"axis.controller.config.input_mode = {tables.INPUT_PASSTHROUGH}   # INPUT_MODE_PASSTHROUGH",
        f"axis.controller.config.vel_limit = {words(speed)}",
        f"axis.motor.config.current_lim = {words(motor.max_current)}",
        "axis.config.watchdog_timeout = 0.5   # s; nobody can read it back over CAN",
        "axis.config.enable_watchdog = True",
        "axis.config.startup_closed_loop_control = False",
        "axis.motor.config.pre_calibrated, axis.encoder.config.pre_calibrated   # True, True once it is calibrated",
        "odrv0.save_configuration()",
    ]
