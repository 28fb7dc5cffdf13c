"""Methods compared on stages: closed form, Pinocchio's constraints and a search in CasADi, which share no code."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from balancers import MACHINES, STAGES, stage_and_height
from cli.running import run
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.crosscheck import METHODS, ClosedForm, Ipopt, Quantity, compare_methods, make_methods, nlp

DIMENSIONS = ["--base", "0.08", "--platform", "0.09", "--crank", "0.05", "--rod", "0.11"]
NAMES = ["closed-form", "pinocchio", "nlp"]
OTHERS = {
    "other azimuths": spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), azimuths=np.deg2rad([-20.0, 95.0, 205.0])),
    "limits": spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=([-0.5, -0.4, -0.3], 1.2)),
}


@pytest.mark.parametrize("name", [*MACHINES, *OTHERS])
def test_methods_agree_on_every_kind_of_stage(name: str) -> None:
    stage = OTHERS[name] if name in OTHERS else stage_and_height(name)[0]
    report = compare_methods(stage, poses=5, seed=2, methods=NAMES)
    assert report.agrees, report.verdict
    compared = {quantity: sum(pair.quantity is quantity for pair in report.differences) for quantity in Quantity}
    assert compared == {"middle joints": 1, "assembly": 1, "inverse Jacobian": 3, "leg forces": 3}
    assert {pair.compared for pair in report.differences} == {report.states}
    assert report.scores[0].branches == report.scores[2].branches == report.states >= 4
    # Rounding is far below what conditioning would allow.
    assert max(pair.ratio for pair in report.differences) < 0.1


def test_a_numerical_search_finds_both_operation_modes_and_no_mirror_image() -> None:
    stage = STAGES["RPS"].perturbed(3, length=5e-3, angle=5e-3)
    pose = spm.pose([0.3, -0.2, 1.1], rotation=Rotation.from_euler("XYZ", [0.3, -0.4, 1.2]))
    found = nlp.search(stage, pose)
    closed = spm.inverse_displacement(stage, 1.1, normal=pose.as_matrix()[:3, 2])
    assert found.isolated.all()
    assert (found.error_bound < 1e-12).all()
    for state in closed:
        np.testing.assert_allclose(found.solutions.nearest(state).balls, state.balls, rtol=0, atol=1e-12)
    # The mirror images of a level platform are a continuous family.
    level = nlp.search(
        STAGES["RRS"], spm.pose([[0.0, 0.0, 0.12], [0.0, 0.0, 0.5]], rotation=np.tile(np.eye(3), (2, 1, 1)))
    )
    assert level.solutions.status.tolist() == [spm.Status.OK, spm.Status.UNREACHABLE]
    assert level.solutions.count.tolist() == [1, 0]
    few = Ipopt(stage, starts=12).inverse(pose)
    np.testing.assert_allclose(few.nearest(closed["T"]).balls, closed["T"].balls, rtol=0, atol=1e-9)


@dataclass
class Tilted(ClosedForm):
    """Tilts by a microradian too much: its loops close."""

    name: str = "tilted"

    def inverse(self, pose: RigidTransform) -> spm.SolutionSet:
        return super().inverse(pose * RigidTransform.from_rotation(Rotation.from_rotvec([1e-6, 0.0, 0.0])))


@dataclass
class WithoutParasiticMotion(ClosedForm):
    """Neglects the work of a load along the parasitic motion."""

    name: str = "without parasitic motion"

    def leg_forces(self, configuration: spm.Configuration, wrench: np.ndarray) -> np.ndarray:
        transposed = spm.inverse_jacobian(configuration).mT
        return -np.linalg.solve(transposed, wrench[..., 2:5, None])[..., 0]


def test_a_wrong_tilt_and_forces_without_parasitic_motion_are_found() -> None:
    stage = STAGES["RRS"]
    found = compare_methods(stage, poses=5, methods=[*NAMES, Tilted(stage), WithoutParasiticMotion(stage)])
    invented, outvoted = (
        {score.name: getattr(score, what) for score in found.scores} for what in ("invented", "outvoted")
    )
    assert [name for name, count in invented.items() if count] == ["tilted"]
    assert outvoted.pop("without parasitic motion") > 0
    assert outvoted.pop("tilted") > 0
    assert outvoted.pop("closed form") == outvoted.pop("nlp") == 0


def test_methods_that_take_no_stage_are_left_out_or_refused() -> None:
    assert [method.name for method in make_methods(None, STAGES["RPS"])] == ["closed form", "pinocchio", "nlp", "ipopt"]
    for name in ("RPS", "PRS"):
        with pytest.raises(spm.SpmError) as refused:
            METHODS["paper"](STAGES[name])
        assert refused.value.argument == "machine"
    with pytest.raises(spm.ArgumentError) as refused:
        compare_methods("stage", poses=2)
    assert refused.value.argument == "machine"


def test_commands_compare_a_stage_and_reproduce_its_requests(tmp_path: Path) -> None:
    path, data = tmp_path / "stage.yaml", tmp_path / "report.json"
    STAGES["RRS"].to_yaml(path)
    chosen = ["--poses", "3", *(word for name in ("closed-form", "nlp") for word in ("--method", name))]
    done = run("crosscheck", "--machine", str(path), *chosen, "--out", str(data))
    assert done.returncode == 0, done.stderr
    content = json.loads(data.read_text(encoding="utf-8"))
    assert (content["geometry"]["base_radius"], content["geometry"]["platform_radius"]) == (0.08, 0.09)
    assert [list(request) for request in content["poses"]] == [["height", "roll_degrees", "pitch_degrees"]] * 3
    command = content["differences"][0]["reproduce"]
    assert command.startswith("spm-pin stage inverse --height ")
    assert run(*shlex.split(command)[1:]).returncode == 0
    typed = run("stage", "crosscheck", *DIMENSIONS, *chosen)
    assert typed.returncode == 0, typed.stderr
    assert "--machine FILE" in typed.stdout
