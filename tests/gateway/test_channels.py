"""The table of the quantities that people look at, against the trace that a drive really gives."""

import pytest

from gateway.core.channels import CHANNELS, UNPLOTTED, channels_of, entities, layout_of, plots
from gateway.types import Trace
from tests.world import World

MOBY = World("moby").config
ALL = (*channels_of(MOBY), *CHANNELS, *UNPLOTTED)


def trace(name: str) -> Trace:
    world = World(name)
    world.start()
    return world.records[-1][1].trace


@pytest.mark.parametrize("name", ["moby", "omni4"])
def test_every_label_is_there_once_and_has_a_number(name: str) -> None:
    motors = World(name).config.robot.motor_names()
    layout, seen = layout_of(World(name).config), trace(name)
    assert len(set(layout.labels)) == len(layout.labels) == len(layout.row(seen))
    named = layout.named(seen)
    assert named["x"] == seen.pose.x
    assert named["vx_limited"] == seen.setpoint.vx
    assert named[f"speed.{motors[-1]}"] == seen.wheel_speeds[-1]
    assert named[f"position.{motors[0]}"] == seen.wheel_positions[0]


def test_the_residual_is_told_of_every_wheel_that_has_one() -> None:
    motors = World("omni4").config.robot.motor_names()
    named = layout_of(World("omni4").config).named(trace("omni4")._replace(residuals=(0.1, None, -0.1, 0.2)))
    assert [named[f"residual.{motor}"] for motor in motors] == [0.1, None, -0.1, 0.2]
    named = layout_of(MOBY).named(trace("moby"))
    assert [named[f"residual.{motor}"] for motor in MOBY.robot.motor_names()] == [None] * 3


def test_what_cannot_be_measured_is_unknown_and_takes_its_places() -> None:
    seen = trace("moby")._replace(measured=None)
    layout = layout_of(MOBY)
    assert [layout.named(seen)[f"{axis}_measured"] for axis in ("vx", "vy", "wz")] == [None] * 3
    assert len(layout.row(seen)) == len(layout.labels)


@pytest.mark.pure_python  # something else in place of a trace
def test_no_part_of_the_trace_is_left_out() -> None:
    class Noted:
        def __init__(self) -> None:
            self.names: set[str] = set()

        def __getattr__(self, name: str) -> tuple[float, ...]:
            self.names.add(name)
            return ()

    noted = Noted()
    for channel in ALL:
        channel.read(noted)  # type: ignore[arg-type]
    assert noted.names == set(Trace._fields)


def test_plots_show_entities_that_exist_and_a_unit_is_told() -> None:
    channels = channels_of(MOBY)
    assert {entity for shown in plots(channels).values() for entity in shown} <= set(entities(channels))
    assert next(iter(plots(channels))) == "Wheel speeds [rad/s]"
    assert set(entities(channels)) - set(entities(CHANNELS)) == {"chassis/angles"}
    assert not {"heading", "attitude", "range"} & set(entities(channels))  # it has no such sensors
    assert all(channel.unit and f"[{channel.unit}]" in (channel.plot or f"[{channel.unit}]") for channel in channels)
