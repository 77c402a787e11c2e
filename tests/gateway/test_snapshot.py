"""A restored core goes on byte for byte, from any cycle of any drive, and nothing of its state is forgotten."""

import ast
import importlib
import inspect
import json
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gateway.config import RobotConfig, parse
from gateway.core.engine import Engine
from gateway.core.snapshot import OWNERS, SnapshotError, State
from gateway.robot_files import find
from gateway.types import Inputs, Outputs, RequestKind, Twist
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario, load_scenario
from replay.inject.random_drives import scenario
from tests.world import BUNDLED, NAMES, World, robot_text

SCENARIOS = sorted((Path(__file__).parents[2] / "deploy" / "scenarios").glob("*.toml"))
EVERY = 23  # cycles between two snapshots: no divisor of any rate, so that they fall into all kinds of cycles


def stored(state: State) -> State:
    """As a file gives it back: through JSON and msgpack."""
    back: State = msgspec.msgpack.decode(msgspec.msgpack.encode(json.loads(json.dumps(state))))
    return back


def driven(script: Scenario, config: RobotConfig) -> list[tuple[Inputs, Outputs]]:
    moments: list[Moment] = []
    run_scenario(script, config, watch=moments.append)
    return [(moment.inputs, moment.outputs) for moment in moments]


def goes_on_byte_for_byte(cycles: list[tuple[Inputs, Outputs]], config: RobotConfig, every: int = EVERY) -> int:
    """The same drive with another engine every few cycles, each restored from the one before; how many there were."""
    engine, restored = Engine(config), 0
    for inputs, outputs in cycles:
        if inputs.cycle == 0:  # the process was restarted, and knows nothing of what was before
            engine = Engine(config)
        assert repr(engine.step(inputs)) == repr(outputs)
        if inputs.cycle % every == every - 1:
            state = engine.snapshot()
            engine = Engine(config, stored(state))
            assert engine.snapshot() == state
            restored += 1
    return restored


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("seed", "can_brake"), [(200, False), (201, False), (202, False), (203, True)])
def test_restored_at_any_cycle_of_a_random_drive(name: str, seed: int, can_brake: bool) -> None:
    config = parse(robot_text(name), name)
    cycles = driven(scenario(seed, config, can_brake=can_brake), config)
    assert goes_on_byte_for_byte(cycles, config) > 100


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_restored_at_any_cycle_of_a_scenario(path: Path) -> None:
    script = load_scenario(path)
    config = parse(find(script.robot).read_text(), script.robot)
    assert goes_on_byte_for_byte(driven(script, config), config) > 50


@pytest.mark.parametrize("name", BUNDLED)
def test_restored_at_every_cycle_of_a_start(name: str) -> None:
    world = World(name)
    world.start()
    world.run(0.2, Twist(0.3, 0.1, 0.2))
    world.request(RequestKind.ESTOP)
    world.run(0.3)
    assert goes_on_byte_for_byte(world.records, world.config, every=1) == len(world.records)


def test_a_snapshot_is_no_part_of_the_engine() -> None:
    """Going on changes no snapshot taken before."""
    world = World("moby")
    world.start()
    state = world.engine.snapshot()
    before = json.dumps(state)
    world.run(0.5, Twist(0.3, 0.0, 0.0))
    assert json.dumps(state) == before
    assert json.dumps(world.engine.snapshot()) != before


def state_of(name: str = "moby") -> State:
    world = World(name)
    world.run(0.1)
    return stored(world.engine.snapshot())


def test_of_another_robot_file_it_is_refused() -> None:
    config = parse(robot_text("moby", rate_hz=500.0), "moby")
    with pytest.raises(SnapshotError, match="another robot file"):
        Engine(config, state_of())


