"""Checks a file of reference vectors against the code: `python -m tests.golden FILE [FILE ...]`.

The vectors use the papers' frames; `_FUNCTIONS` is the one place where they are converted to ours.
Rojas: x right, y forward, wheel axes at angles from right; ours are x forward, y left, so (vx, vy) of the paper is
(-left, forward) and an angle of the paper is ours plus a quarter turn. MOBY: world velocities and chassis heading;
with the platform heading at zero its frame is the world's, and the joint angle is minus the chassis heading.
Omni Differential Drive (odd): our axes.
Amarasiri et al. 2022 (omni004): our axes, but in inches, slug (lbf s^2/ft) and lbf in.
Functions whose rooms are not built are listed as such and neither pass nor fail.
"""

import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from math import cos, hypot, inf, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.control.compensation import Compensation, RegionAt
from gateway.control.launch import stepped_voltage
from gateway.control.pull_region import Pull, examine, goal_of
from gateway.kinematics.contract import GeometryError
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.forces import PushTable, force_coupling, least_forces
from gateway.kinematics.linear import Matrix, pseudo_inverse
from gateway.kinematics.mecanum import roller_tangent
from gateway.kinematics.odd import OddGeometry, sigma1
from gateway.kinematics.offset_differential import CasterGeometry, OffsetDifferentialKinematics
from gateway.types import Twist
from replay.reproduce.kane_model import Response, gains_for
from replay.sim.controllers.dc_motor import DcMotor
from replay.sim.plants.odd_equations import TwoBodies
from replay.sim.plants.offset_dynamics import SWIVEL, OffsetDynamics, OffsetParameters
from replay.sim.plants.omni_equations import OmniEquations
from replay.sim.plants.omni_parameters import OmniParameters, kane_robot

Vector = Mapping[str, Any]
_TO_PAPER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # (vx, vy, R w) of the paper from ours


def _omni(given: Vector) -> FixedWheels:
    """Wheels of unit radius on a circle of unit radius: rim speeds are wheel speeds, R w is w."""
    angles = [theta - pi / 2.0 for theta in given["thetas"]]
    return omni_kinematics([WheelPose(cos(angle), sin(angle), angle, 1.0) for angle in angles])


def _projector(kinematics: FixedWheels) -> npt.NDArray[np.float64]:
    """I - D D+: what of rim speeds no rigid motion explains."""
    rows = np.array(kinematics.rim_matrix)
    return np.asarray(np.eye(len(rows)) - rows @ np.array(kinematics.rim_pinv))


def _omni_d(given: Vector) -> dict[str, Any]:
    return {"D": np.array(_omni(given).rim_matrix) @ _TO_PAPER.T}


def _omni_d_pinv(given: Vector) -> dict[str, Any]:
    return {"Dplus": _TO_PAPER @ np.array(_omni(given).rim_pinv)}


def _omni_slip_projector(given: Vector) -> dict[str, Any]:
    return {"P": _projector(_omni(given))}


def _omni_wheel_speeds(given: Vector) -> dict[str, Any]:
    return {"m": _omni(given).wheel_speeds(Twist(given["vy"], -given["vx"], given["R_omega"]))}


def _omni_odometry(given: Vector) -> dict[str, Any]:
    kinematics = _omni(given)
    estimate = kinematics.twist(given["m"])
    assert estimate is not None
    return {
        "v": _TO_PAPER @ np.array(estimate.twist),
        "residual": estimate.residuals or (0.0,) * len(given["m"]),
        "residual_norm": estimate.residual if estimate.residual is not None else 0.0,
        "projected": kinematics.wheel_speeds(estimate.twist),
    }


def _slip_scalar(given: Vector) -> dict[str, Any]:
    """Symmetric four wheels, any phi: the residual is (s/4)(1, -1, 1, -1)."""
    phi = pi / 6.0
    kinematics = _omni({"thetas": [phi, pi - phi, pi + phi, -phi]})
    measured = np.array(given["m"])
    estimate = kinematics.twist(given["m"])
    assert estimate is not None
    residual = np.array(estimate.residuals, np.float64)
    return {"s": 4.0 * residual[0], "projected": measured - residual}


def _slip_scalar_asym(given: Vector) -> dict[str, Any]:
    """Front at phi, rear at theta: what no motion explains lies along g, so that g . r is g . m."""
    phi, theta = given["phi"], given["theta"]
    estimate = _omni({"thetas": [phi, pi - phi, pi + theta, -theta]}).twist(given["m"])
    assert estimate is not None
    residual = np.array(estimate.residuals, np.float64)
    return {"s": residual @ [cos(theta), -cos(theta), cos(phi), -cos(phi)], "residual": residual}


