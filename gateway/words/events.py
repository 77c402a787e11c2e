"""Everything else that `<robot>/event` tells, by its code."""

from typing import Final

from gateway.words.contract import Words

_STRANGER: Final = "`drivegate watch NAME` names the sources of the robot"

EVENTS: Final[dict[str, Words]] = {
    # the mode
    "mode_idle": Words("The motors are released; a fresh zero command starts the robot, and nothing else does."),
    "mode_starting": Words("The motors are being armed; the robot stands."),
    "mode_drive": Words("The robot drives as commanded."),
    "mode_degraded": Words(
        "A motor is lost, and the robot drives with those that are left: slower to speed up, or limping.",
        ("the fault that was told before this",),
        (
            "`drivegate watch NAME` names the motor",
            "`drivegate doctor --explain` its fault; back to all only through rest",
        ),
    ),
    "mode_stopping": Words(
        "The robot comes to rest.",
        ("no fresh command: the commander is silent, slow, or gone", "the service is ending"),
        ("a commander sends 20 to 50 times a second; look at its timeout in `commands.source`",),
    ),
    "mode_estop": Words(
        "Emergency stop: braked at once, and latched, over a restart too.",
        ("somebody asked for it: `drivegate stop`, a key, a button", "it was latched before this start: `estop_kept`"),
        ("look round", "`drivegate stop NAME --reset`; then each commander has to send zero first"),
    ),
    "mode_fault": Words(
        "Something that is needed to move failed; what still obeys comes to rest.",
        ("the fault that was told before this",),
        ("cure that", "where it is latched `drivegate stop NAME --reset`; else the mode ends by itself, at rest"),
    ),
    # CAN
    "bus_down": Words(
        "A CAN interface does not work; the text has the system's words.",
        ("unplugged or set down", "its queue is stuck: nobody acknowledges", "an adapter that does not return"),
        ("`drivegate doctor NAME`", "`ip link set CHANNEL up`; install.sh sets it up for every boot"),
    ),
    "bus_up": Words("A CAN interface works again. The motors on it are heard anew, and the robot starts from rest."),
    "bus_tx_dropped": Words(
        "Frames of a cycle could not be sent in it and were dropped: old setpoints must not wait in a queue.",
        (
            "the bus is fuller than `drivegate check` counts: other traffic",
            "a short transmit queue",
            "a bus going down",
        ),
        ("`canbusload CHANNEL@BITRATE`", "`ip link set CHANNEL txqueuelen 64`", "a lower `loop.rate`"),
    ),
    "bus_bus_off": Words(
        "The CAN controller took itself off the bus after too many errors.",
        ("a short circuit of the wires", "a wrong bit rate, here or in a motor", "no or too much termination"),
        ("measure 60 ohm between the wires without power", "compare the bit rates", "`restart-ms 100` brings it back"),
    ),
    "bus_error_passive": Words(
        "The CAN controller counts many errors and holds back.",
        ("nobody acknowledges: no motor has power, a cable", "a wrong bit rate", "noise, a stub that is too long"),
        ("look at supply and plugs", "compare the bit rates", "check the termination"),
    ),
    "bus_error_active": Words("The CAN controller counts few errors again."),
    "bus_restarted": Words("The CAN controller went back on the bus after bus-off."),
    "bus_rx_overflow": Words(
        "Frames came faster than they were read, and some are lost.",
        ("another program, or a very high rate of feedback", "a loaded computer"),
        ("`candump CHANNEL`: what is so frequent?", "look at `top`; run by the unit, which has real time"),
    ),
    "bus_rx_malformed": Words(
        "The adapter handed over what a CAN bus cannot carry; it was dropped.",
        ("CAN FD frames on a bus without `fd = true`", "a fault of the adapter's driver"),
        ("`fd = true`, or take the sender off this bus", "another adapter, or a newer driver"),
    ),
    # commands and samples that were not taken
    "refused_not_a_put": Words("A message on a command key was no put, and moved nothing.", ("a delete was sent",)),
    "refused_key_not_exact": Words(
        "A message was put on a wildcard, and moved nothing: it might have meant other robots too.",
        ("a key with * in it",),
        ("put on `<robot>/cmd/twist/<source>` itself",),
    ),
    "refused_too_long": Words("A message was longer than any of ours.", ("something else is put on this key",)),
    "refused_malformed": Words(
        "A message is not what its key takes.",
        ("no JSON, a missing or unknown field, a text for a number",),
        ("compare with the table `The Zenoh interface` of the README; the text names what is wrong",),
    ),
    "refused_not_finite": Words("A number is not finite (NaN or infinity).", ("a division by zero in the commander",)),
    "refused_out_of_range": Words(
        "A number is beyond what any robot drives: 20 m/s, 50 rad/s, or the range of its field.",
        ("degrees for radians, millimetres for metres",),
        ("all is in SI; the text names the range",),
    ),
    "refused_wrong_frame": Words('The frame is neither "body" nor "odom".', (), ('leave `frame` out for "body"',)),
    "refused_unknown_source": Words(
        "The key names a source that is not in the robot file.",
        ("a typing error in `--source` or the key",),
        (_STRANGER,),
    ),
    "refused_unknown_sensor": Words(
        "The key names a sensor that is not in the robot file, or is one on a bus.",
        ("a typing error", "no `[[sensor]]` of this name"),
        ("`drivegate check FILE` lists the sensors",),
    ),
    "refused_old_sequence": Words(
        "Its number is not above the last one of this sender.",
        ("messages that overtook each other", "two programs with one name as `sender`", "a counter that starts anew"),
        ("draw a new `sender` at each start, or leave `seq` out",),
    ),
    "refused_stale": Words(
        "It waited longer on its way than its source may be silent.",
        ("a stalled network, a commander that was held up", "a `stamp` of a clock that stands still in sleep"),
        ("look at the network", "stamp with CLOCK_BOOTTIME"),
    ),
    "refused_unsupported": Words(
        "This chassis cannot do what was asked: another width, a region, or an axis it has not.",
        (),
        ("the text says which; a region needs `[robot.manoeuvre]`",),
    ),
    "refused_second_sender": Words(
        "Another program holds this source until it has been silent for its timeout.",
        ("two commanders with the same `--source`", "a commander that was restarted at once"),
        ("give each program a source of its own; the priorities choose between them",),
    ),
    # what was asked
    "reset": Words("An emergency stop was released, or latched faults were forgotten; nothing moves by that."),
    "reset_refused": Words(
        "The robot was not reset; the text says why.",
        ("a commander still asks for motion", "it is not known to stand", "a joint angle is unknown"),
        ("let go of the keys, or stop the commander", "wait until it stands"),
    ),
    "reference": Words("Somebody said at which angle a steered joint stands, and the robot believes it."),
    "reference_refused": Words(
        "The angle of a joint was not taken; the text says why.",
        ("the motor is none of a steered joint, or not heard", "the robot is not at rest and released"),
        ("at rest, in `idle` or an emergency stop: `drivegate reference NAME --motor MOTOR --angle RAD`",),
    ),
    "set": Words("A setting has another value until the robot is restarted."),
    "set_refused": Words(
        "A setting keeps its value; the text says why.",
        ("no such setting on this robot", "beyond its range"),
        ("`drivegate watch NAME --json` shows all settings and their ranges",),
    ),
    "stand_up": Words("Somebody holds a robot that balances; it stands up with the next zero command within 10 s."),
    "stand_up_refused": Words(
        "The robot does not stand up; the text says why.",
        ("it leans too far", "its attitude is not known", "it balances not at all"),
        ("hold it upright and ask again",),
    ),
    "let_down": Words("Somebody holds a robot that balances; it lets go within a second."),
    "let_down_refused": Words(
        "The robot goes on standing; the text says why.",
        ("somebody still commands it", "it does not stand"),
        ("stop every commander, hold it, and ask again",),
    ),
    "mark": Words("A person's words, to be found again in the recording; the seconds around them are an incident."),
    "mark_refused": Words(
        "A person's mark was not taken; the text says why.",
        ("no words, too many of them, or more than one line",),
        ('`drivegate mark NAME "WORDS"`, 1 to 200 characters',),
    ),
    # time, recording, the service itself
    "overrun": Words(
        "The loop missed its deadline, so that a cycle was left out.",
        ("a loaded computer", "no real-time scheduling", "a `loop.rate` beyond this computer"),
        ("`drivegate doctor NAME`", "run by the unit, which grants real time", "lower `loop.rate`"),
    ),
    "dropped_records": Words(
        "Cycles are missing in the recording: it could not keep up.",
        ("a slow or full disk", "a loaded computer"),
        ("`drivegate doctor NAME`: the disk", "put `recording.directory` on a faster disk"),
    ),
    "gap": Words(
        "In a recording: here cycles are missing, and `drivegate replay verify` says so.", ("`dropped_records`",)
    ),
    "recorder_lost": Words(
        "The recorder failed; the robot drives on without a recording.",
        ("the disk", "it was killed for its memory"),
        ("the log says why: `journalctl -u drivegate@ROBOT`",),
    ),
    "incident": Words("The seconds around a fault, a stop or a mark were kept in a file; the text is its path."),
    "incident_lost": Words(
        "The seconds around a fault, a stop or a mark were not kept; the text says why.",
        ("the disk is full", "the recorder was killed meanwhile", "a budget below the size of one file"),
        ("make room", "a larger `recording.incidents.budget`"),
    ),
    "view": Words("Of the live view, not of the robot: it is silent, or heard again."),
    "view_lost": Words(
        "The live view failed; the robot drives on, and is recorded as before.",
        ("a bug: nothing from outside should do that",),
        ("the log has the error; a restart at rest brings the view back",),
    ),
    "events_lost": Words(
        "Events came faster than they could be published; the newest ones are told.", ("a stalled link",)
    ),
    "link_lost": Words(
        "The Zenoh link ended, so no command can come. The robot comes to rest, and the service ends and restarts.",
        ("a fault inside of Zenoh",),
        ("the log has its words",),
    ),
    "core_bug": Words(
        "A fault of DriveGate itself: it brakes to rest, lets go, and ends with exit code 70.",
        (),
        ("report it with the recording: `drivegate replay verify SESSION` shows it again",),
    ),
    "estop_kept": Words(
        "The emergency stop of before this start is kept.",
        ("the service ended in an emergency stop", "the file that keeps it cannot be read, which counts as set"),
        ("`drivegate stop NAME --reset`", "look at the directory of `--state`: rights, disk"),
    ),
    "estop_not_on_disk": Words(
        "The emergency stop holds, but would not outlive a restart: it could not be written.",
        ("the directory of `--state` cannot be written, or its disk is full or hangs",),
        ("cure that, or give another `--state DIR`",),
    ),
    # sensors and slip
    "sensor_silent": Words(
        "A sensor tells nothing that is believed; the text says why.",
        ("its supply or cable", "its publisher ended or is too slow", "id or rate in the robot file"),
        ("`drivegate doctor NAME` has a line for each sensor",),
    ),
    "sensor_heard": Words("A sensor is believed again."),
    "sensor_jump": Words(
        "What a sensor tells changed by more than the robot can move; it is not believed.",
        ("it was restarted or knocked", "degrees for radians", "another sender of the same sensor"),
        ("compare its numbers with a slow turn by hand",),
    ),
    "slip": Words(
        "The wheels together fit no rigid motion: one of them slips, the named one where that is known.",
        ("oil, water, a threshold, a lifted wheel", "a wrong wheel radius or pose in the robot file, if it never ends"),
        ("slower, or lower `limits.acceleration`; `[robot.grip]` keeps launches below the floor's friction",),
    ),
    "slip_over": Words("All wheels grip."),
    "launch_slipped": Words(
        "The wheels slipped in a launch; the friction was taken down to what the floor gave, for this run.",
        ("`robot.grip.friction` is above that of this floor",),
        ("`drivegate calibrate slip FILE --surface WORDS` measures it",),
    ),
    "limp_ended": Words(
        "Limping came to move the robot as no motor left can change, so it was ended.",
        ("a robot led by two wheels ahead of its middle turns away by itself",),
        ('send zero first, then drive slower; `[degraded] motor_lost = "stop"` does not limp',),
    ),
    "balance_lost": Words(
        "A robot that balances has lost a motor, and will fall within seconds.", (), ("take hold of it",)
    ),
    # a trailing chassis
    "pull_lost": Words(
        "A pulled chassis left the region in which it is kept, and flips round behind the robot.",
        ("a push", "a slope", "`robot.compensation.region` is too small for this speed"),
        ("keep clear; slower, or a larger region",),
    ),
    "manoeuvre_planned": Words("The chassis is turned round first; the text tells form, footprint and time."),
    "manoeuvre_done": Words("The chassis lies as it was asked for."),
    "manoeuvre_ended": Words(
        "The manoeuvre ended before its end; the robot brakes along the piece at work.",
        ("another or no command", "wheels that slip, a push", "an emergency stop or a fault"),
        ("command it anew from rest",),
    ),
    "region_refused": Words(
        "The robot stays at rest: the region that was asked for cannot be had from here; the text says why.",
        ("a footprint beyond `robot.manoeuvre.max_footprint`", "a motor is lost", "gains that keep nothing pulled"),
        ("another direction, or a larger `max_footprint`",),
    ),
    "region_lost": Words(
        "The chassis left the region it was asked to keep; the robot brakes and waits for zero.",
        ("a push", "wheels that slip", "a setting that was changed"),
        ("send zero, then ask for the region again",),
    ),
    # a width that changes
    "width_sensed": Words("The width is that of its sensor."),
    "width_by_wheels": Words(
        "The width sensor is not believed: the width is what the wheels add up to, changed at half the rate.",
        ("`sensor_silent` of this sensor", "a jump: the wire was plucked"),
        ("look at the sensor",),
    ),
    "width_held": Words(
        "The width has gone by the wheels alone for too long, and is held.",
        ("the width sensor is still not believed",),
        ("cure the sensor; released and at rest it is taken anew",),
    ),
    "width_disputed": Words(
        "Sensor and wheels part bit by bit, and nothing tells which is right: the width is held.",
        ("the wire is caught", "a slide is stuck", "wheels that slip"),
        ("free wire and slides; released and at rest the sensor is taken anew",),
    ),
}
