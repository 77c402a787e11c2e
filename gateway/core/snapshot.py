"""The state of the core as plain data and back: restored at any cycle of a drive, it goes on byte for byte.

How this works
--------------
One walk over everything the engine holds. Objects that own state are listed in OWNERS, each with those of its
attributes that never change after construction and are left out; whatever else it has is taken, so that a new piece of
state is covered by itself. A type that is neither listed, nor plain, nor made of plain ones is a TypeError, which every
test that takes a snapshot finds. Restoring builds the engine from its robot file and walks over both at once: objects
stay those that were built and get their attributes, containers are made anew, and what was one container stays one.

A node is a number, a text, None, true or false; a list; or a dict of one key that says what it is: n named tuple,
e member of an enumeration, o object, t tuple, d dict, s set, q deque, f number that is not finite, b bytes, r the
mutable thing of this number that has been before, x as built. All of it survives JSON and msgpack.
"""

import hashlib
import sys
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from functools import partial
from math import isfinite
from struct import Struct
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any, Final

from gateway.config import RobotConfig

Node = Any  # plain data
State = dict[str, Node]

# Who owns state, with what never changes after construction. Kinematics are built from the robot file and own none.
OWNERS: Final[Mapping[str, frozenset[str]]] = {
    "gateway.core.engine.Engine": frozenset(
        {
            "_expected_speeds",
            "_grips",
            "_kinematics",
            "_more",
            "_names",
            "_none",
            "_period",
            "_robot_file",
            "_robot_name",
            "_selects",
            "_stop_category",
            "_velocity",
        }
    ),
    "gateway.core.ability.Abilities": frozenset(
        {"_chassis", "_kinematics", "_lost_use", "_policy", "_pushes", "_speeds", "_torques", "_velocity"}
    ),
    "gateway.core.limp_watch.LimpWatch": frozenset({"_bound", "_velocity"}),
    "gateway.core.motors.Motors": frozenset({"_receivers", "_standstill", "_untold"}),
    "gateway.core.arbiter.Arbiter": frozenset({"_abilities", "_timeout_ns"}),
    "gateway.core.health.HealthMonitor": frozenset({"_limits", "_names", "_well"}),
    "gateway.core.odometry.WheelOdometry": frozenset({"_growth", "_kinematics", "_sideways", "_top_speeds"}),
    "gateway.core.joint_trust.JointTrust": frozenset({"_absolute", "_top_speeds"}),
    "gateway.core.sensors.Sensors": frozenset({"_kinds", "_listeners", "_timeouts_ns", "_top_turn"}),
    "gateway.core.settings.Settings": frozenset({"_rows"}),
    "gateway.core.standstill.Standstill": frozenset(),
    "gateway.core.reporter.Reporter": frozenset({"_sources"}),
    "gateway.core.reporter.Due": frozenset({"_period_ns"}),
    "gateway.core.reporter._Throttle": frozenset(),
    "gateway.core.detectors.StallDetector": frozenset({"_limits"}),
    "gateway.core.detectors.FrozenEncoderDetector": frozenset({"_limits"}),
    "gateway.core.detectors.RunawayDetector": frozenset({"_limits"}),
    "gateway.core.detectors.FollowingDetector": frozenset({"_limits"}),
    "gateway.core.detectors.ReversedDetector": frozenset(),
    "gateway.core.detectors._AgainstTorque": frozenset({"_limits"}),
    "gateway.core.slip.SlipDetector": frozenset({"_floor", "_model", "_names", "_slope"}),
    "gateway.core.slip._SpinWatch": frozenset({"_model", "_nothing"}),
    "gateway.core.slip_isolation.Isolation": frozenset({"_model"}),
    "gateway.core.torque_loss.TorqueLossDetector": frozenset({"_least", "_mechanics"}),
    "gateway.core.torque_loss._Missing": frozenset(),
    "gateway.control.limits.TwistLimiter": frozenset(
        {"_acceleration", "_course", "_jerk", "_rho", "_turn_x", "_turn_y", "_velocity", "_wheels", "_zero"}
    ),
    "gateway.control.launch_slip.LaunchSlip": frozenset(
        {"_grip", "_led", "_longest", "_losses", "_radii", "_top_speeds"}
    ),
    "gateway.control.launch.LaunchLaw": frozenset(
        {
            "_acceleration",
            "_features",
            "_free",
            "_grip",
            "_lifting",
            "_losses",
            "_pushers",
            "_radii",
            "_rows",
            "_steps",
            "_still",
            "_top_speeds",
        }
    ),
    "gateway.control.offset_law.OffsetDifferentialLaw": frozenset(
        {"_accelerations", "_features", "_flip", "_geometry", "_longest_period", "_period"}
    ),
    "gateway.control.region_policy.RegionPolicy": frozenset({"_axle_offset", "_form", "_limits", "_max_footprint"}),
    "gateway.control.compensation.Compensation": frozenset({"_authority", "_axle_offset"}),
    "gateway.control.compensation.PathRate": frozenset(),
    "gateway.control.slip_correction.SlipCorrection": frozenset({"_bounds", "_wheels"}),
    "gateway.control.drive_law.SpeedLaw": frozenset(
        {"_brakes", "_features", "_kinematics", "_top_speeds", "_velocity", "period"}
    ),
    "gateway.kinematics.odd.Width": frozenset(),
    "gateway.control.odd_law.OddLaw": frozenset(
        {"_acceleration", "_features", "_gain", "_kinematics", "_place", "_top_rate", "_top_speeds", "_yields"}
    ),
    "gateway.control.posture.Posture": frozenset({"_catch", "_fall"}),
    "gateway.control.balance.BalancingLaw": frozenset(
        {"_acceleration", "_body", "_coasts", "_commanded", "_farthest", "_gains", "_kinematics", "_radius"}
        | {"_taken_up", "_top_speeds", "_torques"}
    ),
    "gateway.control.steering.Steering": frozenset({"_acceleration", "_gains", "_most"}),
    "gateway.control.odd_width.WidthEstimate": frozenset({"_gate", "_narrowest", "_sensor", "_widest"}),
    "gateway.control.speed_loop.SpeedLoop": frozenset({"_ki", "_kp", "_max_torque"}),
    "drivers.dji.DjiDriver": frozenset({"_bus", "_by_id", "_command_frames", "_slots", "_zero_frames"}),
    "drivers.dji._Motor": frozenset(
        {"braking_raw_per_rpm", "command_period_ns", "kind", "raw_limit", "raw_per_torque", "raw_per_value", "rest_rpm"}
        | {"slot", "spec", "temperature", "timeout_ns"}
    ),
    "drivers.vesc.VescDriver": frozenset({"_bus", "_by_id", "_coast_frames", "_stop_frames", "_takes"}),
    "drivers.vesc._Motor": frozenset(
        {"bus", "coast_frame", "current_limit", "duty_zero_frame", "erpm_limit", "erpm_per_rad_s", "min_erpm"}
        | {"rad_per_count", "raw_per_torque", "spec", "stop_frame", "timeout_ns", "watchdog_ns"}
    ),
    "drivers.sensors.counted.CountedSensor": frozenset(
        {"_bus", "_extended", "_layout", "_needed", "_places", "_sizes", "_spec", "_taken"}
    ),
    "drivers.twins.TwinWatch": frozenset({"_max_speed", "_slack", "_turn"}),
    "drivers.odrive.group.OdriveDriver": frozenset({"_bus", "_by_node", "_routes"}),
    "drivers.odrive.axis.Axis": frozenset(
        {"_torque_id", "_velocity_id", "bus", "firmware", "measured_timeout_ns", "spec", "watchdog"} | {"zero_frame"}
    ),
}
# The parts of a robot as they were put together: of these only what owns state is walked over.
AS_BUILT: Final = frozenset(
    f"gateway.core.assembly.Robot.{part}" for part in ("capabilities", "kinematics", "limits", "transmissions")
)
_BUILT_TYPES: Final = (FunctionType, BuiltinFunctionType, MethodType, partial, Struct)
_KINEMATICS: Final = "gateway.kinematics."
_OURS: Final = ("gateway.", "drivers.")
_BUILT: Final[Node] = {"x": 0}
_OTHER: Final = "the snapshot is of another version of the software"


