"""The values that flow through one cycle of the core. Plain, immutable, SI; unknown is None."""

from enum import Enum
from typing import NamedTuple

from drivers.contract import CanFrame


class Twist(NamedTuple):
    """Body velocity (a rate, not wpilib's displacement): x forward, y left, wz counter-clockwise; m/s, rad/s."""

    vx: float
    vy: float
    wz: float


class Displacement(NamedTuple):
    """A way of the body in its own frame at the start of it: m, m, rad (what wpilib calls Twist2d)."""

    x: float
    y: float
    turn: float


class Pose(NamedTuple):
    """Position of `base_link` in `odom`: m, rad (REP-103, REP-105)."""

    x: float
    y: float
    theta: float


# One number per axis of the body, in the order in which the kinematics names them: those of a Twist, and what a chassis
# may have more, in m/s or rad/s. A Twist is one of a chassis that has no more.
Rates = tuple[float, ...]
PLANAR: tuple[str, ...] = Twist._fields

ZERO_TWIST = Twist(0.0, 0.0, 0.0)
NO_DISPLACEMENT = Displacement(0.0, 0.0, 0.0)


class Mode(Enum):
    """Operating state of the robot; the transitions are one table in `gateway.core.supervisor`."""

    IDLE = "idle"  # motors released, waiting for a fresh zero command
    STARTING = "starting"  # arming the motors, robot held at rest
    DRIVE = "drive"
    DEGRADED = "degraded"  # a motor is lost, the others still reach every direction
    STOPPING = "stopping"  # ramping to rest
    ESTOP = "estop"  # latched emergency stop
    FAULT = "fault"  # a reason not to move; see Status.faults

    __hash__ = object.__hash__  # of an enumeration it is a function of Python, called by every look-up in a dict


class TwistFrame(Enum):
    """The frame a commanded twist is expressed in."""

    BODY = "body"
    ODOM = "odom"


class Region(Enum):
    """Which way round a chassis whose wheels lead or trail its body is to go."""

    ANY = "any"
    PUSH = "push"  # the body in front of the wheels, which push it
    PULL = "pull"  # the wheels in front

    __hash__ = object.__hash__


class TwistCommand(NamedTuple):
    """A valid request from outside. `received_ns`: from when its age counts, never after its arrival.

    `stamped`: the sender told when it was sent, and `received_ns` allows for the delay on its way.
    `sender`: which of the processes that may use this source; None where it does not say.
    `width_rate`: m/s by which the wheels go apart; `width`: m to go to and to keep, never beside a rate; `path_rate`:
    rad/s by which the direction of the path turns, a hint.
    What of these and of the regions a chassis can do is said by its drive law.
    """

    source: str
    twist: Twist
    frame: TwistFrame
    sequence: int | None
    received_ns: int
    sender: str | None = None
    stamped: bool = False
    width_rate: float | None = None
    path_rate: float | None = None
    region: Region = Region.ANY
    width: float | None = None

    @property
    def still(self) -> bool:
        """Whether it asks for no motion of any kind."""
        return self.twist == ZERO_TWIST and not self.width_rate and self.width is None


class SensorKind(Enum):
    """What a sensor tells, over Zenoh or on a bus."""

    HEADING = "heading"  # rad about the vertical, counter-clockwise, from any zero, wrapped or not: a gyro, an IMU
    ATTITUDE = "attitude"  # roll and pitch, rad; rates about x, y, z of the body, rad/s
    RANGE = "range"  # m to what is in front of the sensor, or drawn out of it


class Attitude(NamedTuple):
    """How the body leans: rad, of REP-103's axes; and how it turns, rad/s, None where the sensor does not tell."""

    roll: float
    pitch: float
    roll_rate: float | None = None
    pitch_rate: float | None = None
    yaw_rate: float | None = None


class SensorSample(NamedTuple):
    """What one sensor told. `values`: in the order of its kind (one number, or the fields of Attitude).

    `source`: the sensor's name in the robot file; the rest as of a TwistCommand.
    """

    source: str
    values: tuple[float | None, ...]
    sequence: int | None
    received_ns: int
    sender: str | None = None
    stamped: bool = False


class RefusalCode(Enum):
    """Why a command, or a sample of a sensor, from the wire was not taken."""

    NOT_A_PUT = "not_a_put"
    KEY_NOT_EXACT = "key_not_exact"
    TOO_LONG = "too_long"
    MALFORMED = "malformed"
    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    WRONG_FRAME = "wrong_frame"
    UNKNOWN_SOURCE = "unknown_source"
    UNKNOWN_SENSOR = "unknown_sensor"
    OLD_SEQUENCE = "old_sequence"
    STALE = "stale"  # its stamp says that it was too long on its way
    UNSUPPORTED = "unsupported"  # this chassis cannot do it
    SECOND_SENDER = "second_sender"  # another sender holds this source


