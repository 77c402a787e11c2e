"""The endpoint table of a simulated ODrive: what RxSdo reads and writes, and what survives a power cycle.

Names and types are those of firmware 0.6 (github odriverobotics/ODriveResources, examples; configurations that users of
0.6 publish); the numbers are ours, as those of every firmware are its own. Those of the watchdog are as the robot file
has them, so that a simulated robot is one that its file fits.
"""

from collections.abc import Mapping
from itertools import count
from struct import Struct

from replay.sim.controllers.contract import MotorSetup
from replay.sim.controllers.odrive_control import CURRENT_LIMIT, VELOCITY_LIMIT, ControlMode, InputMode

HEARTBEAT_MS = "axis0.config.can.heartbeat_msg_rate_ms"
ENCODER_MS = "axis0.config.can.encoder_msg_rate_ms"
TORQUES_MS = "axis0.config.can.torques_msg_rate_ms"
TEMPERATURE_MS = "axis0.config.can.temperature_msg_rate_ms"
BUS_VOLTAGE_MS = "axis0.config.can.bus_voltage_msg_rate_ms"
BAUD_RATE = "can.config.baud_rate"
ENABLE_WATCHDOG = "axis0.config.enable_watchdog"
WATCHDOG_TIMEOUT = "axis0.config.watchdog_timeout"
CALIBRATED = (
    "axis0.config.motor.phase_resistance_valid",
    "axis0.config.motor.phase_inductance_valid",
    "axis0.commutation_mapper.config.offset_valid",
)

_LAYOUTS = {"bool": Struct("<?"), "uint8": Struct("<B"), "uint32": Struct("<I"), "float": Struct("<f")}
# Types and factory values. Of the rates those that are not 0 are those of 0.5, which is public.
_FACTORY: dict[str, tuple[str, float]] = {
    BAUD_RATE: ("uint32", 250_000),
    "axis0.config.can.node_id": ("uint32", 0x3F),
    HEARTBEAT_MS: ("uint32", 100),
    ENCODER_MS: ("uint32", 10),
    TORQUES_MS: ("uint32", 0),
    TEMPERATURE_MS: ("uint32", 0),
    BUS_VOLTAGE_MS: ("uint32", 0),
    ENABLE_WATCHDOG: ("bool", 0.0),
    WATCHDOG_TIMEOUT: ("float", 0.0),
    "axis0.controller.config.control_mode": ("uint8", ControlMode.POSITION),
    "axis0.controller.config.input_mode": ("uint8", InputMode.PASSTHROUGH),
    "axis0.controller.config.vel_limit": ("float", VELOCITY_LIMIT),
    "axis0.config.motor.current_soft_max": ("float", CURRENT_LIMIT),
    "axis0.config.motor.current_hard_max": ("float", 2.0 * CURRENT_LIMIT),
    "axis0.config.startup_motor_calibration": ("bool", 0.0),
    "axis0.config.startup_closed_loop_control": ("bool", 0.0),
    **dict.fromkeys(CALIBRATED, ("bool", 0.0)),
}
_FIRST = 300


class Parameters:
    """Settings by name. Writes live in RAM; `save` makes them survive (Reboot with payload 1).

    As commissioned: rates, limits, id and bit rate as the robot file has them, calibrated, the watchdog off.
    `stuck`: names of those that keep their value whatever is written.
    """

    def __init__(self, setup: MotorSetup, *, over_usb: bool, rates_ms: Mapping[str, float]) -> None:
        timeout = setup.watchdog_s
        self.numbers = _numbers(setup)
        self.stuck: set[str] = set()
        self._names = {number: name for name, number in self.numbers.items()}
        self._factory = {name: value for name, (_, value) in _FACTORY.items()}
        self._saved = {**self._factory, **_commissioned(setup), **rates_ms, **dict.fromkeys(CALIBRATED, 1.0)}
        if timeout is not None and over_usb:
            self._saved |= {ENABLE_WATCHDOG: 1.0, WATCHDOG_TIMEOUT: timeout}
        self.reboot()

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def put(self, values: Mapping[str, float]) -> None:
        """In RAM alone."""
        self._put({**self._values, **values})

    def reboot(self) -> None:
        """Take the saved values."""
        self._put(dict(self._saved))

    def save(self) -> None:
        self._saved = dict(self._values)

    def erase(self) -> None:
        """Back to the factory values."""
        self._saved = dict(self._factory)

    def read(self, endpoint: int) -> bytes | None:
        """Value as on the wire; None: no such endpoint."""
        name = self._names.get(endpoint)
        return None if name is None else _packed(name, self._values[name])

    def write(self, endpoint: int, value: bytes) -> None:
        """Store a value; unknown endpoints and short values are ignored."""
        name = self._names.get(endpoint)
        if name is None or name in self.stuck:
            return
        layout = _LAYOUTS[_FACTORY[name][0]]
        if len(value) >= layout.size:
            self._put(self._values | {name: float(layout.unpack_from(value)[0])})

    def document(self) -> dict[str, dict[str, object]]:
        """`endpoints` of the vendor's flat_endpoints.json."""
        return {
            name: {"id": number, "type": _FACTORY[name][0], "access": "rw"} for name, number in self.numbers.items()
        }

    def _put(self, values: dict[str, float]) -> None:
        self._values = values
        self.watchdog_enabled = bool(values[ENABLE_WATCHDOG])
        self.watchdog_timeout = values[WATCHDOG_TIMEOUT]  # s


def _packed(name: str, value: float) -> bytes:
    kind = _FACTORY[name][0]
    return _LAYOUTS[kind].pack(value if kind == "float" else bool(value) if kind == "bool" else round(value))


def _numbers(setup: MotorSetup) -> dict[str, int]:
    keys = {ENABLE_WATCHDOG: "watchdog_enable_endpoint", WATCHDOG_TIMEOUT: "watchdog_timeout_endpoint"}
    given = {name: int(setup.options[key]) for name, key in keys.items() if key in setup.options}
    free = (number for number in count(_FIRST) if number not in given.values())
    return {name: given[name] if name in given else next(free) for name in _FACTORY}


def _commissioned(setup: MotorSetup) -> dict[str, float]:
    found = {
        "axis0.config.can.node_id": float(setup.id),
        "axis0.config.motor.current_hard_max": 1.5 * setup.max_current,
    }
    return found if setup.bitrate is None else found | {BAUD_RATE: float(setup.bitrate)}