class SnapshotError(ValueError):
    """A snapshot that is not of this software and robot file; the text says why."""


def fingerprint(config: RobotConfig) -> str:
    """Of what the core reads of a robot file: not of where it records, listens and finds its buses."""
    rates = (config.zenoh.odometry_rate, config.zenoh.state_rate)
    text = config.model_dump_json(exclude={"recording", "bus", "zenoh"})
    return hashlib.sha256(f"{rates} {text}".encode()).hexdigest()


def take(engine: object, robot_file: str) -> State:
    """The state of this engine. Raises TypeError where it holds what nobody has thought of."""
    return {"robot_file": robot_file, "engine": _Walk().node(engine)}


def put(engine: object, robot_file: str, state: State) -> None:
    """Give a newly built engine this state. Raises SnapshotError, and then the engine is of no use."""
    if not isinstance(state, dict) or set(state) != {"robot_file", "engine"}:
        raise SnapshotError("not a snapshot of the core")
    if state["robot_file"] != robot_file:
        raise SnapshotError("the snapshot is of another robot file")
    try:
        _Return().value(state["engine"], engine)
    except SnapshotError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, RecursionError) as error:
        raise SnapshotError(f"{_OTHER}, or damaged: {error!r}") from None


class _Walk:
    """From objects to nodes."""

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}  # of mutable things, in the order in which they were met
        self._nodes: dict[type, Callable[[Any], Node]] = {
            **dict.fromkeys((int, str, bool, type(None)), lambda plain: plain),
            float: lambda number: number if isfinite(number) else {"f": repr(number)},
            bytes: lambda data: {"b": data.hex()},
            tuple: lambda items: {"t": self._all(items)},
            list: lambda items: self._new(items) or self._all(items),
            dict: lambda items: self._new(items) or {"d": [[self.node(k), self.node(v)] for k, v in items.items()]},
            set: lambda items: self._new(items) or {"s": self._all(sorted(items, key=repr))},
            frozenset: lambda items: {"z": self._all(sorted(items, key=repr))},
            deque: lambda items: self._new(items) or {"q": [items.maxlen, self._all(items)]},
            **dict.fromkeys(_BUILT_TYPES, lambda _: _BUILT),
        }

    def node(self, value: object) -> Node:
        """Anything as plain data."""
        kind = type(value)
        node = self._nodes.get(kind)
        if node is None:
            node = self._nodes[kind] = self._node_of(kind)
        return node(value)

    def _node_of(self, kind: type) -> Callable[[Any], Node]:
        """How values of a type of ours become nodes."""
        name = _name(kind)
        if name in OWNERS:
            return lambda owner: (
                self._new(owner) or {"o": [name, {at: self.node(getattr(owner, at)) for at in _attributes(owner)}]}
            )
        if name.startswith(_OURS) and issubclass(kind, Enum):
            return lambda member: {"e": [name, member.name]}
        if name.startswith(_OURS) and issubclass(kind, tuple):
            fields = getattr(kind, "_fields")  # noqa: B009  a named tuple has them
            kept = [f"{name}.{field}" not in AS_BUILT for field in fields]
            return lambda items: {
                "n": [name, *(self.node(item) if keep else _BUILT for item, keep in zip(items, kept, strict=True))]
            }
        if name.startswith(_KINEMATICS):
            return lambda _: _BUILT
        raise TypeError(f"{name} is neither plain data nor in OWNERS of gateway.core.snapshot")

    def _attributes(self, owner: object) -> dict[str, Node]:
        return {name: self.node(getattr(owner, name)) for name in _attributes(owner)}

    def _all(self, items: Iterable[object]) -> list[Node]:
        node = self.node
        return [node(item) for item in items]

    def _new(self, thing: object) -> Node:
        """Nothing for a mutable thing that is met for the first time, else a reference to it."""
        number = self._numbers.get(id(thing))
        if number is not None:
            return {"r": number}
        self._numbers[id(thing)] = len(self._numbers)
        return None