def _force_coupling(given: Vector) -> Matrix:
    """Of the same wheels, at the radius of one metre; I = alpha M R^2."""
    mass = given["M"]
    inertia = ((mass, 0.0, 0.0), (0.0, mass, 0.0), (0.0, 0.0, given["alpha"] * mass))
    return force_coupling(_omni(given).rim_matrix, inertia)


def _omni_c(given: Vector) -> dict[str, Any]:
    return {"matrix": _TO_PAPER @ np.array(_force_coupling(given))}


def _omni_c_pinv(given: Vector) -> dict[str, Any]:
    return {"matrix": np.array(pseudo_inverse(_force_coupling(given))) @ _TO_PAPER.T}


def _omni_dc(given: Vector) -> dict[str, Any]:
    return {"matrix": np.array(_omni(given).rim_matrix) @ np.array(_force_coupling(given))}


def _forces_one_motor_out(given: Vector) -> dict[str, Any]:
    usable = [place != given["dead"] for place in range(len(given["thetas"]))]
    acceleration = (given["ay"], -given["ax"], given["R_omega_dot"])
    return {"f": least_forces(_force_coupling(given), acceleration, usable)}


def _effective_motors(given: Vector) -> dict[str, Any]:
    phi = given["phi"]
    rows = _omni({"thetas": [phi, pi - phi, pi + phi, -phi]}).rim_matrix
    return {"n_eff": PushTable(rows, (1.0,) * 4).along(given["psi"] - pi / 2.0, (True,) * 4)}


def _offset(given: Vector) -> OffsetDifferentialKinematics:
    caster = None
    if "d3" in given:
        caster = CasterGeometry(given["d3"], given["d4"], given["Rc"])
    return OffsetDifferentialKinematics(
        wheel_radius=given.get("R", 1.0), axle_offset=given["d1"], track=given.get("d2", 1.0), caster=caster
    )


def _offset_twist(given: Vector) -> Twist:
    phi = -given["theta_c"]
    speeds = [given["alphaL_dot"], given["alphaR_dot"], given.get("phi_dot", 0.0)]
    estimate = _offset(given).twist(speeds, [None, None, phi])
    assert estimate is not None
    return estimate.twist


def _offset_forward(given: Vector) -> dict[str, Any]:
    twist = _offset_twist(given)
    chassis = twist.wz - given["phi_dot"]
    return {"xdot": twist.vx, "ydot": twist.vy, "thetap_dot": twist.wz, "thetac_dot": chassis}


def _offset_inverse(given: Vector) -> dict[str, Any]:
    twist = Twist(given["xdot"], given["ydot"], given["thetap_dot"])
    speeds = _offset(given).wheel_speeds(twist, [None, None, -given["theta_c"]])
    assert speeds is not None
    left, right, joint = speeds
    return {"alphaL_dot": left, "alphaR_dot": right, "phi_dot": joint, "thetac_dot": twist.wz - joint}


def _caster(given: Vector, twist: Twist) -> dict[str, Any]:
    rates = _offset(given).caster_rates(twist, phi=-given["theta_c"], beta=given["beta"])
    return {"beta_dot": rates.swivel, "alphac_dot": rates.roll}


def _caster_forward(given: Vector) -> dict[str, Any]:
    return _caster(given, _offset_twist(given))


def _caster_inverse(given: Vector) -> dict[str, Any]:
    return _caster(given, Twist(given["xdot"], given["ydot"], 0.0))


def _pull(given: Vector) -> Pull:
    pull = examine(
        given["xdot"],
        given["ydot"],
        angle=-given["theta_c"],
        path_rate=given.get("omega", 0.0),
        axle_offset=given.get("d1", 1.0),
    )
    assert pull is not None
    return pull


def _gamma(given: Vector) -> dict[str, Any]:
    pull = _pull(given)
    speed = hypot(given["xdot"], given["ydot"])
    return {"gamma": pull.gamma, "cos_gamma": cos(pull.gamma), "speed": speed, "region": pull.region.value}


def _gamma_goal(given: Vector) -> dict[str, Any]:
    goal, saturated = goal_of(given["omega"], given["c"], given["d1"])
    return {"gamma_goal": goal, "saturated": saturated}


def _compensation(given: Vector, region: float) -> Compensation:
    """With an authority that nothing exhausts."""
    regions = (RegionAt(0.0, region),)
    return Compensation(gain=given["k"], regions=regions, axle_offset=given["d1"], authority=1e12)


