"""Every Zenoh key of a robot, once; the robot's name stands before each. Payloads are in `gateway.edges.messages`."""

STOP = "cmd/stop"  # anything put here is an emergency stop
RESET = "cmd/reset"  # asked
REFERENCE = "cmd/reference"  # asked
SET = "cmd/set"  # asked
MARK = "cmd/mark"  # asked
COMMANDS = "cmd/**"
SENSORS = "sensor/**"
STAND_UP = "cmd/stand_up"  # asked
LET_DOWN = "cmd/let_down"  # asked
STATUS = "status"  # asked
CONFIG = "config"  # asked: the robot file
ODOMETRY = "odometry"
STATE = "state"
EVENT = "event"
REACHABLE = "reachable"  # published on change, and asked
TRUTH = "truth"  # of a simulated robot
FAULT = "sim/fault"  # asked, of a simulated robot: what is to break; no real one has this key
VIEW = "view"  # published while somebody subscribes
PUBLISHED = (ODOMETRY, STATE, EVENT, TRUTH, REACHABLE)
ALIVE = "alive"  # a liveliness token


def twist(source: str) -> str:
    """Where a command source puts its twists."""
    return f"cmd/twist/{source}"


def sample(sensor: str) -> str:
    """Where a sensor puts its samples."""
    return f"sensor/{sensor}"


def key(robot: str, rest: str) -> str:
    """The whole key."""
    return f"{robot}/{rest}"
