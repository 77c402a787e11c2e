"""Random drives: streams, silences, stops, resets, broken motors and buses, in any order."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from gateway.types import ZERO_TWIST, RequestKind, Twist, TwistFrame
from tests.world import NAMES, World

Script = list[tuple[Any, ...]]

both = pytest.mark.parametrize("name", NAMES)
axis = st.floats(-1.5, 1.5)
twists = st.one_of(st.just(ZERO_TWIST), st.builds(Twist, axis, axis, axis))
streams = st.tuples(
    st.just("stream"), twists, st.sampled_from(["teleop", "autonomy"]), st.sampled_from(TwistFrame), st.integers(5, 150)
)
silences = st.tuples(st.just("silence"), st.integers(5, 150))
requests = st.tuples(st.just("request"), st.sampled_from([RequestKind.ESTOP, RequestKind.RESET]))
breakages = st.tuples(st.sampled_from(["unplug", "plug", "power_off", "power_on"]), st.integers(0, 3))
buses = st.tuples(st.sampled_from(["fail", "restore"]))
scripts = st.lists(st.one_of(streams, streams, silences, requests, breakages, buses), min_size=1, max_size=8)
few = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def play(name: str, script: Script) -> World:
    """A drive of this robot that begins well and then follows the script."""
    world = World(name)
    world.start()
    devices = list(world.bus.robot.devices.values())
    bus = world.config.bus[0].name
    actions: dict[str, Callable[..., object]] = {
        "stream": lambda twist, source, frame, cycles: world.run(cycles * 0.004, twist, source=source, frame=frame),
        "silence": lambda cycles: world.run(cycles * 0.004),
        "request": world.request,
        "unplug": lambda index: devices[index % len(devices)].unplug(),
        "plug": lambda index: devices[index % len(devices)].plug(),
        "power_off": lambda index: devices[index % len(devices)].power_off(),
        "power_on": lambda index: devices[index % len(devices)].power_on(),
        "fail": lambda: world.bus.fail(bus),
        "restore": lambda: world.bus.restore(bus),
    }
    for action, *arguments in script:
        actions[action](*arguments)
    return world
