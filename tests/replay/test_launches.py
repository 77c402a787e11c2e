"""Launches through the whole service, on our dynamics and on MuJoCo's: all that the floor gives, and no slip.

`python -m tests.bench.launch` has the whole table; these are a few of it.
"""

from itertools import pairwise
from math import hypot, pi

import pytest

from gateway.core.engine import Engine
from gateway.types import ZERO_TWIST, Mode, Twist
from replay.sim.controllers.odrive_tables import FIRMWARES, Command
from replay.sim.plants.omni_dynamics import Stribeck
from tests.launches import FALLING, FRICTIONS, Launch, best, equal_torques, robot
from tests.world import World

SLIP = 0.02  # of the speed

few = pytest.mark.parametrize(
    ("name", "plant", "friction", "eighth"),
    [
        ("omni4", "dynamics", 0.8, 0),
        ("omni4", "dynamics", 0.8, 3),
        ("omni4", "dynamics", 0.3, 4),
        ("omni4", "dynamics", 0.3, 6),
        ("omni4", "mujoco", 0.8, 3),
        ("omni4_odrive", "dynamics", 0.3, 1),
        ("omni4_odrive", "dynamics", 0.8, 0),
        ("omni4_odrive", "dynamics", 0.8, 2),
        ("omni4_gm6020", "dynamics", 0.8, 2),
        ("omni4_gm6020", "dynamics", 0.3, 7),
        ("omni4_gm6020", "mujoco", 0.8, 4),
    ],
)


@few
def test_a_launch_takes_what_the_floor_gives_and_does_not_slip(
    name: str, plant: str, friction: float, eighth: int
) -> None:
    run = Launch(name, eighth, friction, told=friction, plant=plant, stop=plant == "dynamics", seconds=0.9)
    assert run.acceleration >= 0.95 * best(run.config, eighth, friction)
    assert run.slip < SLIP
    assert run.path_error < 0.002
    assert run.odometry_error < 0.004
    assert "grip" in run.limits
    assert set(run.codes) <= {"mode_starting", "mode_drive"}
    if plant == "dynamics":
        assert run.stopping_slip < 2.0 * SLIP  # of rim speeds told in whole rpm, 6 mm/s of which is slip


@pytest.mark.parametrize(("friction", "eighth", "gained"), [(0.8, 0, 0.25), (0.3, 2, 0.04)])
def test_equal_torques_give_that_much_away(friction: float, eighth: int, gained: float) -> None:
    run = Launch("omni4", eighth, friction, told=friction, stop=False)
    assert run.acceleration > (1.0 + gained) * equal_torques(run.config, eighth, friction)


@pytest.mark.parametrize("name", ["omni4", "omni4_gm6020"])
def test_a_plain_ramp_slips(name: str) -> None:
    plain, careful = (Launch(name, 1, 0.3, told=told, seconds=1.2) for told in (None, 0.3))
    assert plain.slip > 0.5
    assert careful.slip < SLIP


@pytest.mark.parametrize(
    ("name", "friction", "eighth", "times"),
    [("omni4", 0.8, 4, 1.3), ("omni4", 0.3, 1, 1.6), ("omni4_gm6020", 0.8, 1, 1.2), ("omni4_gm6020", 0.3, 3, 1.6)],
)
def test_where_friction_falls_with_slip_a_launch_is_the_faster_for_not_slipping(
    name: str, friction: float, eighth: int, times: float
) -> None:
    def seconds(told: float | None, stribeck: Stribeck | None) -> float:
        run = Launch(name, eighth, friction, told=told, seconds=1.3, stop=False, stribeck=stribeck)
        assert told is None or run.slip < SLIP
        return run.seconds_to_speed

    launched = seconds(friction, FALLING)
    assert launched == pytest.approx(seconds(friction, None), rel=0.01)  # the floor's best is that at rest
    assert seconds(None, FALLING) > times * launched