class Refusal(NamedTuple):
    """A command or sample that was not taken: who (as far as known), why, and the words for a person."""

    source: str
    code: RefusalCode
    text: str
    received_ns: int


class RequestKind(Enum):
    """Requests that are not twists."""

    ESTOP = "estop"
    RESET = "reset"
    SHUTDOWN = "shutdown"
    REFERENCE = "reference"  # somebody says at which angle a steered joint stands now
    SET = "set"  # another value of a setting
    STAND_UP = "stand_up"  # somebody holds a robot that is to balance
    LET_DOWN = "let_down"  # somebody holds a robot that is to balance no more
    MARK = "mark"  # a person's words to be found in the recording; nothing comes of it


class Request(NamedTuple):
    """One request; `id` ties the reply to it (0: nobody waits for a reply).

    Only of a REFERENCE: `motor`, None for the only steered joint, and `angle`, rad at the output from its zero.
    Only of a SET: `setting`, its name, and `value`, in its unit. Only of a MARK: `text`, the words.
    """

    kind: RequestKind
    id: int
    received_ns: int
    motor: str | None = None
    angle: float | None = None
    setting: str | None = None
    value: float | None = None
    text: str | None = None


class BusEventKind(Enum):
    """What a bus edge noticed since the last cycle."""

    DOWN = "down"  # cannot send or receive; interface gone, down or queue stuck
    UP = "up"
    TX_DROPPED = "tx_dropped"  # frames of a cycle that could not be sent in it
    BUS_OFF = "bus_off"
    ERROR_PASSIVE = "error_passive"
    ERROR_ACTIVE = "error_active"
    RESTARTED = "restarted"
    RX_OVERFLOW = "rx_overflow"
    RX_MALFORMED = "rx_malformed"  # the adapter handed over what the bus cannot carry: dropped


class BusEvent(NamedTuple):
    """One bus event with its count and the system's own words."""

    bus: str
    kind: BusEventKind
    occurrences: int
    text: str


class Inputs(NamedTuple):
    """Everything one step may know, and nothing else. `overruns`, `dropped_records`: totals since start."""

    cycle: int
    now_ns: int
    frames: tuple[CanFrame, ...] = ()
    commands: tuple[TwistCommand, ...] = ()
    refusals: tuple[Refusal, ...] = ()
    requests: tuple[Request, ...] = ()
    bus_events: tuple[BusEvent, ...] = ()
    samples: tuple[SensorSample, ...] = ()
    overruns: int = 0
    dropped_records: int = 0


