"""The words of VESC's firmware: `mc_fault_code` of datatypes.h, in the README of its protocol called faults.

Each meaning is what makes the firmware raise it, read where it does (github vedderb/bldc, b9d287b3, firmware 7.00:
motor/mc_interface.c, motor/mcpwm_foc.c, encoder/encoder.c, conf_general.c, flash_helper.c); causes and cures are ours.
The numbers are held against its listing in tests/vectors/vendor_errors.toml.
"""

from typing import Final

from gateway.words.contract import Words

_TOOL: Final = "VESC Tool, terminal: `faults` tells what was measured at that moment"
_SENSOR: Final = ("its cable or supply", "another sensor than is chosen in VESC Tool")
_FLASH: Final = Words(
    "The firmware in its memory is damaged.", ("a supply that was cut while it was written",), ("flash it anew",)
)
_SETTINGS: Final = Words(
    "Its stored settings were damaged, and it runs with those of the factory.",
    ("a supply that was cut while they were written", "another firmware was flashed"),
    ("write all its settings anew in VESC Tool: none is as the robot file needs it", "`drivegate setup prepare`"),
)
_OFFSET: Final = Words(
    "A current sensor shows a current where none flows.",
    ("a damaged sensor or power stage", "the motor turned while it was switched on"),
    ("switch it on with the motor at rest", "another controller if it comes again"),
)
_RESOLVER: Final = Words("The resolver's signals are not sound.", _SENSOR, ("look at its cable",))
_ENCODER: Final = ("look at cable and magnet", "run the encoder detection in VESC Tool")

VESC: Final[dict[str, Words]] = {
    "NONE": Words("No fault."),
    "OVER_VOLTAGE": Words(
        "The supply was above its limit.",
        ("braking into a supply that takes nothing back, or a full battery",),
        ("limit the regenerative current in VESC Tool", "brake more softly"),
    ),
    "UNDER_VOLTAGE": Words(
        "The supply was below its limit.",
        ("an empty battery", "thin wires", "an emergency stop that cuts it"),
        ("measure it under load",),
    ),
    "DRV": Words(
        "The gate driver chip reports a fault.",
        ("a shorted phase", "a damaged power stage"),
        ("unplug the motor and try again: if it comes again, the board is damaged",),
    ),
    "ABS_OVER_CURRENT": Words(
        "The current of the motor was above its absolute limit.",
        ("a current loop that swings: motor detection with another motor", "a shorted phase", "too low a limit"),
        ("run the motor detection anew", _TOOL),
    ),
    "OVER_TEMP_FET": Words(
        "The power stage is too hot; before that it gave less and less current.",
        ("load", "no air"),
        ("let it cool", "lower `max_current`"),
    ),
    "OVER_TEMP_MOTOR": Words(
        "The motor is too hot.",
        ("load", "a sensor of another kind than is set"),
        ("let it cool", "check the sensor's kind"),
    ),
    "GATE_DRIVER_OVER_VOLTAGE": Words(
        "The gate driver's supply is too high.", ("a damaged board",), ("another board",)
    ),
    "GATE_DRIVER_UNDER_VOLTAGE": Words(
        "The gate driver's supply is too low.", ("a weak supply", "a damaged board"), (_TOOL,)
    ),
    "MCU_UNDER_VOLTAGE": Words(
        "The processor's supply is too low.", ("something draws too much from its 5 V or 3.3 V",), ("unplug that",)
    ),
    "BOOTING_FROM_WATCHDOG_RESET": Words(
        "Its processor was restarted by its own watchdog.",
        ("it was just flashed or told to restart: then it means nothing", "a fault of its firmware", "noise"),
        ("switch it off and on", "newer firmware if it comes again"),
    ),
    "ENCODER_SPI": Words("The encoder does not answer, or its answers are damaged.", _SENSOR, _ENCODER),
    "ENCODER_SINCOS_BELOW_MIN_AMPLITUDE": Words(
        "The sine of the encoder is too weak.", ("a magnet too far away", *_SENSOR), _ENCODER
    ),
    "ENCODER_SINCOS_ABOVE_MAX_AMPLITUDE": Words(
        "The sine of the encoder is too strong.", ("a magnet too near", *_SENSOR), _ENCODER
    ),
    "FLASH_CORRUPTION": _FLASH,
    "HIGH_OFFSET_CURRENT_SENSOR_1": _OFFSET,
    "HIGH_OFFSET_CURRENT_SENSOR_2": _OFFSET,
    "HIGH_OFFSET_CURRENT_SENSOR_3": _OFFSET,
    "UNBALANCED_CURRENTS": Words(
        "The three measured currents of the phases do not add up to nothing.",
        ("a current sensor that is broken or not connected", "a phase that has contact with the housing"),
        ("measure the phases against the housing", "another controller if it comes again"),
    ),
    "BRK": Words(
        "Its hardware switched the power stage off, until the next restart.",
        ("a current far beyond its limit",),
        ("measure the phases", "switch it off and on", _TOOL),
    ),
    "RESOLVER_LOT": _RESOLVER,
    "RESOLVER_DOS": _RESOLVER,
    "RESOLVER_LOS": _RESOLVER,
    "FLASH_CORRUPTION_APP_CFG": _SETTINGS,
    "FLASH_CORRUPTION_MC_CFG": _SETTINGS,
    "ENCODER_NO_MAGNET": Words("The encoder sees no magnet.", ("it came off or is too far away",), _ENCODER),
    "ENCODER_MAGNET_TOO_STRONG": Words("The encoder's magnet is too near.", (), _ENCODER),
    "PHASE_FILTER": Words(
        "The voltages measured behind its phase filters are not those that it makes.",
        ("a board without such filters, for which they are switched on", "a damaged board"),
        ("switch the phase filters off in VESC Tool",),
    ),
    "ENCODER_FAULT": Words("The encoder reports a fault of its own.", _SENSOR, _ENCODER),
    "LV_OUTPUT_FAULT": Words("The low-voltage output is overloaded.", ("what hangs from it",), ("unplug that",)),
    "ENCODER_SLIP": Words(
        "The encoder's angle and the one that the motor's currents tell differ by 15 degrees for half a second.",
        ("the magnet or coupling slips", "detected with another motor"),
        _ENCODER,
    ),
    "OVERSPEED": Words(
        "The motor was faster forwards than Max ERPM.",
        ("a push or a slope", "the loop overshoots"),
        ("raise that limit, or lower `limits.motor_speed`",),
    ),
    "UNDERSPEED": Words(
        "The motor was faster backwards than Max ERPM Reverse (counted below 0, hence the name).",
        ("a push or a slope", "the loop overshoots", "a limit for vehicles that hardly go backwards"),
        ("raise that limit, or lower `limits.motor_speed`",),
    ),
    "ABS_OVERSPEED": Words(
        "The motor was faster, either way, than the greater of Max ERPM and Max ERPM Reverse.",
        ("a push or a slope", "an encoder that slips"),
        ("raise the limits, or lower `limits.motor_speed`",),
    ),
}