def test_where_the_robot_records_and_listens_is_no_matter() -> None:
    config = parse(robot_text("moby"), "moby")
    zenoh = config.zenoh.model_copy(update={"listen": ["tcp/127.0.0.1:7999"]})
    recording = config.recording.model_copy(update={"directory": "elsewhere"})
    state = state_of()
    assert Engine(config.model_copy(update={"zenoh": zenoh, "recording": recording}), state).snapshot() == state


def spoilt(nodes: Any) -> Iterator[tuple[Any, Any]]:  # noqa: ANN401
    """Every container of the nodes with every key or place in it."""
    items = nodes.items() if isinstance(nodes, dict) else enumerate(nodes) if isinstance(nodes, list) else ()
    for place, node in items:
        yield nodes, place
        yield from spoilt(node)


def test_of_another_software_it_is_refused_in_words() -> None:
    config = parse(robot_text("moby"), "moby")
    state = state_of()
    attributes = state["engine"]["o"][1]
    attributes["_novelty"] = 1
    with pytest.raises(SnapshotError, match=r"another version of the software: .*Engine differs in _novelty"):
        Engine(config, state)
    del attributes["_novelty"], attributes["_mode"]
    with pytest.raises(SnapshotError, match="Engine differs in _mode"):
        Engine(config, state)
    with pytest.raises(SnapshotError, match="not a snapshot"):
        Engine(config, {})


def test_a_damaged_one_is_a_snapshot_error_and_nothing_else() -> None:
    config = parse(robot_text("moby"), "moby")
    state = state_of()
    refused = 0
    for container, place in list(spoilt(state["engine"]))[::3]:
        kept = container[place]
        container[place] = {"e": ["os.path", "join"]} if isinstance(kept, str) else "?"
        try:
            Engine(config, state)
        except SnapshotError:
            refused += 1
        container[place] = kept
    assert refused > 50
    assert Engine(config, state).snapshot() == state


@pytest.mark.pure_python  # a compiled class takes no new attribute
def test_state_of_a_type_nobody_thought_of_is_a_loud_error() -> None:
    engine = World("moby").engine
    engine._novelty = iter(())  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match=r"tuple_iterator is neither plain data nor in OWNERS"):
        engine.snapshot()


def test_what_two_share_is_shared_again() -> None:
    world = World("moby")
    world.start()
    odometry = world.engine._odometry
    odometry._jumped = odometry._seen_ns
    restored = Engine(world.config, stored(world.engine.snapshot()))._odometry
    assert restored._jumped is restored._seen_ns
    assert restored._seen_ns == odometry._seen_ns
    assert restored._positions is not odometry._positions


@pytest.mark.pure_python  # reads the source
@pytest.mark.parametrize("owner", OWNERS)
def test_what_is_left_out_never_changes_after_construction(owner: str) -> None:
    module, _, name = owner.rpartition(".")
    kind = getattr(importlib.import_module(module), name)
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    built: set[str] = set()
    changed: set[str] = set()
    for method in (node for node in tree.body if isinstance(node, ast.FunctionDef)):
        for node in ast.walk(method):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                (built if method.name == "__init__" else changed).add(node.attr)
    assert OWNERS[owner] <= built
    assert not OWNERS[owner] & changed


@pytest.mark.pure_python  # it reads the source
@pytest.mark.parametrize("name", sorted(OWNERS))
def test_what_a_class_of_state_holds_itself_is_declared_so(name: str) -> None:
    """Compiled, anything else counts as state of each object, and the snapshot would not fit the one of pure Python."""
    module, _, kind = name.rpartition(".")
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    (found,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == kind)
    dataclass = any("dataclass" in ast.unparse(decorator) for decorator in found.decorator_list)
    for node in found.body:
        assert not isinstance(node, ast.Assign) or ast.unparse(node.targets[0]) == "__slots__", ast.unparse(node)
        if isinstance(node, ast.AnnAssign) and node.value is not None and not dataclass:
            assert ast.unparse(node.annotation).startswith("ClassVar"), ast.unparse(node)
