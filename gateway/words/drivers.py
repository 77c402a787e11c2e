"""Codes with which drivers say why a motor refuses, whatever its vendor calls it; the words of vendors lie beside.

The codes are ours, and so is what is said of them. Those of C620, C610 and GM6020 are found by their driver: the
controllers tell no error over CAN (RoboMaster C610 manual, p. 9: angle, speed and torque, the rest is empty).
"""

from typing import Final

from gateway.words.contract import Words

_RESET: Final = "then `drivegate stop NAME --reset`"

DRIVERS: Final[dict[str, Words]] = {
    "host_silent": Words(
        "The controller got no command for longer than its own timeout, and let its motor go.",
        ("the service was held up or restarted", "the bus was away", "its timeout is shorter than the robot file says"),
        ("nothing, if it passes by itself", "else compare `watchdog` with the controller, and look for `overrun`"),
    ),
    "kill_switch": Words("The controller's own kill switch is on.", ("somebody pressed it",), ("release it",)),
    "no_voltage": Words(
        "The controller tells no input voltage, or far less than `winding.voltage`, so that no duty is sure.",
        ("the supply of the power stage is off", "`winding.voltage` is not that of the supply"),
        ("switch the supply on", "correct `winding.voltage`"),
    ),
    "watchdog_unverified": Words(
        "It is not known that the controller stops by itself when the host falls silent, so it is not driven.",
        (
            "ODrive: another firmware or hardware than its endpoints were read for, where they have other numbers",
            "VESC: its timeout in VESC Tool is off, longer than `watchdog.timeout`, or somebody else commands it",
            "it does not answer: an old firmware, a broken line",
        ),
        (
            "ODrive: `drivegate setup prepare FILE --endpoints flat_endpoints.json`",
            "else set it in the controller as in the robot file; the text names both",
            _RESET,
        ),
    ),
    "no_version": Words(
        "The controller does not answer what firmware it has.",
        ("a firmware of another line than `variant`", "a line that is broken in one direction", "a full bus"),
        ("compare `variant` with the vendor's tool", "look at cable and termination"),
    ),
    "wrong_firmware": Words(
        "The controller has another line of firmware than `variant` says, with other messages.",
        ("a new controller, or one that was updated",),
        ("set `variant` to what it has, or flash it", _RESET),
    ),
    "arming_failed": Words(
        "The controller did not begin to control its motor when it was asked to.",
        ("not calibrated", "an error that it tells in the text", "no supply of the power stage"),
        ("arm it with the vendor's tool and see what that says", "calibrate motor and encoder", _RESET),
    ),
    "disarmed": Words(
        "The controller stopped controlling its motor on its own, without an error.",
        ("motor or encoder was unplugged", "another program disarmed it"),
        ("look at the plugs of motor and encoder", "end other tools on this bus", _RESET),
    ),
    "device_error": Words("The controller reports an error of its own: see the vendor's word in the text."),
    "encoder": Words(
        "The controller cannot rely on its encoder.",
        ("cable or supply of the encoder", "a loose magnet", "not calibrated, or calibrated with another motor"),
        ("look at plug and magnet", "calibrate it anew", _RESET),
    ),
    "motor": Words(
        "The controller cannot rely on its motor or power stage.",
        ("a phase that is cut or shorted", "not calibrated", "a damaged controller"),
        ("measure the phases against each other", "calibrate it anew", _RESET),
    ),
    "controller": Words(
        "The control loop within the controller gave up.",
        ("gains that swing", "a mode that this driver does not use"),
        ("lower its gains", "restore its settings", _RESET),
    ),
    "over_voltage": Words(
        "The supply is above what the controller bears.",
        ("braking feeds the supply, and a battery that is full or a power supply takes nothing back", "a wrong supply"),
        ("a brake resistor, or its settings", "brake more softly: `limits.acceleration`", _RESET),
    ),
    "under_voltage": Words(
        "The supply is below what the controller needs.",
        ("an empty battery", "thin or long supply wires", "the emergency stop cut it", "a weak power supply"),
        ("charge it", "measure at the controller while it accelerates", _RESET),
    ),
    "over_current": Words(
        "More current flowed than is allowed.",
        ("a short circuit or a wrong phase", "gains of the current loop", "limits set close to each other"),
        ("turn the motor by hand without power: it must turn freely", "calibrate it anew", _RESET),
    ),
    "over_temperature": Words(
        "The controller or its motor is too hot.",
        ("more load than it was made for", "no air", "a sensor that is not connected or of another kind"),
        ("let it cool down", "lower `max_current` or `limits.acceleration`", _RESET),
    ),
    "overspeed": Words(
        "The motor turned faster than is allowed in the controller.",
        ("its limit lies too close to `max_speed`", "a push, or a slope", "a loop that overshoots"),
        ("raise the limit in the controller, or lower `limits.motor_speed`", _RESET),
    ),
    "watchdog": Words(
        "The controller's watchdog expired: see host_silent.",
        ("the service was held up or ended", "the bus was away"),
        ("look for `overrun` and `bus_down`",),
    ),
    "estop": Words(
        "The controller was told to stop by somebody else.", ("its own emergency stop input or message",), (_RESET,)
    ),
    "id_twin": Words("Two controllers answer as one id: see fault_twin."),
}