class Level(Enum):
    """Weight of an event: warning is something a person should look at, error stopped the robot."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class Event(NamedTuple):
    """One thing that happened, for people and programs: `code` is stable, `text` explains."""

    level: Level
    code: str
    text: str


class Reply(NamedTuple):
    """Answer to the request with the same id; `reason` is None when it was granted."""

    id: int
    ok: bool
    reason: str | None


class Growth(NamedTuple):
    """By how much the covariance of wheel odometry grows: variances per metre and per radian that were driven.

    As they are here: 2 % of a metre after a metre, as usual on a hard floor. Source: chosen by us until a robot has
    been measured (`drivegate setup covariance`); stated in the README.
    """

    position: float = 4e-4  # m^2/m
    heading_turning: float = 4e-4  # rad^2/rad
    heading_driving: float = 1e-4  # rad^2/m


CHOSEN_GROWTH = Growth()


class Odometry(NamedTuple):
    """Pose from measured wheel motion. `twist` None: not measurable now. `covariance`: 3x3 row-major (x, y, theta)."""

    pose: Pose
    twist: Twist | None
    covariance: tuple[float, ...]
    residual: float | None  # m/s; None where the wheels carry no redundancy


class MotorStatus(NamedTuple):
    """One motor in words and numbers, at its output (after the gear)."""

    name: str
    state: str
    commanded: float | None  # rad/s; None: released
    measured: float | None  # rad/s
    torque: float | None  # N m
    voltage: float | None
    temperature_c: float | None
    fault: str | None
    age_s: float | None


class SourceStatus(NamedTuple):
    """One command source: its age and why it is not driving (None: it is)."""

    name: str
    age_s: float | None
    reason: str | None


Facts = dict[str, float | str | bool | None]  # what only a kind of chassis knows of itself, by name, for `state`


class EffectiveMotors(NamedTuple):
    """How hard the robot can push itself along the ground without turning, in motors of which none is wasted.

    In steps of 15 degrees from forward to the left, up to 165; what goes one way goes the other way too. To 0.001.
    """

    every: tuple[float, ...]  # as built
    usable: tuple[float, ...]  # what is left of it


class AbilityStatus(NamedTuple):
    """What the robot can do with the motors it has left. `rank`: number of independent ways to move.

    `effort`: share of its acceleration, `speed`: of its top speeds. `reachable`: where ways are lost, the furthest
    twist along each that is left; `lost`: along the others, which it no longer controls. Both empty: nothing is lost.
    """

    rank: int
    effort: float
    speed: float
    reachable: tuple[Twist, ...]
    lost: tuple[Twist, ...]
    effective_motors: EffectiveMotors | None = None  # None: they change with the angle of a joint


class SensorStatus(NamedTuple):
    """One sensor: what it tells (None: nothing that is believed), its age, how often it jumped.

    `reason`: why nothing of it is believed; None while something is.
    """

    name: str
    kind: str
    values: tuple[float | None, ...] | None
    age_s: float | None
    jumps: int
    reason: str | None = None


class SettingStatus(NamedTuple):
    """One setting that may be changed while the robot runs, and from where to where."""

    name: str
    value: float
    unit: str
    low: float
    high: float


class SlipStatus(NamedTuple):
    """Slip of the wheels. `wheels`: those that slip, where that is known, and `evidence` by which. `tells`: in words.

    `threshold`: m/s at the rim beyond which the residual of a wheel is slip, of the wheel nearest to it; None while all
    of them are far from it.
    """

    slipping: bool
    wheels: tuple[str, ...]
    evidence: tuple[str, ...]
    threshold: float | None
    tells: str


class Status(NamedTuple):
    """What a person or a fleet manager wants to know of the robot, at the status rate."""

    mode: Mode
    reason: str | None  # what the robot waits for, or why it does not move
    faults: tuple[str, ...]
    winner: str | None
    winner_age_s: float | None
    sources: tuple[SourceStatus, ...]
    motors: tuple[MotorStatus, ...]
    limits_active: tuple[str, ...]
    stop_category: int  # what an emergency stop ends in: 1 released at rest, 2 held at rest (IEC 60204-1)
    standing: bool | None
    pose: Pose
    twist: Twist | None
    refused: int  # commands and samples refused since start
    tx_dropped: int
    overruns: int
    dropped_records: int
    cycle: int
    ability: AbilityStatus
    chassis: Facts
    sensors: tuple[SensorStatus, ...] = ()
    settings: tuple[SettingStatus, ...] = ()
    slip: SlipStatus | None = None  # None: of a chassis with no wheels that could be held against each other


class AxisTrace(NamedTuple):
    """One axis of the body beyond its twist; None: not measurable now."""

    target: float
    setpoint: float
    measured: float | None


class Trace(NamedTuple):
    """One cycle for plots; None where there was nothing to measure. Not compared by verify."""

    target: Twist  # what the winner asks for, in the body frame
    setpoint: Twist  # after limits
    measured: Twist | None
    pose: Pose
    wheel_setpoints: tuple[float | None, ...]  # rad/s at the wheel; None: released
    wheel_speeds: tuple[float | None, ...]
    wheel_positions: tuple[float | None, ...]  # rad at the output
    winner_age_s: float | None
    residual: float | None
    residuals: tuple[float | None, ...] | None  # m/s at the rim of each wheel; None where they carry no redundancy
    chassis: tuple[float | None, ...] = ()  # numbers that its drive law tells, for the channels of its kind
    more: tuple[AxisTrace, ...] = ()  # axes of the kinematics beyond the twist
    heading: float | None = None  # rad, as the sensor tells it
    attitude: Attitude | None = None
    ranges: tuple[float | None, ...] = ()  # m, of the range sensors in the order of the robot file


class Outputs(NamedTuple):
    """Everything one step says. `odometry` and `status` are present only in the cycles in which they are due."""

    frames: tuple[CanFrame, ...]
    mode: Mode
    events: tuple[Event, ...]
    replies: tuple[Reply, ...]
    odometry: Odometry | None
    status: Status | None
    trace: Trace
    finished: bool  # a requested shutdown has come to rest


class CycleTiming(NamedTuple):
    """How the loop kept time; measured by the service, recorded for people, never an input of the core."""

    late_ns: int  # start of the cycle after its deadline
    work_ns: int  # drain + step + send
    wall_ns: int  # CLOCK_REALTIME at the start of the cycle


class Sample(NamedTuple):
    """What is drawn of one cycle (`gateway.core.samples`).

    It stands for the cycles from `since` on, of which nothing else is drawn.
    `late_ns`, `work_ns`: the worst since the last plotted one. `trace`: of a cycle that is plotted or pictured.
    """

    since: int
    cycle: int
    wall_ns: int
    mode: Mode
    plotted: bool
    pictured: bool
    late_ns: int
    work_ns: int
    trace: Trace | None
    status: Status | None
    events: tuple[Event, ...]
    frames_in: tuple[CanFrame, ...]
    frames_out: tuple[CanFrame, ...]
