"""Checks a file of reference vectors against the code: `python -m tests.golden FILE`.

The vectors use the papers' frames; `_FUNCTIONS` is the one place where they are converted to ours.
Rojas: x right, y forward, wheel axes at angles from right; ours are x forward, y left, so (vx, vy) of the paper is
(-left, forward) and an angle of the paper is ours plus a quarter turn. MOBY: world velocities and chassis heading;
with the platform heading at zero its frame is the world's, and the joint angle is minus the chassis heading.
Functions whose rooms are not built are listed as such and neither pass nor fail.
"""

import json
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.offset_differential import CasterGeometry, OffsetDifferentialKinematics
from gateway.types import Twist

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


_FUNCTIONS: dict[str, Callable[[Vector], dict[str, Any]]] = {
    "offset.forward": _offset_forward,
    "offset.inverse": _offset_inverse,
    "offset.caster_forward": _caster_forward,
    "offset.caster_inverse": _caster_inverse,
    "omni.D": _omni_d,
    "omni.D_pinv": _omni_d_pinv,
    "omni.slip_projector": _omni_slip_projector,
    "omni.slip_scalar_sym4": _slip_scalar,
    "omni.wheel_speeds": _omni_wheel_speeds,
    "omni.odometry_and_slip": _omni_odometry,
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
    """Exit 0 when nothing failed."""
    vectors = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))["vectors"]
    missing = Counter(vector["function"] for vector in vectors if vector["function"] not in _FUNCTIONS)
    results = [check(vector) for vector in vectors if vector["function"] in _FUNCTIONS]
    lines = [f"FAILED {result}" for result in results if result is not None]
    lines += [f"not built: {function} ({number} vectors)" for function, number in sorted(missing.items())]
    failed = sum(result is not None for result in results)
    sys.stdout.write("\n".join([*lines, f"{len(results) - failed} passed, {failed} failed"]) + "\n")
    return 1 if failed or not results else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