def _compensate(given: Vector) -> dict[str, Any]:
    """`active` is not told by the code: it is the error within the region."""
    x, y, pull = _compensation(given, given["region"]).turn(
        given["xdot"], given["ydot"], joint=-given["theta_c"], path_rate=given["omega"], dt=1.0
    )
    assert pull is not None
    return {"xdot": x, "ydot": y, "gamma_err": pull.error, "active": abs(pull.error) <= given["region"]}


_STEPS_PER_OFFSET = 800  # of way: Runge's fourth-order error is below 1e-13 of the angle


def _heading_after(given: Vector, heading: float, velocity: tuple[float, float], way: float, gain: float) -> float:
    """Of the chassis, by integrating what the kinematics and the compensation say; the platform keeps heading 0."""
    kinematics = _offset(given)
    compensation = _compensation({"k": gain, "d1": given["d1"]}, pi)
    speed = hypot(*velocity)
    vx, vy = velocity[0] / speed, velocity[1] / speed
    steps = max(1, round(way / given["d1"] * _STEPS_PER_OFFSET))

    def rate(at: float) -> float:
        x, y, _ = compensation.turn(vx, vy, joint=-at, path_rate=0.0, dt=1.0) if gain != 0.0 else (vx, vy, None)
        speeds = kinematics.wheel_speeds(Twist(x, y, 0.0), [None, None, -at])
        assert speeds is not None
        return -speeds[2]

    h = way / steps
    for _ in range(steps):
        one = rate(heading)
        two = rate(heading + 0.5 * h * one)
        three = rate(heading + 0.5 * h * two)
        heading += h / 6.0 * (one + 2.0 * two + 2.0 * three + rate(heading + h * three))
    return heading


def _gamma_free(given: Vector) -> dict[str, Any]:
    gamma0 = given["gamma0"]
    return {"gamma": -_heading_after(given, -gamma0, (1.0, 0.0), given["s"], 0.0)}


def _gamma_err_compensated(given: Vector) -> dict[str, Any]:
    heading = _heading_after(given, pi - given["err0"], (1.0, 0.0), given["s"], given["k"])
    return {"err": pi - heading}


def _step_theta(given: Vector) -> dict[str, Any]:
    velocity = given["xdot"], given["ydot"]
    way = hypot(*velocity) * given["dt"]
    return {"theta_c_next": _heading_after(given, given["theta_c"], velocity, way, 0.0)}


def _trapezoid(given: Vector) -> dict[str, Any]:
    """Speed up for a quarter, hold for a half, slow down for a quarter of the time (section 7 of the paper)."""
    quarter, top, t = given["T"] / 4.0, given["c"], given["t"]
    rate = top / quarter
    if t <= quarter:
        return {"v": rate * t, "s": 0.5 * rate * t * t}
    if t <= 3.0 * quarter:
        return {"v": top, "s": top * (t - 0.5 * quarter)}
    left = given["T"] - t
    return {"v": rate * left, "s": 3.0 * quarter * top - 0.5 * rate * left * left}


def _inverse_dynamics(given: Vector) -> dict[str, Any]:
    keys = ("R", "d1", "d2", "d3", "d4", "Rc", "mc", "xB", "Ic", "mw", "Iwax", "Iwrad", "mp", "Ip", "mcf", "lam", "Icf")
    robot = OffsetDynamics(OffsetParameters(*[given[key] for key in (*keys, "mcw", "Icwax", "Icwrad")]))
    place = [0.0, 0.0, -given["theta_c"], 0.0, 0.0, 0.0, given["beta"], 0.0]
    found = robot.inverse(place, (given["xdot"], given["ydot"], 0.0), (given["xddot"], given["yddot"], 0.0))
    return {
        **dict(zip(("tauL", "tauR", "tauPhi"), found.torques, strict=True)),
        **dict(zip(("ground_force_x", "ground_force_y"), found.ground, strict=True)),
        "beta_ddot": float(found.acceleration[SWIVEL]),
    }


def _pid_from_poles(given: Vector) -> dict[str, Any]:
    response = Response(peak=given["tp"], settled=given["ts"], third=given["third_pole"])
    gains, inertia = gains_for(given["Kd"], response)
    return {"J": inertia, "Kp": gains.proportional, "Ki": gains.integral}


_STEPS_PER_INTERVAL = 200  # of Runge's fourth order: below 1e-13 of the speed


