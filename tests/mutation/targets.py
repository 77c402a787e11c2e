"""What is mutated, and the test files that must notice: those of the module itself first, then cheapest first.

The golden sessions and the replay laws are not among them: they notice that something changed, not that a rule broke.
"""

_GATEWAY, _DRIVERS, _REPLAY = "tests/gateway/test_", "tests/drivers/test_", "tests/replay/test_"

_CORE = (
    *(f"{_GATEWAY}{name}.py" for name in ("health", "arbiter", "parts", "odometry", "estop_latch")),
    *(f"{_REPLAY}{name}.py" for name in ("closed_loop", "sim_robot")),
    *(f"{_GATEWAY}{name}.py" for name in ("engine_rules", "detection_figures", "engine")),
    *("tests/test_safety.py", "tests/test_laws.py"),
)
_WIRE = tuple(f"{_DRIVERS}{name}.py" for name in ("vectors", "dbc", "contract"))
_DJI = (f"{_DRIVERS}dji.py", f"{_REPLAY}sim_dji.py", *_WIRE, f"{_DRIVERS}stop_frames.py")
_ODRIVE = (
    *(f"{_DRIVERS}odrive_bringup.py", f"{_DRIVERS}odrive.py"),
    *(f"{_REPLAY}sim_odrive_faults.py", f"{_REPLAY}sim_odrive.py", *_WIRE, f"{_DRIVERS}stop_frames.py"),
)


def _core(name: str) -> tuple[str, ...]:
    return (f"{_GATEWAY}{name}.py", *(file for file in _CORE if file != f"{_GATEWAY}{name}.py"))


TARGETS: dict[str, tuple[str, ...]] = {
    "gateway/core/supervisor.py": _core("supervisor"),
    "gateway/core/engine.py": _core("engine_rules"),
    "gateway/core/health.py": _core("health"),
    "gateway/core/detectors.py": _core("detectors"),
    "gateway/core/joint_trust.py": _core("joint_trust"),
    "gateway/core/standstill.py": _core("standstill"),
    "gateway/core/motors.py": _core("motors"),
    "gateway/core/arbiter.py": _core("arbiter"),
    "gateway/edges/source_gate.py": _core("source_gate"),
    "gateway/control/limits.py": _core("limits"),
    "gateway/control/drive_law.py": _core("drive_law"),
    "gateway/control/manoeuvre.py": (f"{_GATEWAY}manoeuvre.py", f"{_GATEWAY}region_policy.py"),
    "gateway/control/region_policy.py": (f"{_GATEWAY}region_policy.py", f"{_GATEWAY}region_drives.py"),
    "gateway/kinematics/reach.py": (f"{_GATEWAY}reach.py", f"{_GATEWAY}kinematics.py"),
    "gateway/teleop/hand.py": (f"{_GATEWAY}teleop.py",),
    "gateway/teleop/pad.py": (f"{_GATEWAY}teleop.py",),
    "drivers/dji.py": _DJI,
    "drivers/odrive/group.py": _ODRIVE,
    "drivers/odrive/axis.py": _ODRIVE,
    "drivers/odrive/bringup.py": _ODRIVE,
    "drivers/twins.py": ("tests/drivers/test_twins.py",),
}
