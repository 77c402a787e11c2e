"""The words of ODrive's firmware 0.5 and 0.6, as its error bits and procedure results are called.

What firmware 0.5 and 0.6 call alike is told once. Meanings were compared entry by entry with the vendor's: those of
0.5 with Firmware/odrive-interface.yaml (github odriverobotics/ODrive, f9b5419c); those of 0.6 with the one line that
its reference has for each error, as public drivers quote it (second hand). Procedure results, the SPI and Hall errors
of the encoder, MODULATION_IS_NAN, CONTROL_DEADLINE_MISSED and REQUESTED_CURRENT_TOO_HIGH have names and numbers alone:
there the meaning is ours, from the name. Causes and cures are the vendor's where it tells any, else ours. The numbers
are held against the vendors' listings in tests/vectors/vendor_errors.toml.
"""

from typing import Final

from gateway.words.contract import Words

_CALIBRATE: Final = "calibrate motor and encoder anew, and save it"
_REBOOT: Final = "switch it off and on"
_TOOL: Final = "look at it with odrivetool (`dump_errors(odrv0)`)"

ODRIVE: Final[dict[str, Words]] = {
    # axis, 0.6
    "INITIALIZING": Words("It is starting, or takes new settings; this passes."),
    "SYSTEM_LEVEL": Words(
        "Of 0.6: something within it failed (memory, a program that hangs). Of 0.5: the whole board has an error.",
        ("0.6: a fault of the firmware or the board", "0.5: voltage or current of the supply, or the brake resistor"),
        (_TOOL, "0.5: measure the supply under load", "0.6: switch it off and on, then a newer firmware"),
    ),
    "TIMING_ERROR": Words(
        "Its processor missed a deadline.", ("too much is switched on in it", "a fault of the firmware"), (_REBOOT,)
    ),
    "MISSING_ESTIMATE": Words(
        "It has no valid position or speed of its motor.",
        ("encoder unplugged, not calibrated, or its index not found", "the wrong encoder chosen in its settings"),
        ("look at the encoder's plug", _CALIBRATE),
    ),
    "BAD_CONFIG": Words("Its settings contradict each other or are incomplete.", ("a new board",), (_TOOL,)),
    "DRV_FAULT": Words(
        "The gate driver chip reports a fault: the power stage was switched off.",
        ("a phase shorted to another or to the housing", "a damaged power stage", "noise from a bad earth"),
        ("unplug the motor and arm it: if it comes again, the board is damaged", "measure the phases"),
    ),
    "MISSING_INPUT": Words(
        "No position, speed or torque was given to it to control with.",
        ("a mode that this driver does not use",),
        (_REBOOT,),
    ),
    "DC_BUS_OVER_VOLTAGE": Words(
        "The supply was above `dc_bus_overvoltage_trip_level`.",
        ("braking into a supply that takes nothing back", "no brake resistor, or it is not enabled"),
        ("brake resistor or a battery", "brake more softly"),
    ),
    "DC_BUS_UNDER_VOLTAGE": Words(
        "The supply was below `dc_bus_undervoltage_trip_level`.",
        ("empty battery", "thin wires", "an emergency stop that cuts the supply"),
        ("charge it", "measure at the board under load"),
    ),
    "DC_BUS_OVER_CURRENT": Words(
        "The board drew more from the supply than `dc_max_positive_current`.",
        ("too low a limit for this load",),
        ("raise it as far as supply and wires bear",),
    ),
    "DC_BUS_OVER_REGEN_CURRENT": Words(
        "The board fed back more than `dc_max_negative_current`.",
        ("braking without a resistor, or with one that is off or too weak",),
        (
            "connect the brake resistor and switch it on in the settings",
            "raise the limit only where a battery takes it",
        ),
    ),
    "CURRENT_LIMIT_VIOLATION": Words(
        "The motor's current was beyond `current_hard_max` (0.6), or `current_lim` and its margin (0.5).",
        ("the current loop swings: a wrong resistance or inductance", "an encoder that slips", "a shorted phase"),
        ("more room: raise that limit above the other", _CALIBRATE, "lower the bandwidth of its current control"),
    ),
    "MOTOR_OVER_TEMP": Words(
        "The motor is too hot.", ("load", "a thermistor with other values"), ("let it cool", "check its settings")
    ),
    "INVERTER_OVER_TEMP": Words(
        "The power stage is too hot.", ("load", "no air"), ("let it cool", "lower `max_current`")
    ),
    "VELOCITY_LIMIT_VIOLATION": Words(
        "The motor was faster than its velocity limit and tolerance.",
        ("a push or a slope", "an encoder that slips", "the loop overshoots"),
        ("more room between `limits.motor_speed` and `max_speed`",),
    ),
    "POSITION_LIMIT_VIOLATION": Words(
        "The motor left its position limits.", ("limits that are set in it",), ("switch them off in it",)
    ),
    "REQUESTED_CURRENT_TOO_HIGH": Words(
        "A calibration or a command asked for more current than it can measure or bear.",
        ("`calibration_current` or `max_current`",),
        ("lower it",),
    ),
    "WATCHDOG_TIMER_EXPIRED": Words(
        "It heard nothing for longer than its watchdog allows, and let the motor go.",
        ("the service was held up, ended or restarted", "the bus was away"),
        ("nothing: the next start clears it", "look for `overrun` and `bus_down` if it comes back"),
    ),
    "ESTOP_REQUESTED": Words(
        "It was told to stop over CAN or by its input.", ("another program or a button",), ("release that",)
    ),
    "SPINOUT_DETECTED": Words(
        "The motor's electrical and mechanical power contradict each other: the encoder is off.",
        ("the encoder slipped on its shaft", "calibrated with another motor or other phases"),
        ("fix the magnet", _CALIBRATE),
    ),
    "BRAKE_RESISTOR_DISARMED": Words(
        "The brake resistor is switched on in the settings, but the board does not use it.",
        ("it was switched on without a restart since", "an error of the whole board, which switched it off"),
        (_REBOOT, _TOOL, "correct its resistance in the settings"),
    ),
    "THERMISTOR_DISCONNECTED": Words(
        "The motor's thermistor is enabled, and not there.",
        ("its plug", "none is fitted"),
        ("plug it in or disable it",),
    ),
    "CALIBRATION_ERROR": Words("A calibration failed.", ("see the procedure result in the text",), (_CALIBRATE,)),
    # axis, 0.5
    "INVALID_STATE": Words(
        "It was asked for a state that it cannot take: it is not calibrated.",
        ("motor or encoder was never calibrated, or the calibration was not saved",),
        (_CALIBRATE, "set `pre_calibrated` of motor and encoder, and save"),
    ),
    "MOTOR_FAILED": Words("See the motor error in the text.", (), (_TOOL,)),
    "SENSORLESS_ESTIMATOR_FAILED": Words(
        "The estimate without an encoder failed.", ("a wrong encoder mode",), (_TOOL,)
    ),
    "ENCODER_FAILED": Words("See the encoder error in the text.", (), (_TOOL,)),
    "CONTROLLER_FAILED": Words(
        "Its controller gave up; behind `motor:` the control of the current.",
        ("see the controller error in the text", "motor or encoder not calibrated"),
        (_TOOL,),
    ),
    "MIN_ENDSTOP_PRESSED": Words(
        "The lower end stop is pressed.", ("end stops are enabled that a wheel has not",), ("disable them",)
    ),
    "MAX_ENDSTOP_PRESSED": Words(
        "The upper end stop is pressed.", ("end stops are enabled that a wheel has not",), ("disable them",)
    ),
    "HOMING_WITHOUT_ENDSTOP": Words(
        "Homing was asked for, and the lower end stop is not enabled.", ("start-up settings",), ("switch homing off",)
    ),
    "OVER_TEMP": Words("Motor or power stage is too hot: see the motor error.", ("load", "no air"), ("let it cool",)),
    "UNKNOWN_POSITION": Words("The position is not known.", ("the encoder's index was not found",), (_CALIBRATE,)),
    "motor error flag": Words("The motor has an error of its own: see the words behind `motor:`.", (), (_TOOL,)),
    "encoder error flag": Words("The encoder has an error of its own: see the words behind `encoder:`.", (), (_TOOL,)),
    "controller error flag": Words(
        "The controller has an error of its own: see the words behind `controller:`.", (), (_TOOL,)
    ),
    # motor, 0.5, and results of procedures, 0.6
    "PHASE_RESISTANCE_OUT_OF_RANGE": Words(
        "The measured resistance of the phases is implausible.",
        ("a phase is not connected", "`calibration_current` or `resistance_calib_max_voltage` too low or too high"),
        ("look at the three phases", "adapt the two settings"),
    ),
    "PHASE_INDUCTANCE_OUT_OF_RANGE": Words(
        "The measured inductance of the phases is implausible.",
        ("a phase is not connected", "an unusual motor"),
        ("look at the three phases",),
    ),
    "CONTROL_DEADLINE_MISSED": Words("Its processor missed a deadline.", ("a fault of the firmware",), (_REBOOT,)),
    "MODULATION_MAGNITUDE": Words(
        "The supply's voltage was too low to drive the current that was asked for.",
        (
            "too high a speed for this supply",
            "in a calibration: `resistance_calib_max_voltage` above half of the supply",
        ),
        ("lower `limits.motor_speed`", "lower `resistance_calib_max_voltage`"),
    ),
    "CURRENT_SENSE_SATURATION": Words(
        "The current was beyond what the board measures.",
        ("`current_lim` is above `requested_current_range`", "a shorted phase"),
        ("raise the range, save and restart", "measure the phases"),
    ),
    "MODULATION_IS_NAN": Words("A number within it is not finite.", ("a wrong setting",), (_REBOOT, _TOOL)),
    "MOTOR_THERMISTOR_OVER_TEMP": Words(
        "The motor is too hot.", ("load", "a thermistor with other values"), ("let it cool",)
    ),
    "FET_THERMISTOR_OVER_TEMP": Words(
        "The power stage is too hot.", ("load", "no air"), ("let it cool", "lower `max_current`")
    ),
    "TIMER_UPDATE_MISSED": Words("Its processor missed a deadline.", ("a fault of the firmware",), (_REBOOT,)),
    "CURRENT_MEASUREMENT_UNAVAILABLE": Words(
        "A current was not measured in time.", ("a fault of the firmware", "a damaged board"), (_REBOOT,)
    ),
    "I_BUS_OUT_OF_RANGE": Words(
        "The current that this motor draws from the supply, or feeds back, is beyond its own limits.",
        ("`I_bus_hard_min` or `I_bus_hard_max` of the motor too close to 0",),
        ("set them wider, or leave them infinite",),
    ),
    "BAD_TIMING": Words("Its loops got out of step.", ("its main loop was stuck",), (_REBOOT,)),
    "UNKNOWN_PHASE_ESTIMATE": Words(
        "The angle of the rotor is not known.", ("encoder unplugged or its index not found",), (_CALIBRATE,)
    ),
    "UNKNOWN_PHASE_VEL": Words("The speed of the rotor is not known.", ("encoder unplugged",), (_CALIBRATE,)),
    "UNKNOWN_TORQUE": Words("No torque was there to control with.", ("an error before this one",), (_TOOL,)),
    "UNKNOWN_CURRENT_COMMAND": Words("No current was there to control with.", ("its settings",), (_TOOL,)),
    "UNKNOWN_CURRENT_MEASUREMENT": Words("The current is not known.", ("an error before this one",), (_TOOL,)),
    "UNKNOWN_VBUS_VOLTAGE": Words("The supply voltage is not known.", ("an error before this one",), (_TOOL,)),
    "UNKNOWN_VOLTAGE_COMMAND": Words("No voltage was there to control with.", ("an error before this one",), (_TOOL,)),
    "UNKNOWN_GAINS": Words("The gains of the current control are not known.", ("not calibrated",), (_CALIBRATE,)),
    "CONTROLLER_INITIALIZING": Words("Its control was not ready.", ("armed too early",), ("try again",)),
    "UNBALANCED_PHASES": Words("The phases differ.", ("a phase is not connected or shorted",), ("measure the phases",)),
    # encoder and controller, 0.5
    "UNSTABLE_GAIN": Words(
        "A bandwidth or gain is so high that its loop would swing.",
        ("encoder bandwidth, or gains of the controller",),
        ("lower it",),
    ),
    "CPR_POLEPAIRS_MISMATCH": Words(
        "The counts of the encoder and the poles of the motor do not fit.",
        (
            *("`cpr` or `pole_pairs` is wrong", "the wheel was blocked while it was calibrated", "the encoder slips"),
            "a motor that cogs",
        ),
        ("count the magnets: pole_pairs is half of them", _CALIBRATE, "raise `calib_scan_distance`, up to fourfold"),
    ),
    "NO_RESPONSE": Words(
        "The encoder does not answer, or did not move when the motor was turned.",
        ("its plug or supply", "the motor did not turn: blocked, or `calibration_current` too low"),
        ("turn it by hand and watch its count",),
    ),
    "UNSUPPORTED_ENCODER_MODE": Words(
        "It does not know this kind of encoder.", ("the encoder's `mode`",), ("correct it",)
    ),
    "ILLEGAL_HALL_STATE": Words(
        "The Hall sensors told what cannot be.",
        ("a wire of the three", "noise: capacitors of 22 nF to earth are usual", "not calibrated polarity"),
        ("look at the three wires",),
    ),
    "INDEX_NOT_FOUND_YET": Words(
        "The encoder's index was not seen since it was switched on.",
        ("no index search at start", "an encoder without an index, or its wire Z is not connected"),
        ("set it up to search at start", "look at wire Z"),
    ),
    "ABS_SPI_TIMEOUT": Words(
        "The absolute encoder does not answer.", ("its cable",), ("shorter wires, its select pin",)
    ),
    "ABS_SPI_COM_FAIL": Words(
        "The absolute encoder's answers are damaged.", ("noise or its cable",), ("shorter wires",)
    ),
    "ABS_SPI_NOT_READY": Words("The absolute encoder was not ready.", ("its supply comes late",), (_REBOOT,)),
    "HALL_NOT_CALIBRATED_YET": Words("The polarity of the Hall sensors is not calibrated.", (), (_CALIBRATE,)),
    "OVERSPEED": Words(
        "The motor was faster than `vel_limit` and its tolerance.",
        ("a push or a slope", "the loop overshoots", "an encoder that slips"),
        ("more room between `limits.motor_speed` and `max_speed`",),
    ),
    "INVALID_INPUT_MODE": Words("Its input mode is none that it knows.", ("a setting of another version",), (_REBOOT,)),
    "INVALID_MIRROR_AXIS": Words("It is to mirror an axis that is not there.", ("its settings",), (_TOOL,)),
    "INVALID_LOAD_ENCODER": Words("The encoder of the load is none that it has.", ("its settings",), (_TOOL,)),
    "INVALID_ESTIMATE": Words(
        "The encoder's estimate is not valid.", ("encoder unplugged or not calibrated",), (_CALIBRATE,)
    ),
    "INVALID_CIRCULAR_RANGE": Words(
        "The encoder told no position within one turn.", ("encoder unplugged or not calibrated",), (_CALIBRATE,)
    ),
    # results of procedures, 0.6
    "SUCCESS": Words("The last procedure ended well."),
    "BUSY": Words("A procedure is still under way."),
    "CANCELLED": Words("The last procedure was cancelled.", ("another command came meanwhile",), ("try again",)),
    "DISARMED": Words("It was disarmed meanwhile.", ("the disarm reason in the text",)),
    "POLE_PAIR_CPR_MISMATCH": Words(
        "The encoder moved otherwise than the poles of the motor say.",
        ("`pole_pairs` is wrong", "the wheel was blocked while it was calibrated"),
        ("count the magnets: pole_pairs is half of them", _CALIBRATE),
    ),
    "INVALID_MOTOR_TYPE": Words("The procedure is not for this motor type.", ("`motor_type`",), ("correct it",)),
    "TIMEOUT": Words("The procedure took too long.", ("a blocked wheel",), ("free it and try again",)),
    "NOT_CALIBRATED": Words("Motor or encoder is not calibrated.", ("the calibration was not saved",), (_CALIBRATE,)),
    "NOT_CONVERGING": Words(
        "The calibration found no stable value.", ("a loose encoder", "a load that moves"), (_CALIBRATE,)
    ),
}