def _voltage_stepping(given: Vector) -> dict[str, Any]:
    """A motor of 1 ohm and 1 V s/rad on the inertia that gives the time constant; its voltage set at each interval."""
    motor, top = DcMotor(resistance=1.0, constant=1.0), given["Vmax"]
    rate, voltages, after = 0.0, [], []
    for _ in range(given["n"]):
        voltages.append(stepped_voltage(given["V0"], motor.back_emf(rate), inf if top is None else top))
        rate = _spun(motor, rate, voltages[-1], inertia=given["tau_m"], seconds=given["dt"])
        after.append(motor.back_emf(rate))
    return {"V": voltages, "E_after": after}


def _spun(motor: DcMotor, rate: float, voltage: float, *, inertia: float, seconds: float) -> float:
    def slope(at: float) -> float:
        return motor.torque(motor.current(voltage, at)) / inertia

    h = seconds / _STEPS_PER_INTERVAL
    for _ in range(_STEPS_PER_INTERVAL):
        one = slope(rate)
        two = slope(rate + 0.5 * h * one)
        three = slope(rate + 0.5 * h * two)
        rate += h / 6.0 * (one + 2.0 * two + 2.0 * three + slope(rate + h * three))
    return rate


_INCH, _SLUG = 0.0254, 14.593902937206365  # m, kg
_LBF_IN = 12.0 * _SLUG * _INCH * _INCH  # N m


def _kane(given: Vector) -> OmniParameters:
    """The paper's robot with the lengths of a vector, which are in inches."""
    robot = kane_robot(given["Lm"] * _INCH)
    wheels = [
        wheel._replace(radius=given.get("R", 3.0) * _INCH, roller_radius=given.get("r", 0.4) * _INCH)
        for wheel in robot.wheels
    ]
    return robot._replace(wheels=tuple(wheels))


def _kane_dynamics(given: Vector) -> dict[str, Any]:
    robot = OmniEquations(_kane(given))
    motion = given["V1"] * _INCH, given["V2"] * _INCH, given["Omega"]
    found = robot.acceleration(motion, robot.driven([torque * _LBF_IN for torque in given["T"]]))
    return {
        "V1_dot": found[0] / _INCH,
        "V2_dot": found[1] / _INCH,
        "Omega_dot": found[2],
        "kinetic_energy": robot.energy(motion) / _LBF_IN,
    }


def _kane_wheel_speeds(given: Vector) -> dict[str, Any]:
    robot, (s, c) = OmniEquations(_kane(given)), (sin(given["q3"]), cos(given["q3"]))
    x, y = given["u1"] * _INCH, given["u2"] * _INCH
    motion = c * x + s * y, c * y - s * x, given["Omega"]
    return {"omega": robot.joint_rates(motion), "roller": robot.roller_rates(motion)}


def _kane_odometry(given: Vector) -> dict[str, Any]:
    """By the core's kinematics. The residual is a quarter of the slip along the one direction no motion explains."""
    wheels = [WheelPose(wheel.x, wheel.y, wheel.axis_angle, wheel.radius) for wheel in _kane(given).wheels]
    kinematics = omni_kinematics(wheels)
    estimate = kinematics.twist(given["omega"])
    assert estimate is not None
    assert estimate.residuals is not None
    (vx, vy, wz), (s, c) = estimate.twist, (sin(given["q3"]), cos(given["q3"]))
    first = estimate.residuals[0]
    assert first is not None
    return {
        **{"u1": (c * vx - s * vy) / _INCH, "u2": (s * vx + c * vy) / _INCH, "Omega": wz},
        "slip": 4.0 * first / wheels[0].radius,
        "omega_consistent": kinematics.wheel_speeds(estimate.twist),
    }


_ODD_AXES = ("xB", "yB", "phiB", "d")


def _odd(given: Vector) -> OddGeometry:
    """Our axes, at one width; where the file gives no radius it is one metre."""
    return OddGeometry(
        given["alpha"], radius=given.get("r", 1.0), spacing=given["w"], narrowest=given["d"], widest=given["d"]
    )


def _odd_inverse(given: Vector) -> dict[str, Any]:
    geometry, rates = _odd(given), tuple(given[f"{axis}_dot"] for axis in _ODD_AXES)
    return {"theta_dot": geometry.wheel_speeds(rates, given["d"]), "sigma1": geometry.sigma(given["d"])}


def _odd_forward(given: Vector) -> dict[str, Any]:
    geometry = _odd(given)
    rates, sides = geometry.rates(given["theta_dot"], given["d"]), geometry.sides(given["theta_dot"], given["d"])
    assert rates is not None
    assert sides is not None
    moving = {f"{axis}_dot": rate for axis, rate in zip(_ODD_AXES, rates, strict=True)}
    return {**moving, **dict(zip(("xL", "yL", "xR", "yR"), (*sides.left, *sides.right), strict=True))}


