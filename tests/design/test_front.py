"""Searches for dimensions: fronts, files that are resumed, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli.running import COMMAND, run
from distributed import LocalCluster
from error_fields import with_fields
from kinds_of_legs import SERVOS_AND_SCREWS

import spm_pin as spm
from spm_pin.design import DesignProblem, Front, Task, evaluate_designs, pareto_front
from spm_pin.display.figures import front_figure
from spm_pin.machine import PRS, RRS
from spm_pin.multibody import PlatformPath
from spm_pin.sweeps import METRICS

pytest.importorskip("pymoo")

MACHINE = spm.Manipulator(0.7, 0.35, 0.8, spm.LegLimits(1.2, 1.4))
PROBLEM = DesignProblem(
    MACHINE,
    free={"platform_radius": (0.25, 0.6), "base_radius": (0.5, 0.9), "upper_stroke": (0.1, 0.25)},
    aims={"payload_low": "max", "footprint": "min"},
    at_least={"assembled": 1.0},
)
SMALL: dict[str, Any] = {"population": 8, "generations": 4, "states": 64, "seed": 5}


def test_machines_have_the_values_of_the_free_variables() -> None:
    machine = PROBLEM.machine_of(np.array([0.3, 0.6, 0.2]))
    assert machine.dimensions == (0.6, 0.3, 0.8)
    assert machine.limits is not None
    np.testing.assert_allclose(machine.limits.minimum, [1.2] * 6)
    np.testing.assert_allclose(machine.limits.maximum, [1.4] * 3 + [1.4] * 3)
    both = DesignProblem(MACHINE, {"minimum": (1.0, 1.2), "stroke": (0.1, 0.3)}, PROBLEM.aims)
    assert both.machine_of(np.array([1.1, 0.15])).limits == spm.LegLimits(1.1, 1.1 + 0.15)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("search") / "front.json"


@pytest.fixture(scope="module")
def front(store: Path) -> Front:
    return pareto_front(PROBLEM, store, **SMALL)


def test_a_front_is_what_no_evaluated_machine_beats(front: Front) -> None:
    assert len(front.evaluated) == 32
    every, chosen = (
        np.stack([-found.columns["payload_low"], found.columns["footprint"]], axis=-1)
        for found in (front.evaluated, front.designs)
    )
    for row in chosen:
        assert not ((every <= row).all(axis=-1) & (every < row).any(axis=-1)).any()
    assert (np.diff(chosen[:, 0]) >= 0.0).all()
    again = evaluate_designs(front.designs.machines, "payload", states=64, seed=5)
    np.testing.assert_array_equal(again.columns["payload_low"], front.designs.columns["payload_low"])
    reference = front.reference.columns["payload_low"][0], front.reference.columns["footprint"][0]
    np.testing.assert_array_equal(front.better, (-chosen[:, 0] >= reference[0]) & (chosen[:, 1] <= reference[1]))


def test_an_interrupted_search_ends_as_one_that_was_not(front: Front, store: Path, tmp_path: Path) -> None:
    def interrupt(step: str, done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pareto_front(PROBLEM, tmp_path / "parts.json", **SMALL, progress=interrupt)
    stored = json.loads((tmp_path / "parts.json").read_text(encoding="utf-8"))
    assert len(stored["generations"]) == 2
    assert stored["versions"]["spm_pin"] == spm.__version__
    assert stored["seed"] == 5
    parts = pareto_front(PROBLEM, tmp_path / "parts.json", **SMALL)
    assert (tmp_path / "parts.json").read_bytes() == store.read_bytes()
    assert_same(parts, front)


def assert_same(found: Front, expected: Front) -> None:
    for name, column in expected.designs.columns.items():
        np.testing.assert_array_equal(column, found.designs.columns[name])


def test_a_finished_search_is_read_and_another_one_refused(
    front: Front, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(spm.ArgumentError, match="seed is 5 in the store and 6 in this search"):
        pareto_front(PROBLEM, store, **{**SMALL, "seed": 6})
    evaluated: list[int] = []

    def count(machines: Any, *args: Any, **options: Any) -> Any:
        evaluated.append(len(machines))
        return evaluate_designs(machines, *args, **options)

    monkeypatch.setattr("spm_pin.design.designs.evaluate_designs", count)
    assert_same(pareto_front(PROBLEM, store, **SMALL), front)
    assert evaluated == [1]  # the reference
    content = json.loads(store.read_text(encoding="utf-8"))
    first = content["generations"][0]
    # Not an aim, but a column of the result.
    fewer = {**first, "columns": {name: column for name, column in first["columns"].items() if name != "payload_mean"}}
    short = {"values": first["values"], "columns": {"payload_low": [1.0]}}
    damages = [{}, *({**content, "generations": wrong} for wrong in ([first, fewer], 5, [{}], [short]))]
    for damage in damages:
        (tmp_path / "front.json").write_text(json.dumps(damage), encoding="utf-8")
        with pytest.raises(spm.ArgumentError, match=r"front\.json.*cannot be read"):
            pareto_front(PROBLEM, tmp_path / "front.json", **SMALL)


def test_processes_are_started_once_for_a_search_and_give_the_same(
    front: Front, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[int] = []

    def count(*args: Any, **options: Any) -> Any:
        started.append(1)
        return LocalCluster(*args, **options)

    monkeypatch.setattr("distributed.LocalCluster", count)
    for _ in range(2):
        assert_same(pareto_front(PROBLEM, tmp_path / "shared.json", **SMALL, workers=2), front)
        assert started == [1], "none for what is only read"


def test_bounds_are_kept_and_machines_without_numbers_lose(tmp_path: Path) -> None:
    wide = DesignProblem(
        spm.Manipulator(0.7, 0.35, 0.8, spm.LegLimits(0.5, 0.7)),
        free={"middle_side": (0.2, 1.2), "stroke": (0.1, 1.2)},
        aims={"volume": "max", "conditioning_low": "max"},
        at_least={"certified": 1.0},
    )
    front = pareto_front(wide, tmp_path / "front.json", **SMALL)
    assert (front.designs.columns["certified"] == 1.0).all()
    assert not (front.evaluated.columns["certified"] == 1.0).all()
    # One aim gives the best machine. E has a bound by the footprint, which the largest volume at a payload does not.
    problem = DesignProblem(MACHINE, PROBLEM.free, {"volume": "max"}, {"payload_low": 0.3}, {"footprint": 1.5})
    front = pareto_front(problem, tmp_path / "best.json", **SMALL)
    columns = front.evaluated.columns
    keep = (columns["payload_low"] >= 0.3) & (columns["footprint"] <= 1.5)
    assert 0 < keep.sum() < len(keep)
    assert front.designs.columns["volume"].tolist() == [columns["volume"][keep].max()]
    front_figure(front)


@pytest.mark.parametrize(
    "changes",
    [
        {"free": {"height": (1.0, 2.0)}},
        *({"free": {"stroke": ends}} for ends in ((2.0, 1.0), (1.0, 1.0 + 1e-15), (1e-12, 1.0), (1.0, 1e12))),
        {"free": {"middle_side": (500, 1100)}},  # in millimetres
        {"free": {"stroke": (0.1, 0.2), "lower_stroke": (0.1, 0.2)}},
        {"free": {}},
        {"aims": {}},
        {"at_most": {"beauty": 1.0}},
        {"aims": {"volume": "most", "footprint": "min"}},
        {"aims": {"beauty": "max", "footprint": "min"}},
        {"machine": spm.Manipulator(0.7, 0.35, 0.8)},
    ],
    ids=repr,
)
def test_problems_that_are_none_are_refused(changes: dict[str, Any]) -> None:
    arguments = {name: getattr(PROBLEM, name) for name in ("machine", "free", "aims", "at_least")}
    with pytest.raises(spm.ArgumentError) as caught:
        DesignProblem(**{**arguments, **changes})
    assert caught.value.argument.partition(".")[0].partition("[")[0] in changes


SEARCH = ["--free", "platform_radius:0.25:0.6", "--free", "base_radius:0.5:0.9", "--population", "8", "--states", "64"]
SEARCH += ["--maximise", "payload_low", "--minimise", "footprint", "--at-least", "assembled:1"]


def test_the_command_searches_shows_and_writes_a_machine(tmp_path: Path) -> None:
    MACHINE.to_yaml(tmp_path / "start.yaml")
    command = ["design", tmp_path / "front.json", "--machine", tmp_path / "start.yaml", *SEARCH, "--generations", "3"]
    done = run(*command, "--choose", "0", "--out", tmp_path / "chosen.yaml")
    assert done.returncode == 0, done.stderr
    assert "began with" in done.stdout
    heading = next(line for line in done.stdout.splitlines() if line.startswith(" row "))
    assert heading.endswith("payload_low [N]  footprint [m²]  assembled")
    assert "24 machines evaluated" in done.stdout
    content = json.loads(run(*command, "--json").stdout)
    chosen = spm.Manipulator.from_yaml(tmp_path / "chosen.yaml")
    assert content["machines"][0] == chosen.as_data()
    best = max(content["columns"]["payload_low"])
    assert content["columns"]["payload_low"][0] == best
    assert run(*command, "--choose", "99", "--out", tmp_path / "x.yaml").returncode == 2


def test_ctrl_c_at_any_moment_leaves_a_file_from_which_the_search_goes_on(tmp_path: Path) -> None:
    MACHINE.to_yaml(tmp_path / "start.yaml")
    command = ["design", tmp_path / "front.json", "--machine", tmp_path / "start.yaml", *SEARCH]
    with subprocess.Popen([*COMMAND, *command, "--generations", "5000"], stderr=subprocess.PIPE, text=True) as process:
        while not (tmp_path / "front.json").exists() and process.poll() is None:
            time.sleep(0.01)
        time.sleep(np.random.default_rng(0).uniform(0.0, 0.2))
        process.send_signal(signal.SIGINT)
        errors = process.communicate(timeout=300)[1]
    assert (process.returncode, "Traceback" in errors) == (130, False), errors
    assert {path.name for path in tmp_path.iterdir()} == {"start.yaml", "front.json"}
    count = len(json.loads((tmp_path / "front.json").read_text(encoding="utf-8"))["generations"])
    assert 0 < count < 5000
    done = run(*command, "--generations", count + 1)
    assert (done.returncode, f"{8 * (count + 1)} machines evaluated" in done.stdout) == (0, True), done.output


def test_a_task_has_the_margin_and_the_efforts_of_its_states() -> None:
    machine = spm.Manipulator.paper()
    state = spm.forward_physical(machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.45])
    here = state.pose.as_matrix()
    there = here.copy()
    there[2, 3] += 0.03
    load = [10.0, -20.0, -300.0, 1.0, 2.0, 3.0]
    one = Task([here], load)
    assert one.margin(machine) == pytest.approx(0.05, abs=1e-12)
    assert one.effort(machine) == pytest.approx(np.abs(spm.leg_forces(state, load)).max(), rel=1e-9)
    path = PlatformPath([0.0, 2.0], [here, there])
    task, poses = Task(path, load, samples=7), path(np.linspace(0.0, 2.0, 7)).pose
    states = spm.inverse_physical(machine, poses, near=state)
    assert machine.limits is not None
    assert task.margin(machine) == pytest.approx(machine.limits.margin(states.readings).min())
    assert task.effort(machine) == pytest.approx(np.abs(spm.leg_forces(states, load)).max())
    there[0, 3] += 50.0  # where no branch is real
    out_of_reach = Task([here, there])
    assert np.isnan([out_of_reach.margin(machine), out_of_reach.effort(machine)]).all()
    assert len({x.identity for x in (one, task, out_of_reach, Task([here]))}) == 4
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="poses")):
        Task(here)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="wrench")):
        Task([here], np.zeros((2, 6)))


def test_aims_may_be_functions_and_metrics_of_ones_own_and_cranks_are_variables(tmp_path: Path) -> None:
    machine = SERVOS_AND_SCREWS
    here = spm.forward_physical(machine, [0.4, 0.5, 0.6, 0.10, 0.12, 0.14]).pose.as_matrix()
    task, payload = Task([here], [0.0, 0.0, -50.0, 0.0, 0.0, 0.0]), METRICS["payload"](push=20.0)
    problem = DesignProblem(
        machine,
        free={"lower_crank": (0.1, 0.2), "upper_rod": (0.25, 0.35), "upper_minimum": (-0.1, 0.0)},
        aims={"effort": "min", "payload_low": "max"},
        at_least={"margin": -0.1},
        at_most={"arms": 0.49},
        functions={"effort": task.effort, "margin": task.margin, "arms": arms},
        metrics=[payload],
    )
    np.testing.assert_allclose(problem.values(machine), [0.15, 0.30, -0.05])
    changed = problem.machine_of(np.array([0.12, 0.33, -0.02]))
    assert changed.legs.kinds == (RRS(crank=0.12, rod=0.35), PRS(rod=0.33))
    assert changed.limits == spm.LegLimits.stages((-0.5, 1.5), (-0.02, -0.02 + 0.3))
    np.testing.assert_allclose(problem.values(changed), [0.12, 0.33, -0.02])
    assert [problem.unit(name) for name in ("lower_crank", "upper_minimum", "lower_stroke")] == ["m", "m", "rad"]
    search: dict[str, Any] = {"population": 6, "generations": 2, "states": 32}
    front = pareto_front(problem, tmp_path / "front.json", **search)
    columns = front.evaluated.columns
    for name, function in problem.functions.items():
        np.testing.assert_array_equal(columns[name], [function(each) for each in front.evaluated.machines])
    assert (front.designs.columns["arms"] <= 0.49).all()
    again = evaluate_designs(front.evaluated.machines, METRICS["payload"], states=32)
    np.testing.assert_allclose(columns["payload_low"], 20.0 * again.columns["payload_low"], rtol=1e-12)
    other = dataclasses.replace(problem, functions={**problem.functions, "effort": Task([here]).effort})
    with pytest.raises(spm.ArgumentError, match="functions"):
        pareto_front(other, tmp_path / "front.json", **search)
    for free in ({"crank": (0.1, 0.2)}, {"lower_crank": (-0.1, 0.2)}, {"rod": (0.3, 0.4), "upper_rod": (0.3, 0.4)}):
        with pytest.raises(spm.ArgumentError, match="free"):
            dataclasses.replace(problem, free=free)


def arms(machine: spm.Manipulator) -> float:
    kind = machine.legs.kinds[0]
    assert isinstance(kind, RRS)
    return float(np.sum([kind.crank, kind.rod]))
