"""Parameters from recorded drives: those that the plant was made of come back, and what a drive does not tell does not.

Truth is what our plants, and MuJoCo's bodies, were made of; the encoders of ours have noise.
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.chassis.omni import OmniRobot
from gateway.cli.app import build
from gateway.config import parse
from gateway.types import Twist
from replay.identify import models
from replay.identify.fit import fit
from replay.identify.identify import KNOWN_MASS, _look, _reason, identify
from replay.identify.measured import measured
from replay.identify.moments import moments
from replay.identify.parameters import (
    TORQUE_SCALE,
    IdentifyError,
    names_for,
    read_parameters,
    values_of,
    with_values,
)
from replay.sessions.reader import open_session
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant, PlantName
from tests.replay import mujoco_plant
from tests.replay.identified_drives import Driven, Twists, drive, pulled_twists, random_twists, text_of
from tests.world import robot_text

Change = Callable[[dict[str, object]], object]
EVERY = [(name, plant) for name in ("moby", "omni4") for plant in PlantName]
NOISE = 0.003  # rad/s
# What MuJoCo's robots are made of here, and no robot file says.
HEAVY_MOBY = {"mass": 170.0, "inertia": 3.5, "joint_drag": 2.0}
HEAVY_OMNI = {"mass": 33.0, "inertia": 1.3, "joint_friction": 0.05}


def forward(t: float) -> Twist:
    """Only forward and back, now and then."""
    return Twist(0.6 if int(t) % 3 == 0 else -0.3 if int(t) % 3 == 1 else 0.0, 0.0, 0.0)


def steady(_: float) -> Twist:
    """Always the same."""
    return Twist(0.5, 0.0, 0.0)


@pytest.fixture(scope="module")
def omni(tmp_path_factory: pytest.TempPathFactory) -> Driven:
    folder = tmp_path_factory.mktemp("omni")
    return drive(folder, robot_text("omni4"), random_twists(5), seconds=6.0, plant=PlantName.SIMPLE, noise=NOISE)


@pytest.mark.parametrize(("name", "plant"), EVERY)
def test_the_equations_are_those_of_the_plant(name: str, plant: PlantName) -> None:
    """Its own steps under random torques: the forces that are found are those that acted, where all joints turn."""
    robot = parse(robot_text(name), name).robot
    rows, chance, real = models.rows(robot), Random(3), plant_of(robot, plant)
    torques, rates = list[list[float]](), [real.rates]
    for step in range(3000):
        if step % 300 == 0:
            now = [chance.uniform(-1.0, 1.0) * (8.0 if name == "moby" else 1.0) for _ in rows]
        torques.append(now)
        real.step(now)
        rates.append(real.rates)
    speeds = np.linalg.pinv(rows) @ np.array(rates).T
    middle = (speeds[:, 1:] + speeds[:, :-1]) / 2.0
    times = np.arange(3000, dtype=np.float64) * STEP_S
    motion = models.Motion(times, middle, np.diff(speeds) / STEP_S, rows @ middle)
    found, true = models.forces(robot, plant)(robot, motion), rows.T @ np.array(torques).T
    turning = np.min(np.abs(motion.rates), axis=0) > 0.3
    assert np.count_nonzero(turning) > 1500
    off = np.sqrt(np.mean((found - true)[:, turning] ** 2, axis=1)) / np.sqrt(np.mean(true**2, axis=1))
    assert np.max(off) < 2e-3


@pytest.mark.parametrize(("name", "plant"), EVERY)
def test_without_noise_the_parameters_come_back(name: str, plant: PlantName, tmp_path: Path) -> None:
    """Measured: within 0.3 %. What measuring shifts (1 to 170 % of a parameter) is taken off beside the likeness."""
    driven = drive(tmp_path, robot_text(name), random_twists(1), seconds=7.0, plant=plant)
    found = identify(open_session(driven.path))
    true = values_of(driven.config.robot)
    assert found.file.plant == plant.value
    assert found.likeness == 2
    assert {parameter: one.value for parameter, one in found.file.found.items()} == {
        parameter: pytest.approx(true[parameter], rel=0.02) for parameter in names_for(driven.config.robot)[:-1]
    }
    assert found.file.not_found[TORQUE_SCALE].reason == KNOWN_MASS


@pytest.mark.parametrize(("name", "seconds"), [("moby", 8.0), ("omni4", 4.0)])
def test_the_intervals_hold_the_truth(name: str, seconds: float, tmp_path: Path) -> None:
    """Several drives with noise. Of 95 %, fewer than 80 % of so few would be a chance of one in thousands.

    `python -m tests.bench.identify` does it with more.
    """
    held, offs = [], []
    for seed in range(5):
        driven = drive(
            tmp_path / str(seed),
            robot_text(name),
            random_twists(seed),
            seconds=seconds,
            plant=PlantName.SIMPLE,
            noise=NOISE,
            seed=seed,
        )
        true = values_of(driven.config.robot)
        for parameter, one in identify(open_session(driven.path)).file.found.items():
            held.append(one.low <= true[parameter] <= one.high)
            offs.append(2.0 * (one.value - true[parameter]) / (one.high - one.low))
    assert len(held) >= 24
    assert sum(held) / len(held) >= 0.8
    assert 0.25 < np.sqrt(np.mean(np.square(offs))) < 0.9, "as wide as the errors, and not just wide: 0.5 is ideal"


@pytest.mark.parametrize("seconds", [2.0, 5.0])
def test_a_robot_that_stood_still_tells_nothing(seconds: float, tmp_path: Path) -> None:
    driven = drive(
        tmp_path, robot_text("omni4"), lambda _: Twist(0.0, 0.0, 0.0), seconds=seconds, plant=PlantName.SIMPLE
    )
    with pytest.raises(IdentifyError, match="the robot stood still"):
        identify(open_session(driven.path))


def test_who_never_turns_tells_no_inertia(tmp_path: Path) -> None:
    """And straight ahead mass and joint inertia are one."""
    driven = drive(tmp_path, robot_text("omni4"), forward, seconds=6.0, plant=PlantName.SIMPLE, noise=NOISE)
    file = identify(open_session(driven.path)).file
    assert set(file.found) == {"mass", "joint_friction", "joint_drag"}
    assert "hardly changed its turning" in file.not_found["inertia"].reason
    assert "does not tell it from mass" in file.not_found["joint_inertia"].reason
    assert file.not_found["joint_inertia"].value == 0.004, "held at what the robot file says"
    assert file.found["mass"].low <= 25.0 <= file.found["mass"].high


def test_at_one_speed_friction_is_not_told_from_drag(tmp_path: Path) -> None:
    """The noise of the encoders moves nothing: against the same drive without it mass and inertia are not found either.

    A session begins at rest, so the time of constant speed is cut out of it.
    """
    looks = []
    for noise in (NOISE, 0.0):
        driven = drive(
            tmp_path / str(noise), robot_text("omni4"), steady, seconds=6.0, plant=PlantName.SIMPLE, noise=noise
        )
        series = measured((inputs for inputs, _ in driven.cycles if 3.0 < inputs.cycle / 250.0 < 6.9), driven.config)
        looks.append(_look(driven.config.robot, series, PlantName.SIMPLE, {}))
    noisy, quiet = looks
    found = fit(noisy.problem._replace(instruments=quiet.problem.columns), partial(_reason, noisy))
    assert not found.found.keys() & {"mass", "inertia", "joint_inertia"}
    assert len(found.found.keys() & {"joint_friction", "joint_drag"}) == 1
    assert "does not tell it from joint_" in found.refused.get("joint_drag", found.refused.get("joint_friction", ""))


def test_a_torque_counts_as_true_unless_a_mass_is_known(tmp_path: Path) -> None:
    """Motors of which 80 % of the torque acts: a robot that seems heavier by a quarter, or the torque constant."""
    text = robot_text("omni4")
    driven = drive(tmp_path, text, random_twists(2), seconds=7.0, plant=PlantName.SIMPLE, noise=NOISE, torque_scale=0.8)
    session = open_session(driven.path)
    assert identify(session).file.found["mass"].value == pytest.approx(25.0 / 0.8, rel=0.01)
    known = identify(session, known={"mass": 25.0}).file
    assert known.found[TORQUE_SCALE].value == pytest.approx(0.8, rel=0.01)
    assert known.found["inertia"].value == pytest.approx(0.9, rel=0.02)
    assert known.not_found["mass"].value == 25.0


def test_without_torques_nothing_is_known(tmp_path: Path) -> None:
    """Motors that are told voltages tell none."""
    driven = drive(tmp_path, robot_text("omni4_gm6020"), random_twists(2), seconds=2.0, plant=PlantName.SIMPLE)
    with pytest.raises(IdentifyError, match="no torque was told"):
        identify(open_session(driven.path))


def test_a_kind_without_equations_here_is_refused(tmp_path: Path) -> None:
    driven = drive(tmp_path, robot_text("odd"), random_twists(2, share=0.2), seconds=1.0, plant=PlantName.SIMPLE)
    with pytest.raises(IdentifyError, match="kind odd"):
        identify(open_session(driven.path))


def test_without_a_caster_only_the_simple_plant_is_fitted(tmp_path: Path) -> None:
    """And asked for the other one, it is refused with the reason."""
    text = re.sub(r"^caster = .*$", "", robot_text("moby"), flags=re.M)

    def simple(robot: OffsetDifferentialRobot) -> Plant:
        return plant_of(robot, PlantName.SIMPLE)

    session = open_session(drive(tmp_path, text, random_twists(1), seconds=4.0, plant=simple).path)
    assert identify(session).file.plant == PlantName.SIMPLE.value
    with pytest.raises(IdentifyError, match="caster is missing"):
        identify(session, plant=PlantName.DYNAMICS)


def test_seldom_torques_of_four_wheels_are_refused(omni: Driven) -> None:
    series = measured((inputs for inputs, _ in omni.cycles), omni.config)
    seldom = [one._replace(torque_times=one.torque_times[::50], torques=one.torques[::50]) for one in series]
    with pytest.raises(IdentifyError, match="more than three wheels"):
        moments(seldom, models.rows(omni.config.robot), 0.0762)


def test_instants_with_slip_are_left_out(omni: Driven) -> None:
    """One wheel that turns faster than the others say, for half a second."""
    series = list(measured((inputs for inputs, _ in omni.cycles), omni.config))
    one, rows = series[1], models.rows(omni.config.robot)
    slipping = (one.times > 3.0) & (one.times < 3.5)
    before = moments(series, rows, 0.0762)
    series[1] = one._replace(rates=one.rates + 8.0 * slipping)
    after = moments(series, rows, 0.0762)
    assert before.slipping == 0
    assert after.slipping == pytest.approx(10, abs=3)
    assert not np.any((after.at > 3.0) & (after.at < 3.5))


# on MuJoCo


@pytest.mark.parametrize("heavy", [{}, HEAVY_MOBY], ids=["as in the file", "otherwise"])
def test_mujocos_moby(heavy: Mapping[str, float], tmp_path: Path) -> None:
    """Our simple plant fits it, as its masses are over the joint too. Measured within 5 %, friction with rolling 10."""
    driven = _on_mujoco("moby", pulled_twists(3), heavy, tmp_path)
    found = identify(open_session(driven.path))
    true = values_of(driven.config.robot) | dict(heavy)
    assert found.file.plant == PlantName.SIMPLE.value
    assert found.likeness == 2
    values = found.file.values
    assert values["mass"] == pytest.approx(true["mass"], rel=0.04)
    assert values["inertia"] == pytest.approx(true["inertia"], rel=0.1)
    assert values["joint_drag"] == pytest.approx(true["joint_drag"], rel=0.1)


@pytest.mark.parametrize("heavy", [{}, HEAVY_OMNI], ids=["as in the file", "otherwise"])
def test_mujocos_omni_robot(heavy: Mapping[str, float], tmp_path: Path) -> None:
    """Measured: 0.2 % of mass, 1 % of inertia; its soft contacts roll with 0.0016 N m s/rad more."""
    driven = _on_mujoco("omni4", random_twists(0), heavy, tmp_path)
    found = identify(open_session(driven.path)).file.found
    true = values_of(driven.config.robot) | dict(heavy)
    assert found["mass"].value == pytest.approx(true["mass"], rel=0.01)
    assert found["inertia"].value == pytest.approx(true["inertia"], rel=0.02)
    assert found["joint_inertia"].value == pytest.approx(true["joint_inertia"], rel=0.06)
    assert true["joint_friction"] < found["joint_friction"].value < true["joint_friction"] + 0.004
    assert found["joint_drag"].value == pytest.approx(true["joint_drag"], rel=0.1)


# the command


def test_no_other_file_becomes_a_picture(omni: Driven, tmp_path: Path) -> None:
    robot_file = tmp_path / "robot.toml"
    robot_file.write_text("mine")
    done = run(omni.path, "--plot", robot_file)
    assert done.exit_code == 2
    assert "must end in .png" in done.output
    assert robot_file.read_text() == "mine"


def test_the_command_tells_it(omni: Driven, tmp_path: Path) -> None:
    out, plot = tmp_path / "found.json", tmp_path / "fit.png"
    done = run(omni.path, "--out", out, "--plot", plot)
    assert done.exit_code == 0
    assert "mass" in done.stdout
    assert "left over" in done.stdout
    assert plot.read_bytes().startswith(b"\x89PNG")
    told = json.loads(run(omni.path, "--json").stdout)
    assert list(told) == [
        *("robot", "kind", "session", "plant", "found", "not_found", "residuals", "torques", "seconds", "moments"),
        *("likeness", "slipping", "abrupt", "problem"),
    ]
    assert list(told["found"]["mass"]) == ["value", "low", "high", "unit"]
    assert told["found"]["mass"]["low"] < 25.0 < told["found"]["mass"]["high"]
    read = read_parameters(out, omni.config)
    assert read.values == {name: one["value"] for name, one in (told["found"] | told["not_found"]).items()}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--known", "mass"), "must be NAME=VALUE"),
        (("--known", "colour=1"), "must be one of mass"),
        (("--known", "mass=-1"), "mass = -1: must be 0.001 or more kg"),
        (("--known", "mass=nan"), "must be 0.001 or more kg"),
    ],
)
def test_the_command_refuses_in_words(omni: Driven, words: tuple[str, ...], said: str) -> None:
    done = run(omni.path, *words)
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda file: file | {"kind": "omega"}, "of kind omega"),
        (lambda file: file | {"plant": "none"}, "none"),
        (lambda file: file | {"colour": 1}, "colour"),
        (lambda file: file | {"not_found": {"mass": {"value": -2.0, "reason": ""}}, "found": {}}, "mass = -2"),
        (lambda file: file | {"not_found": {"colour": {"value": 1.0, "reason": ""}}}, "must be one of mass"),
        (lambda file: [file], "object"),
    ],
)
def test_a_file_of_parameters_is_checked(omni: Driven, tmp_path: Path, change: Change, said: str) -> None:
    good = {
        **{"robot": "omni4", "kind": "omni", "session": "s", "plant": "simple", "found": {}, "not_found": {}},
        **{"residuals": {}, "torques": {}, "seconds": 1.0, "moments": 1},
    }
    path = tmp_path / "parameters.json"
    path.write_text(json.dumps(good))
    assert read_parameters(path, omni.config).values == {}
    path.write_text(json.dumps(change(good)))
    with pytest.raises(IdentifyError) as refused:
        read_parameters(path, omni.config)
    assert said in str(refused.value)


@pytest.mark.parametrize("module", ["gateway.service", "gateway.cli.run", "gateway.cli.replay"])
def test_scipy_costs_nobody_else_its_start(module: str) -> None:
    words = f"import {module}, sys; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0


def run(session: Path, *words: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "identify", str(session), *map(str, words)])


def _on_mujoco(name: str, twists: Twists, heavy: Mapping[str, float], folder: Path) -> Driven:
    """Robot file and controllers know nothing of what is otherwise."""
    plant = partial(_mujoco, heavy)
    return drive(folder, text_of(name), twists, seconds=16.0 if name == "moby" else 8.0, plant=plant)


def _mujoco(heavy: Mapping[str, float], robot: OmniRobot | OffsetDifferentialRobot) -> mujoco_plant.MujocoPlant:
    return mujoco_plant.MUJOCO_PLANTS[robot.kind](with_values(robot, heavy))