def _odd_singularity(given: Vector) -> dict[str, Any]:
    """A singular one is refused."""
    one, two, three, four = [roller_tangent(angle) for angle in given["alpha"]]
    sigma = sigma1((one, two, three, four), width=given["d"], spacing=given["w"])
    try:
        _odd(given)
    except GeometryError:
        return {"sigma1": sigma, "singular": True}
    return {"sigma1": sigma, "singular": False}


def _odd_dynamics(given: Vector) -> dict[str, Any]:
    bodies, width = TwoBodies(given["mL"], given["mR"]), given["d"]
    rates, changes = [[given[f"{axis}_{order}"] for axis in _ODD_AXES] for order in ("dot", "ddot")]
    forces = bodies.forces(width, tuple(rates), tuple(changes))
    return {
        **dict(zip(("FxL", "FyL", "FxR", "FyR"), (*forces.left, *forces.right), strict=True)),
        **{"yC": bodies.centre(width), "I": bodies.inertia(width)},
    }


_FUNCTIONS: dict[str, Callable[[Vector], dict[str, Any]]] = {
    "offset.forward": _offset_forward,
    "offset.inverse": _offset_inverse,
    "offset.caster_forward": _caster_forward,
    "offset.caster_inverse": _caster_inverse,
    "offset.gamma": _gamma,
    "offset.gamma_goal": _gamma_goal,
    "offset.compensate": _compensate,
    "offset.gamma_free": _gamma_free,
    "offset.gamma_err_compensated": _gamma_err_compensated,
    "offset.step_theta": _step_theta,
    "profile.trapezoid_quarter": _trapezoid,
    "moby.inverse_dynamics": _inverse_dynamics,
    "omni004.pid_from_poles": _pid_from_poles,
    "motor.voltage_stepping": _voltage_stepping,
    "omni004.forward_dynamics": _kane_dynamics,
    "omni004.wheel_speeds": _kane_wheel_speeds,
    "omni004.odometry": _kane_odometry,
    "omni.D": _omni_d,
    "omni.D_pinv": _omni_d_pinv,
    "omni.slip_projector": _omni_slip_projector,
    "omni.slip_scalar_sym4": _slip_scalar,
    "omni.wheel_speeds": _omni_wheel_speeds,
    "omni.odometry_and_slip": _omni_odometry,
    "omni.slip_scalar_asym4": _slip_scalar_asym,
    "omni.C_alpha": _omni_c,
    "omni.C_alpha_pinv": _omni_c_pinv,
    "omni.DC_alpha": _omni_dc,
    "omni.forces_one_motor_out": _forces_one_motor_out,
    "omni.effective_motors_sym4": _effective_motors,
    "odd.inverse": _odd_inverse,
    "odd.forward": _odd_forward,
    "odd.singularity": _odd_singularity,
    "odd.inverse_dynamics": _odd_dynamics,
}


def check(vector: Vector) -> str | None:
    """None when the vector holds, else what was got and expected."""
    got = _FUNCTIONS[vector["function"]](vector["input"])
    for name, expected in vector["expected"].items():
        if not _close(got[name], expected, vector["rtol"], vector["atol"]):
            return f"{vector['id']}: {name} = {got[name]}, expected {expected}"
    return None


def _close(got: object, expected: object, rtol: float, atol: float) -> bool:
    if isinstance(expected, bool | str):
        return bool(got == expected)
    have, want = np.asarray(got, dtype=float), np.asarray(expected, dtype=float)
    return bool(have.shape == want.shape and np.all(np.abs(have - want) <= atol + rtol * np.abs(want)))


def main(arguments: Sequence[str]) -> int:
    """Prints a table of the functions and what missed; exit 0 when nothing failed."""
    vectors = [vector for name in arguments for vector in json.loads(Path(name).read_text(encoding="utf-8"))["vectors"]]
    missing = Counter(vector["function"] for vector in vectors if vector["function"] not in _FUNCTIONS)
    results = [(vector["function"], check(vector)) for vector in vectors if vector["function"] in _FUNCTIONS]
    every = Counter(function for function, _ in results)
    missed = Counter(function for function, result in results if result is not None)
    lines = [f"{'function':<30} passed failed"]
    lines += [f"{name:<30} {every[name] - missed[name]:>6} {missed[name]:>6}" for name in sorted(every)]
    lines += [f"FAILED {result}" for _, result in results if result is not None]
    lines += [f"not built: {function} ({number} vectors)" for function, number in sorted(missing.items())]
    failed = missed.total()
    sys.stdout.write("\n".join([*lines, f"{len(results) - failed} passed, {failed} failed"]) + "\n")
    return 1 if failed or not results else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