class _Return:
    """From nodes to values, along an engine that was built from the same robot file."""

    def __init__(self) -> None:
        self._things: list[Any] = []
        self._values: dict[str, Callable[[Any, Any], Any]] = {
            "f": lambda node, _: float(node),
            "b": lambda node, _: bytes.fromhex(node),
            "t": lambda node, built: tuple(self._all(node, built)),
            "d": self._dict,
            "s": lambda node, _: self._keep(set(self._all(node, None))),
            "z": lambda node, _: frozenset(self._all(node, None)),
            "q": lambda node, _: self._keep(deque(self._all(node[1], None), node[0])),
            "n": self._named,
            "e": lambda node, _: _ours(node[0], Enum)[node[1]],
            "o": self._owner,
            "r": lambda node, _: self._things[node],
            "x": self._as_built,
        }

    def value(self, node: Node, built: Any) -> Any:  # noqa: ANN401  whatever it was
        """What the node stands for; `built`: what stands in its place in the new engine, None if nothing does."""
        if isinstance(node, list):
            items: list[Any] = self._keep([])
            items += self._all(node, built)
            return items
        if not isinstance(node, dict):
            return node
        ((kind, content),) = node.items()
        return self._values[kind](content, built)

    def _all(self, nodes: list[Node], built: Any) -> list[Any]:  # noqa: ANN401
        places = built if isinstance(built, list | tuple) and len(built) == len(nodes) else [None] * len(nodes)
        return [self.value(node, place) for node, place in zip(nodes, places, strict=True)]

    def _keep(self, thing: Any) -> Any:  # noqa: ANN401
        self._things.append(thing)
        return thing

    def _dict(self, node: Node, built: Any) -> Any:  # noqa: ANN401
        items = self._keep({})
        for key_node, value_node in node:
            key = self.value(key_node, None)
            items[key] = self.value(value_node, built.get(key) if isinstance(built, dict) else None)
        return items

    def _named(self, node: Node, built: Any) -> Any:  # noqa: ANN401
        kind = _ours(node[0], tuple)
        if len(node) - 1 != len(getattr(kind, "_fields")):  # noqa: B009
            raise SnapshotError(f"{_OTHER}: {node[0]} has other fields")
        return tuple.__new__(kind, self._all(node[1:], built))

    def _owner(self, node: Node, built: Any) -> Any:  # noqa: ANN401
        name, attributes = node
        if _name(type(built)) != name:
            raise SnapshotError(f"{_OTHER}: there is no {name} in its place")
        if set(attributes) != set(_attributes(built)):
            other = ", ".join(sorted(set(attributes) ^ set(_attributes(built))))
            raise SnapshotError(f"{_OTHER}: {name} differs in {other}")
        self._keep(built)
        for attribute, content in attributes.items():
            setattr(built, attribute, self.value(content, getattr(built, attribute)))
        return built

    def _as_built(self, _: Node, built: Any) -> Any:  # noqa: ANN401
        if built is None:
            raise SnapshotError(f"{_OTHER}: a part of it is not built any more")
        return built


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _ours(name: str, base: type) -> Any:  # noqa: ANN401
    """The named tuple or enumeration of ours of this name; nothing else, whatever a damaged file says."""
    module, _, attribute = name.rpartition(".")
    kind = getattr(sys.modules[module], attribute) if module.startswith(("gateway", "drivers")) else None
    if not isinstance(kind, type) or not issubclass(kind, base):
        raise SnapshotError(f"{_OTHER}: there is no {name}")
    return kind


_known: dict[tuple[object, ...], tuple[str, ...]] = {}


def _attributes(owner: object) -> tuple[str, ...]:
    """Names of what an owner has and may change: of slots, of a compiled class, or of its dict as it is now."""
    kind, own = type(owner), getattr(owner, "__dict__", ())
    found = _known.get((kind, *own))
    if found is None:
        names = set(own)
        for base in kind.__mro__:
            names |= {*base.__dict__.get("__slots__", ()), *base.__dict__.get("__mypyc_attrs__", ())}
        names -= OWNERS[_name(kind)]
        found = _known[kind, *own] = tuple(sorted(name for name in names if not name.startswith("__")))
    return found