@pytest.mark.parametrize("eighth", range(0, 8, 3))
@pytest.mark.parametrize("friction", FRICTIONS)
def test_a_launch_that_slips_on_it_all_the_same_grips_again(friction: float, eighth: int) -> None:
    """Told half as much again: wheels that slip have less than they had, and only backing off ends it."""
    run = Launch("omni4", eighth, friction, told=1.5 * friction, seconds=1.2, stop=False, stribeck=FALLING)
    assert run.codes.count("launch_slipped") == 1
    assert run.seconds_to_speed < 0.9
    assert max(run.slips[run.launched // 2 : run.launched]) < 0.01  # m/s


@pytest.mark.parametrize("eighth", range(4))
def test_a_launch_that_slips_backs_off_and_learns(eighth: int) -> None:
    """The robot file says 0.8 where the floor gives 0.3: it slips once, and not where the ramp ends."""
    run = Launch("omni4", eighth, 0.3, told=0.8, seconds=1.2)
    assert run.codes.count("launch_slipped") == 1
    assert 0.2 < run.law.friction <= 0.3
    assert run.law.facts["launch"] is False
    settled = slice(round(0.3 * run.config.loop.rate), run.launched)
    assert max(run.slips[settled]) < 0.01  # m/s
    ahead = [hypot(*out.trace.setpoint[:2]) - speed for out, speed in zip(run.outputs, run.speeds, strict=True)]
    assert max(ahead[settled]) < 0.12  # m/s; the setpoint does not go on from where the slip left it
    assert run.odometry_error < 0.015


@pytest.mark.parametrize("eighth", range(4))
def test_motors_that_are_told_nothing_but_a_speed_slip_when_they_do(eighth: int) -> None:
    """Their torque comes late, and each takes another share of the push than its load's: neither is slip."""
    for friction in FRICTIONS:
        gripping = Launch("omni4_vesc", eighth, friction, told=friction)
        assert "launch_slipped" not in gripping.codes
        assert gripping.slip < 0.07  # behind a ramp their loops overshoot
    for friction, told in ((0.3, 0.8), (0.5, 0.8)):
        slipping = Launch("omni4_vesc", eighth, friction, told=told)
        assert "launch_slipped" in slipping.codes
        assert 0.65 * friction < slipping.law.friction < 1.4 * friction


def test_what_was_learned_is_in_the_snapshot() -> None:
    run = Launch("omni4", 0, 0.3, told=0.8, seconds=0.4, stop=False)
    engine, loop = run.loop.engine, run.loop
    other = Engine(run.config, engine.snapshot())
    assert other._law.facts["friction"] == run.law.friction < 0.8
    for _ in range(100):
        inputs, outputs = loop.cycle()
        assert other.step(inputs) == outputs


@pytest.mark.parametrize("saturation", ["translation", "rotation"])
@pytest.mark.parametrize("eighth", [1, 2])
def test_turning_besides_slips_no_more(saturation: str, eighth: int) -> None:
    run = Launch("omni4", eighth, 0.3, told=0.3, turn=0.8, saturation=saturation, seconds=1.5, stop=False)
    assert max(run.slips) < 0.01  # m/s
    assert run.plant.twist.wz == pytest.approx(0.8, abs=0.05)
    assert run.speeds[-1] == pytest.approx(1.0, abs=0.02)
    assert "launch_slipped" not in run.codes


# A GM6020 gives 0.741 N m/A through 8.7 ohm; 25000 in a frame of 0x1FF are the 24 V of the supply.
RESISTANCE, CONSTANT, VOLTS = 8.7, 0.741, 24.0 / 25000
RPM = pi / 30.0
RADIUS, MASS, ROTOR, DRAG, FRICTION = 0.0508, 8.0, 0.0006, 0.05, 0.003


def test_a_voltage_is_stepped_by_the_back_emf_of_the_measured_speed() -> None:
    """Rojas 2005, section 8: V_k = V_0 + E_k, with V_0 that of the torque, new in each cycle, frame by frame."""
    run = Launch("omni4_gm6020", 0, 0.8, told=0.8, stop=False)
    told = [frame.data for out in run.outputs for frame in out.frames if frame.id == 0x1FF]
    speeds = [out.trace.wheel_speeds[2] or 0.0 for out in run.outputs]
    volts = [int.from_bytes(data[4:6], "big", signed=True) * VOLTS for data in told]  # of the third motor
    ramp = slice(round(0.08 * run.config.loop.rate), round(0.15 * run.config.loop.rate))
    starts = [volt - CONSTANT * speed for volt, speed in zip(volts, speeds, strict=True)][ramp]
    # Forward the rear wheels carry more: their share is as their load, of what the four push at 45 degrees.
    load = 0.5 + run.acceleration * 0.06 / 0.28 / 9.81
    push = MASS * run.acceleration / 2.0**0.5 * load * RADIUS + ROTOR * run.acceleration / 2.0**0.5 / RADIUS
    start = RESISTANCE / CONSTANT * (push + DRAG + FRICTION * sum(speeds[ramp]) / len(speeds[ramp]))
    assert sum(starts) / len(starts) == pytest.approx(start, rel=0.03)
    assert max(starts) - min(starts) < 2.0 * RPM * RESISTANCE / CONSTANT  # the speed loop's 0.5 N m s/rad on whole rpm
    gained = volts[ramp.stop] - volts[ramp.start]
    assert gained == pytest.approx(CONSTANT * (speeds[ramp.stop] - speeds[ramp.start]), abs=0.5)
    steps = [abs(after - before) for before, after in pairwise(volts[ramp.stop :])]
    assert max(steps) < 2.0, "handed over to its speed without a step"


def test_on_a_floor_that_grips_nothing_is_learned() -> None:
    run = Launch("omni4", 0, 2.0, told=0.8, seconds=0.6)
    for twist in (
        Twist(1.0, 0.0, 1.0),
        Twist(-0.8, 0.8, 0.0),
        Twist(0.0, -1.0, -2.0),
        Twist(1.5, 0.3, 0.5),
        ZERO_TWIST,
    ):
        run._drive(twist, 0.6)
    assert set(run.codes) == {"mode_starting", "mode_drive"}


def test_a_heavier_robot_than_told_is_held_back_and_no_slip_is_seen() -> None:
    world = World("omni4", edit=lambda text: text.replace("[loop]", "[robot.grip]\nfriction = 0.8\n\n[loop]", 1))
    world.start()
    world.bus.robot.set_mass(40.0)
    world.run(1.0, Twist(1.0, 0.0, 0.0))
    world.run(1.0, ZERO_TWIST)
    assert "launch_slipped" not in world.codes()
    assert world.true_speed() < 0.02


def test_a_stop_that_nobody_commanded_is_not_made_longer() -> None:
    """Silence: as fast as the limits say, which is more than the floor would give; and no torque is limited."""
    run = Launch("omni4", 0, 2.0, told=0.1, seconds=2.0, stop=False)
    begun = None
    for index in range(400):
        _, outputs = run.loop.cycle()
        if outputs.mode is Mode.STOPPING and begun is None:
            begun = index
        if begun is not None and outputs.trace.setpoint == ZERO_TWIST:
            break
    assert begun is not None
    assert (index - begun) / run.config.loop.rate < 1.0 / 9.0 + 9.0 / 75.0 + 0.05


def test_on_a_slippery_floor_silence_ends_at_rest() -> None:
    """Wheels that slip are light: with the gain that suits the robot they swung without end, and it slid on."""
    run = Launch("omni4", 1, 0.1, told=None, seconds=0.4, stop=False)
    for _ in range(round(3.0 * run.config.loop.rate)):
        run.loop.cycle()
    assert run.loop.engine.mode is Mode.IDLE
    assert hypot(*run.plant.twist[:2]) < 0.01
    assert max(map(abs, run.plant.rates)) < 0.1


def test_what_the_floor_gives_is_held_against_the_motors_too() -> None:
    """0.8 forward: without a bound on their torque the rear wheels would be asked for 7.5 N m of the 4.5 they have."""
    config = robot("omni4", 0.8)
    assert best(config, 0, 0.8) == pytest.approx(5.25, abs=0.01)
    assert best(config, 0, 0.3) == pytest.approx(2.549, abs=1e-3)  # the floor alone


def test_torques_told_ten_times_a_second_are_no_evidence_of_a_lost_one() -> None:
    """ODrives as they are delivered, launched as hard as their motors can: what they told last is of long ago."""
    launch = Launch("omni4_odrive", 3, 0.8, told=0.8)
    assert launch.slip < 0.02
    assert not [code for code in launch.codes if code.startswith("fault_")]


@pytest.mark.parametrize(("rate", "told"), [(10.0, False), (100.0, True)])
def test_slip_is_seen_where_torques_are_told_a_hundred_times_a_second(
    monkeypatch: pytest.MonkeyPatch, rate: float, told: bool
) -> None:
    """ODrives as they are delivered tell them ten times: then nobody looked, and `launch_looks` says so."""
    firmware = FIRMWARES["0.6"]
    rates = tuple((one, rate if one is Command.GET_TORQUES_06 else hz) for one, hz in firmware.slow_cyclic)
    monkeypatch.setitem(FIRMWARES, "0.6", firmware._replace(slow_cyclic=rates))
    for eighth in range(4):
        slipping = Launch("omni4_odrive", eighth, 0.3, told=0.8, seconds=1.2)
        assert ("launch_slipped" in slipping.codes) is told
        assert (slipping.law.friction < 0.3) is told
        gripping = Launch("omni4_odrive", eighth, 0.3, told=0.3)
        assert "launch_slipped" not in gripping.codes
        for launch in (slipping, gripping):
            looks = launch.law.facts["launch_looks"]
            assert isinstance(looks, float)
            assert (looks > 0.0) is told
