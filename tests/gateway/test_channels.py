"""The table of the quantities that people look at, against the trace that a drive really gives."""

import pytest

from gateway.core.channels import CHANNELS, UNPLOTTED, Layout, entities, owners, plots
from gateway.types import Trace
from tests.world import World

ALL = (*CHANNELS, *UNPLOTTED)
MOBY = owners(World("moby").config)


def trace(name: str) -> Trace:
    world = World(name)
    world.start()
    return world.records[-1][1].trace


@pytest.mark.parametrize("name", ["moby", "omni4"])
def test_every_label_is_there_once_and_has_a_number(name: str) -> None:
    motors = World(name).config.robot.motor_names()
    layout, seen = Layout(owners(World(name).config)), trace(name)
    assert len(set(layout.labels)) == len(layout.labels) == len(layout.row(seen))
    named = layout.named(seen)
    assert named["x"] == seen.pose.x
    assert named["vx_limited"] == seen.setpoint.vx
    assert named[f"speed.{motors[-1]}"] == seen.wheel_speeds[-1]
    assert named[f"position.{motors[0]}"] == seen.wheel_positions[0]


def test_what_cannot_be_measured_is_unknown_and_takes_its_places() -> None:
    seen = trace("moby")._replace(measured=None)
    layout = Layout(MOBY)
    assert [layout.named(seen)[f"{axis}_measured"] for axis in ("vx", "vy", "wz")] == [None] * 3
    assert len(layout.row(seen)) == len(layout.labels)


@pytest.mark.pure_python  # something else in place of a trace
def test_no_part_of_the_trace_is_left_out() -> None:
    class Noted:
        def __init__(self) -> None:
            self.names: set[str] = set()

        def __getattr__(self, name: str) -> None:
            self.names.add(name)

    noted = Noted()
    for channel in ALL:
        channel.read(noted)  # type: ignore[arg-type]
    assert noted.names == set(Trace._fields)


def test_plots_show_entities_that_exist_and_a_unit_is_told() -> None:
    assert {entity for shown in plots(MOBY).values() for entity in shown} <= set(entities(MOBY))
    assert next(iter(plots(MOBY))) == "Wheel speeds [rad/s]"
    assert all(channel.unit and f"[{channel.unit}]" in (channel.plot or f"[{channel.unit}]") for channel in CHANNELS)
