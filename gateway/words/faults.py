"""Faults: reasons not to rely on a motor, or not to move at all. Events `fault_…` and `cleared_…`."""

from typing import Final

from gateway.words.contract import Words

_RESET: Final = "then `drivegate stop NAME --reset`: this fault is latched, so that somebody looks first"

FAULTS: Final[dict[str, Words]] = {
    "fault_silent": Words(
        "A motor tells nothing of how it turns, or not all that its driver needs; the text names what is missing.",
        (
            "its supply is off or its fuse is blown",
            "a CAN connector, or the termination: 60 ohm between the two wires of a bus without power",
            "another id or bit rate in the controller than in the robot file",
            "its cyclic messages are switched off or too slow (`feedback_rate`)",
        ),
        (
            "look at the controller's lamp and supply, then at its plug",
            "`drivegate doctor NAME`: state and error counters of the interface",
            "`candump CHANNEL`: do frames with its id arrive, and how often?",
            "set in the controller what the text names; a cure alone clears this fault",
        ),
    ),
    "fault_motor": Words(
        "A controller refuses, in its own words or in those of its driver on its behalf.",
        (
            "what the vendor's word in the text says: `drivegate doctor --explain WORD`",
            "it was disarmed by another program",
        ),
        ("cure what its word names", _RESET, "where the text says `stopped obeying`, no other tool may command it"),
    ),
    "fault_stall": Words(
        "A motor gives all its torque and does not turn, or hardly.",
        (
            "the wheel is blocked: an obstacle, a brake that is on, a gear that jams",
            "`max_torque` or `max_current` is too low for the load or the slope",
            "a motor phase or the encoder is not connected",
            "a GM6020 listens in the other mode than `options.mode` says",
        ),
        ("free the wheel and turn it by hand", "compare the limits with the load (`drivegate check`)", _RESET),
    ),
    "fault_frozen": Words(
        "The encoder of a motor stands still while the wheel does not, so that nobody knows how it turns.",
        ("the encoder's cable or supply", "a magnet or a coupling that came loose", "a controller that hangs"),
        ("turn the wheel by hand and watch `drivegate watch NAME`: does `measured` follow?", "fix the encoder", _RESET),
    ),
    "fault_runaway": Words(
        "A motor turns faster and faster beyond what it is told. Every motor was released at once.",
        (
            "the sign of the encoder against that of the motor, after a new calibration or a swapped phase",
            "a loose encoder, or the wrong number of poles in the controller",
        ),
        ("lift the wheels off the floor", "calibrate the controller anew, turn the wheel by hand and compare", _RESET),
    ),
    "fault_reversed": Words(
        "A wheel turns against its own torque and takes the others along: one of its signs is wrong.",
        ("torque and speed of its controller have different signs", "`direction` of this motor in the robot file"),
        ("lift the wheels off the floor and drive it alone", "correct `direction`, or the controller", _RESET),
    ),
    "fault_torque_lost": Words(
        "The body does not gain what this motor says it gives: its push does not reach the floor.",
        (
            "a coupling, a key or a set screw between motor and wheel; a wheel in the air",
            "a phase that is cut, or a low supply of a motor that is told voltages",
            "`[robot.body]` mass or inertia far from the truth, a heavy load, a slope",
        ),
        ("hold the wheel and turn the motor: does it slip?", "correct `[robot.body]` if it was wrong", _RESET),
    ),
    "fault_following": Words(
        "A motor is far from its setpoint although it has torque to spare.",
        (
            "the gains of its speed controller, or of `speed_loop`, are too low",
            "a limit in the controller below `limits.motor_speed`",
            "the supply does not carry the top speed",
        ),
        ("compare commanded and measured in the recording", "raise gains or lower `limits.motor_speed`", _RESET),
    ),
    "fault_twin": Words(
        "Two controllers answer as one id, so that its numbers jump to and fro between two rotors.",
        ("two controllers with the same id on this bus, often a new one with its id as delivered",),
        ("unplug one of them and give the other an id of its own", "correct `id` in the robot file", _RESET),
    ),
    "fault_position_unknown": Words(
        "Nobody knows at which angle a steered joint stands, and with a wrong angle the wheels drive the wrong way.",
        (
            'its encoder counts from where it was switched on (`encoder = "incremental"`)',
            "its position jumped, or it was silent for so long that it may have restarted",
        ),
        (
            "bring the joint to a known angle, then `drivegate reference NAME --motor MOTOR --angle RAD`",
            "for good: an absolute encoder at the joint, declared as such",
        ),
    ),
    "fault_arming": Words(
        "A motor did not begin to obey in the time that the robot gives it to start.",
        ("the controller refuses without an error: not calibrated, no supply of the power stage, a stop input",),
        ("look at the event before this one", "arm it alone with the vendor's tool", _RESET),
    ),
    "fault_fallen": Words(
        "A robot that balances leans too far, or nobody knows how far. Every motor was let go.",
        ("it was pushed over or ran into something", "its attitude sensor was silent: `sensor_silent`", "its gains"),
        ("hold it upright, then `drivegate stand NAME up` and zero commands",),
    ),
    "fault_bus": Words(
        "A CAN interface can neither send nor receive: its motors are out of reach.",
        (
            "the adapter was unplugged, or the interface is down",
            "nobody acknowledges: motors without supply, a cable, a wrong bit rate",
            "bus-off without an automatic restart",
        ),
        ("`drivegate doctor NAME` names state and cure of each interface", "`ip -details link show CHANNEL`"),
    ),
}
