"""What is mutated, and the test files that must notice, cheapest first.

The golden sessions and the replay laws are not among them: they notice that something changed, not that a rule broke.
"""

_RULES = ("tests/gateway/test_supervisor.py", "tests/gateway/test_limits.py", "tests/gateway/test_parts.py")
_CORE = (
    *(*_RULES, "tests/replay/test_closed_loop.py", "tests/replay/test_sim_robot.py"),
    *("tests/gateway/test_source_gate.py", "tests/test_safety.py", "tests/gateway/test_engine.py"),
)
_DRIVERS = ("tests/drivers/test_vectors.py", "tests/drivers/test_contract.py", "tests/drivers/test_dbc.py")
_DJI = ("tests/drivers/test_dji.py", *_DRIVERS, "tests/replay/test_sim_dji.py")
_ODRIVE = (
    *("tests/drivers/test_odrive.py", "tests/drivers/test_odrive_bringup.py", *_DRIVERS),
    *("tests/replay/test_sim_odrive.py", "tests/replay/test_sim_odrive_faults.py"),
)

TARGETS: dict[str, tuple[str, ...]] = {
    "gateway/core/supervisor.py": _CORE,
    "gateway/core/engine.py": _CORE,
    "gateway/core/health.py": _CORE,
    "gateway/core/detectors.py": _CORE,
    "gateway/core/joint_trust.py": _CORE,
    "gateway/core/standstill.py": _CORE,
    "gateway/core/motors.py": _CORE,
    "gateway/core/arbiter.py": _CORE,
    "gateway/edges/source_gate.py": _CORE,
    "gateway/control/limits.py": _CORE,
    "drivers/dji.py": _DJI,
    "drivers/odrive/group.py": _ODRIVE,
    "drivers/odrive/axis.py": _ODRIVE,
    "drivers/odrive/bringup.py": _ODRIVE,
    "drivers/twins.py": ("tests/drivers/test_twins.py",),
}
