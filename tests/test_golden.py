"""Reference vectors made independently of this project (50-digit arithmetic) hold; a wrong one is noticed."""

import json
from pathlib import Path

import pytest

from tests import golden

VECTORS = Path(__file__).parent / "vectors" / "kinematics.json"


def test_every_vector_holds(capsys: pytest.CaptureFixture[str]) -> None:
    assert golden.main([str(VECTORS)]) == 0
    assert capsys.readouterr().out.endswith("71 passed, 0 failed\n")


def test_every_vector_of_the_pull_region_holds(capsys: pytest.CaptureFixture[str]) -> None:
    assert golden.main([str(VECTORS.with_name("pull_region.json"))]) == 0
    assert capsys.readouterr().out.endswith("52 passed, 0 failed\n")


def test_every_vector_of_omni_dynamics_and_motors_holds(capsys: pytest.CaptureFixture[str]) -> None:
    assert golden.main([str(VECTORS.with_name("omni_dynamics.json"))]) == 0
    assert capsys.readouterr().out.endswith("24 passed, 0 failed\n")


def test_every_vector_of_forces_and_slip_of_omni_wheels_holds(capsys: pytest.CaptureFixture[str]) -> None:
    assert golden.main([str(VECTORS.with_name("omni.json"))]) == 0
    assert capsys.readouterr().out.endswith("27 passed, 0 failed\n")


def test_every_vector_of_the_omni_differential_drive_holds(capsys: pytest.CaptureFixture[str]) -> None:
    assert golden.main([str(VECTORS.with_name("odd.json"))]) == 0
    assert capsys.readouterr().out.endswith("36 passed, 0 failed\n")


def test_a_wrong_vector_fails_and_an_unknown_function_is_not_built(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = json.loads(VECTORS.read_text(encoding="utf-8"))
    wrong, unknown = document["vectors"][0], document["vectors"][1]
    wrong["expected"]["xdot"] += 1e-9
    unknown["function"] = "offset.unheard_of"
    path = tmp_path / "vectors.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    assert golden.main([str(path)]) == 1
    out = capsys.readouterr().out
    assert f"FAILED {wrong['id']}: xdot" in out
    assert "not built: offset.unheard_of (1 vectors)" in out
    assert out.endswith("69 passed, 1 failed\n")
