"""Every public callable returns a result for malformed arguments, or raises an `SpmError` that names one."""

from __future__ import annotations

import enum
import functools
import inspect
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest

import spm_pin as spm
from spm_pin.kinematics import stage_displacement


class Foreign:
    """An object whose conversions raise errors of other kinds."""

    def __array__(self, *args: object, **keywords: object) -> np.ndarray:
        raise RuntimeError("no array")

    def __fspath__(self) -> str:
        raise RuntimeError("no path")


NONSENSE: dict[str, Any] = {
    "None": None,
    "a word": "nonsense",
    "bytes": b"bytes",
    "a zero byte": "a\0b",
    "True": True,
    "a negative number": -1,
    "nan": np.nan,
    "a huge float": 1e308,
    "a huge integer": 10**400,
    "a complex number": 1j,
    "an empty list": [],
    "a ragged list": [[1.0], [1.0, 2.0]],
    "words in a list": ["a", "b"],
    "an empty mapping": {},
    "an array of another shape": np.ones((2, 7)),
    "a masked array": np.ma.masked_array([1.0, 2.0], [True, False]),
    "a foreign object": Foreign(),
}

REFUSED = "a word", "nan", "an empty list", "an array of another shape", "a foreign object"
"""Values that hardly any argument may have: for callables of which an accepted call takes long."""

PAPER = spm.Manipulator.paper()
BUILT = PAPER.perturbed(5)
MEASURED = spm.forward_physical(PAPER, np.random.default_rng(0).uniform(1.15, 1.45, (16, 6)))
STATE = spm.forward_physical(PAPER, [1.25, 1.15, 1.40, 1.30, 1.20, 1.40])
STAGE = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11)).perturbed(3)
STAGE_STATE = spm.forward_physical(STAGE, [0.2, 0.4, 0.6])


ROBOTS = Path(__file__).parents[1] / "examples/robots"
URDF = ROBOTS.parents[1] / "urdf/spm.urdf"


@functools.cache
def chain() -> spm.ClosedChain:
    return spm.ClosedChain.from_urdf()


@functools.cache
def q() -> np.ndarray:
    return np.asarray(chain().joint_values(STATE))


@functools.cache
def mounted() -> spm.multibody.MountedChain:
    """Return a chain on a robot without joints: its q is the chain's."""
    return chain().mounted_on(pinocchio.Model(), "universe")


@functools.cache
def tripod() -> spm.loops.ClosedChain:
    return spm.loops.ClosedChain.from_mjcf(spm.description.mjcf_text(STAGE))


@functools.cache
def linkage() -> spm.loops.ClosedChain:
    return spm.loops.ClosedChain.from_mjcf(ROBOTS / "four_bar.xml")


@functools.cache
def closed() -> np.ndarray:
    return linkage().close()


@functools.cache
def boundary() -> Any:
    return spm.workspace.reachable_boundary(PAPER, spacing=0.4)


@functools.cache
def shell() -> Any:
    return spm.crosscheck.workspace_shell(PAPER, resolution=4)


def store() -> str:
    spm.sweeps.run_sweep(PAPER, spm.sweeps.leg_grid(1.2, (1.2, 1.3, 2)), ["branches"], "made.zarr")
    return "made.zarr"


def stage_file() -> str:
    STAGE.to_yaml("stage.yaml")
    return "stage.yaml"


def masses_file() -> Path:
    path = Path("masses.yaml")
    path.write_text("payload: {mass: 1.0}\n", encoding="utf-8")
    return path


def recording_file() -> str:
    """Write a recorded path into the folder of the test."""
    Path("path.csv").write_text("r_b1,r_b2,r_b3,r_c1,r_c2,r_c3\n" + 2 * "1.3,1.3,1.3,1.3,1.3,1.3\n", encoding="utf-8")
    return "path.csv"


def measurements_file() -> str:
    Path("measured.csv").write_text("x,y,z,r_b1,r_b2,r_b3,r_c1,r_c2,r_c3\n0,0,2,1,1,1,1,1,1\n")
    return "measured.csv"


def problem() -> spm.design.DesignProblem:
    return spm.design.DesignProblem(PAPER, {"stroke": (0.1, 0.3)}, {"volume": "max", "footprint": "min"})


PATH = [STATE.pose.as_matrix(), spm.forward_physical(PAPER, [1.3, 1.2, 1.4, 1.3, 1.2, 1.4]).pose.as_matrix()]
"""Two poses that a platform can go between."""

LINE = [[1.20, 1.20, 1.40, 1.25, 1.20, 1.50], [1.40, 1.20, 1.20, 1.20, 1.50, 1.25]]
"""Two sets of leg lengths that the legs can go between."""

EXAMPLES: dict[str, Callable[[], Any]] = {
    **dict.fromkeys(("acceleration", "forces", "leg_rates", "twist", "wrench"), lambda: np.zeros(6)),
    "ChainState.joint_accelerations_of_legs.leg_accelerations": lambda: np.zeros(6),
    **dict.fromkeys(("v", "a", "MountedChain.join_velocities.chain"), lambda: np.zeros(18)),
    "stiffness": lambda: np.eye(6),
    **dict.fromkeys(("lower", "upper"), lambda: (1.1, 1.5)),
    **dict.fromkeys(("first", "second", "pose", "value", "Configuration.pose"), lambda: STATE.pose),
    **dict.fromkeys(("points", "position", "translation", "reachable_position.points"), lambda: STATE.translation),
    **dict.fromkeys(("q", "MountedChain.join.chain"), lambda: q()),
    **dict.fromkeys(("MountedChain.join.other", "MountedChain.join_velocities.other"), lambda: np.zeros(0)),
    **dict.fromkeys(("SolutionSet.nearest.near", "SolutionSet.physical.near", "configuration", "state"), lambda: STATE),
    **{f"{function}.near": lambda: STATE for function in ("forward_physical", "inverse_physical")},
    "nearest_reachable_pose.near": lambda: STATE,
    **dict.fromkeys(
        ("Manipulator.of_stages.lower", "Manipulator.of_stages.upper"), lambda: spm.machine.Stage(0.7, 0.4)
    ),
    **dict.fromkeys(("leg_grid.lower", "leg_grid.upper"), lambda: (1.2, 1.3, 2)),
    "machine": lambda: PAPER,
    "stage": lambda: STAGE,
    "stages.machine": lambda: STAGE,
    "height": lambda: 0.12,
    "arrays.stage_inverse.height": lambda: np.array(0.12),
    "arrays.stage_inverse.normal": lambda: np.array([0.0, 0.0, 1.0]),
    **dict.fromkeys(
        ("stages.forward_displacement.readings", "stages.forward_physical.readings"), lambda: STAGE_STATE.readings
    ),
    "stages.forward_physical.near": lambda: STAGE_STATE,
    "stages.follow.path": lambda: [STAGE_STATE.readings, STAGE_STATE.readings + 0.01],
    **dict.fromkeys(("joint_loads.configuration", "parasitic_jacobian.configuration"), lambda: STAGE_STATE),
    "one_stage.configuration": lambda: STAGE_STATE,
    "one_stage.leg_rates.twist": lambda: np.zeros(3),
    "one_stage.acceleration_polytope.mass": lambda: np.diag([10.0, 1.0, 1.0]),
    "Configuration.pose": lambda: STAGE_STATE.pose,
    "Stage.from_parameters.parameters": lambda: STAGE.parameters,
    "Stage.base_radius": lambda: 0.08,
    "Stage.platform_radius": lambda: 0.09,
    "Stage.to_yaml.path": lambda: "stage.yaml",
    "Stage.from_yaml.path": stage_file,
    **dict.fromkeys(("path", "follow.path", "PlatformPath.poses"), lambda: PATH),
    "branch": lambda: "TT+",
    "chain": lambda: chain(),
    **dict.fromkeys(("force_limits", "rate_limits"), lambda: 900.0),
    "acceleration_polytope.mass": lambda: np.diag([10.0, 10.0, 10.0, 1.0, 1.0, 1.0]),
    "Polytope.within.rows": lambda: np.ones((2, 6)),
    "Polytope.within.limits": lambda: 100.0,
    "Manipulator.check_limits.limits": lambda: spm.LegLimits(1.0, 1.6),
    "Manipulator.from_data.data": lambda: BUILT.as_data(),
    "Stage.check_limits.limits": lambda: spm.LegLimits(0.0, 1.0),
    "Stage.from_data.data": lambda: STAGE.as_data(),
    "Polytope.contains.points": lambda: np.ones(6),
    "sweeps.condition.metric": lambda: "payload",
    "sweeps.condition.least": lambda: 0.5,
    "design.evaluate_designs.machines": lambda: [PAPER],
    "design.pareto_front.problem": problem,
    "design.pareto_front.store": lambda: "front.json",
    "DesignProblem.free": lambda: {"stroke": (0.1, 0.3)},
    "DesignProblem.aims": lambda: {"volume": "max", "footprint": "min"},
    "Polytope.extent.direction": lambda: np.ones(6),
    "matrices": lambda: np.eye(3),
    "description": lambda: "a metric",
    "directory": lambda: "sources",
    "domain": lambda: spm.sweeps.pose_grid(0.0, 0.0, (2.1, 2.2, 2), xyx=[0.1, 0.2, 0.1]),
    "metrics": lambda: ["branches"],
    "store": lambda: "map.zarr",
    **dict.fromkeys(("sweeps.resume_sweep.store", "sweeps.sweep_status.store"), store),
    "unit": lambda: "m",
    "derivatives": lambda: spm.crosscheck.nlp.leg_jacobian(PAPER)(
        STATE.middle_joints.ravel(), STATE.rotation, STATE.translation
    ),
    "readings": lambda: STATE.readings,
    "legs": lambda: 1e7,
    "lengths": lambda: LINE,
    **dict.fromkeys(("count", "design.pareto_front.population"), lambda: 4),
    **dict.fromkeys(
        ("design.evaluate_designs.states", "design.pareto_front.states", "calibration.choose_poses.count"), lambda: 16
    ),
    **dict.fromkeys(("design.pareto_front.generations", "starts", "follow.samples"), lambda: 2),
    **dict.fromkeys(("samples", "time_optimal.grid"), lambda: 20),
    "mass": lambda: 1.0,
    "masses": lambda: spm.description.Masses({"leg_*_rod": {"mass": 2.0}}),
    "mask": lambda: np.ones(8, dtype=bool),
    "maximum": lambda: 1.5,
    "middle_joints": lambda: STATE.middle_joints,
    "minimum": lambda: 1.1,
    "rng": lambda: 0,
    "rotation": lambda: STATE.rotation,
    "spacing": lambda: 0.4,
    "start": lambda: LINE[0],
    "goal": lambda: LINE[1],
    "times": lambda: [0.0, 1.0],
    "tries": lambda: 1,
    "x": lambda: (0.0, 0.1, 2),
    "y": lambda: 0.0,
    "z": lambda: 2.2,
    "xyx": lambda: (0.1, 0.2, 0.1),
    "largest_certified_limits.boxes": lambda: 3000,
    "largest_certified_limits.tolerance": lambda: 0.2,
    **{f"Legs.{name}": functools.partial(getattr, BUILT.legs, name) for name in ("axes", "pivots", "balls", "offsets")},
    "Manipulator.from_parameters.parameters": lambda: BUILT.parameters,
    "Manipulator.to_yaml.path": lambda: "machine.yaml",
    "calibration.choose_poses.candidates": lambda: 40,
    **dict.fromkeys(("Inclinations.roll", "Inclinations.pitch", "Inclinations.height"), lambda: [0.1, 0.2]),
    "calibration.identify.readings": lambda: MEASURED.readings,
    "calibration.identify.poses": lambda: MEASURED.pose,
    "calibration.read_measurements.path": measurements_file,
    "display.read_recording.path": recording_file,
    "calibration.tolerance.states": lambda: 3,
    "calibration.tolerance.tolerances": lambda: {"ball": 1e-4},
    "ClosedChain.from_urdf.path": lambda: None,
    **dict.fromkeys(("loops.ClosedChain.from_mjcf.source", "loops.read_mjcf.source"), lambda: ROBOTS / "four_bar.xml"),
    **dict.fromkeys(("loops.ClosedChain.from_urdf.source", "loops.read_urdf.source"), lambda: URDF),
    **dict.fromkeys(("loops.ClosedChain.from_sdf.source", "loops.read_sdf.source"), lambda: URDF.with_suffix(".sdf")),
    **{f"loops.{name}.chain": lambda: linkage() for name in ("mjcf_text", "sdf_text", "urdf_texts")},
    "read_stage.chain": lambda: tripod(),
    "MeasuredStage.values.readings": lambda: [0.1, 0.2, 0.3],
    "MeasuredStage.readings.values": lambda: [0.1, 0.2, 0.3],
    "loops.ClosedChain.from_description.description": lambda: spm.loops.read_mjcf(ROBOTS / "four_bar.xml"),
    **{f"loops.ClosedChain.{name}": lambda: closed() for name in ("state.q", "mobility.q", "forward.near")},
    "loops.ClosedChain.state.v": lambda: np.zeros(3),
    "loops.ClosedChain.forward.values": lambda: [0.1],
    "loops.ClosedChain.joint_of_velocity.index": lambda: 0,
    "Manipulator.base_radius": lambda: 0.7,
    "Manipulator.legs": lambda: (spm.RPS(), spm.RRS(crank=0.5, rod=0.5)),
    "Stage.legs": spm.RPS,
    "follow.start": lambda: STATE,
    "casadi.forward_physical.near": lambda: True,
    "Manipulator.platform_radius": lambda: 0.3,
    "Manipulator.middle_side": lambda: 0.8,
    "Masses.from_yaml.path": masses_file,
    "Manipulator.from_yaml.path": lambda: Path(__file__).parents[1] / "urdf" / "config" / "geometry.yaml",
    "SolutionSet.from_unordered.middle_joints": lambda: STATE.middle_joints[None],
    "sweeps.pose_sample.x": lambda: (0.0, 0.1),
    "tilt_grid.height": lambda: (0.1, 0.12, 2),
    "tilt_sample.height": lambda: (0.1, 0.12),
    **{f"{name}.{angle}": lambda: 0.1 for name in ("tilt_grid", "tilt_sample") for angle in ("tilt", "azimuth")},
    "display.path_figure.path": lambda: spm.follow(PAPER, PATH, STATE, samples=2),
    "time_optimal.path": lambda: spm.motion.LegPath(LINE),
    "time_optimal.leg_rates": lambda: 1.0,
    "time_optimal.twist": lambda: (1.0, 2.0),
    "time_optimal.leg_accelerations": lambda: 5.0,
    "time_optimal.period": lambda: 0.05,
}
"""A good value for each parameter that has no default, or whose default takes long; by name or by place and name."""

INPUTS = (
    "Configuration DesignProblem JointLimits LegLimits LegPath Legs Manipulator Masses Payload PlatformPath RigidBody"
)
INPUTS += " Ball Inclinations Stage Configuration LegLimits"
"""Classes that users make themselves; the others are results, made by the package."""

OTHER_WORDS = {
    "value": "pose",
    "actuated": "actuators",
    "lower": "r_",
    "upper": "r_",
    "pose_noise": "the noise",
    "reading_noise": "the noise",
}
"""Words by which an error may name an argument, other than its name."""

FILES = ("path", "source", "srdf")
"""Arguments that are files, which an error may name instead."""

SMALL = ("samples", "spacing", "starts", "rng", "tries", "xyx")
"""Parameters that are given although they have a default; those with an example of their own place are, too."""

LEFT_OUT = ("near", "v", "legs", "leg_rates", "start", "twist")
"""Parameters that are nevertheless left out in one of two calls."""

TILTS = ("height", "tilt", "azimuth", "roll", "pitch", "normal")
ALTERNATIVES = ("pose.rotation", "nearest_reachable_pose.branch", "stages.follow.start")
ALTERNATIVES += tuple(f"{place}.{name}" for place in ("follow", "stages.follow") for name in TILTS)
"""Parameters that other arguments exclude."""

INSTANCES: dict[str, Callable[[], Any]] = {
    "Boundary": boundary,
    "ChainState": lambda: chain().state(q()),
    "ClosedChain": chain,
    "loops.ClosedChain": linkage,
    "Manipulator": lambda: PAPER,
    "JointLimits": lambda: spm.workspace.JointLimits(hip=(-1.0, 1.0)),
    "LegLimits": lambda: spm.LegLimits(1.1, 1.5),
    "Masses": lambda: spm.description.Masses({"leg_*_rod": {"mass": 2.0}}),
    "MeasuredStage": lambda: spm.multibody.read_stage(tripod()),
    "MountedChain": mounted,
    "Polytope": lambda: spm.capability.wrench_polytope(STATE, 900.0),
    "Shell": shell,
    "Stage": lambda: STAGE,
    "SolutionSet": lambda: spm.inverse_displacement(PAPER, STATE.pose),
}
"""Objects whose methods are called."""

UNCHECKED = (
    "SolutionSet.pick",  # for solvers, documented to check nothing
    *("ClosedChain.simulate", "ClosedChain.joint_trajectory"),  # have tests of their own; a call takes long
    *("ClosedChain.mounted_on", "ClosedChain.carrying"),
    *("loops.ClosedChain.simulate", "loops.ClosedChain.inverse"),  # those of a four-bar are in tests/loops
    *("make_methods", "compare_methods", "compare_in_batches"),
    # A picture takes a second; tests of pictures have wrong arguments.
    *(f"display.{name}" for name in spm.display.__all__ if name not in ("path_figure", "read_recording")),
)
"""Callables left out."""

SKIPPED_PARAMETERS = ("progress", "argument", "state", "scheduler")
"""Callbacks of the user's own, names for messages, memory handed back, and addresses in a network."""


EITHER = (
    *(spm.inverse_jacobian, spm.leg_forces, spm.leg_rates, spm.singularities, spm.stiffness),
    *(spm.kinematics.compliance, spm.kinematics.platform_jacobian, spm.kinematics.principal_stiffness),
    *(spm.capability.acceleration_polytope, spm.capability.joint_reactions),
    *(spm.capability.velocity_polytope, spm.capability.wrench_polytope),
    spm.workspace.leg_clearance,
)
"""Functions that take a stage as well as a manipulator, and are called with both."""

OF_STAGES = (spm.forward_displacement, spm.forward_physical, spm.follow)
OF_STAGES += (stage_displacement.inverse, stage_displacement.inverse_physical)
"""What functions of either machine call for a stage, with its arguments."""


def callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield every public function, constructor of an input, and method of an instance, with its name."""
    seen: set[int] = set()
    modules = [("", spm), ("nlp", spm.crosscheck.nlp), *inspect.getmembers(spm, inspect.ismodule)]
    for name, module in modules:
        for public in module.__all__:
            member = getattr(module, public)
            if inspect.isfunction(member) and id(member) not in seen:
                plain = name in ("", "machine", "kinematics", "motion", "workspace")
                yield public if plain else f"{name}.{public}", member
            elif inspect.isclass(member) and id(member) not in seen and not issubclass(member, enum.Enum):
                if public in INPUTS.split():
                    yield public, member
                owner = f"loops.{public}" if name == "loops" else public
                if owner in INSTANCES:
                    for method in sorted({name for base in member.__mro__[:-1] for name in vars(base)}):
                        if not method.startswith("_") and callable(getattr(member, method)):
                            yield f"{owner}.{method}", getattr(member, method)
            seen.add(id(member))
    yield from ((f"one_stage.{function.__name__}", function) for function in EITHER)
    yield from ((f"stages.{function.__name__}", function) for function in OF_STAGES)


def parameters(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    found = inspect.signature(function).parameters
    return {name: p for name, p in found.items() if name != "self" and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}


def find_example(place: str, parameter: str) -> Callable[[], Any] | None:
    """Return what makes a good value for a parameter."""
    short = place.rsplit(".", 1)[-1]
    module = place.removesuffix(f".{short}")
    for key in (f"{place}.{parameter}", f"{module}.{parameter}", f"{short}.{parameter}", parameter):
        if key in EXAMPLES:
            return EXAMPLES[key]
    return None


CASES = [
    (place, function, name)
    for place, function in callables()
    for name in parameters(function)
    if not {place, place.rsplit(".", 1)[-1]} & set(UNCHECKED) and name not in SKIPPED_PARAMETERS
]


SLOW = ("Boundary", "Shell", "largest_certified_limits", "orientation_workspace", "reachable_boundary")
SLOW += (
    "best_height",
    "reach",
    "reachable_position",
    "reachable_volume",
    "sample_reachable",
    "crosscheck.workspace_shell",
)
SLOW += (
    "description.mjcf_text",
    "description.sdf_text",
    "export.linuxcnc_configuration",
    "export.write_linuxcnc",
    "export.ros_package",
    "calibration.identify",
    "export.c_sources",
    "export.write_c",
    "export.write_ros",
)
"""Callables, and classes, of which an accepted call takes long."""


def is_slow(place: str) -> bool:
    return place in SLOW or place.split(".")[0] in SLOW


def marked(place: str, function: Callable[..., Any], name: str) -> Any:
    marks = pytest.mark.slow if is_slow(place) else ()
    return pytest.param(place, function, name, id=f"{place}-{name}", marks=marks)


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise `TimeoutError` in a call that computes for longer, whatever else the machine does."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"no answer within {seconds:g} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def call(place: str, function: Callable[..., Any], changed: str, value: Any, *, complete: bool) -> None:
    """Call a function with one argument changed, and with the optional ones that have an example if `complete`."""
    chosen: dict[str, Any] = {}
    for name, parameter in parameters(function).items():
        find, own = find_example(place, name), f"{place}.{name}"
        needed = parameter.default is parameter.empty or name in SMALL or (own in EXAMPLES and name not in LEFT_OUT)
        if name == changed:
            chosen[name] = value
        elif needed or (complete and find and own not in ALTERNATIVES):
            assert find, f"add a good value for {own} to EXAMPLES"
            chosen[name] = find()
    owner = place.rpartition(".")[0]
    if owner in INSTANCES and "self" in inspect.signature(function).parameters:
        function(INSTANCES[owner](), **chosen)
    else:
        function(**chosen)


@pytest.mark.filterwarnings("ignore:.*another unit")
@pytest.mark.parametrize(("place", "function", "name"), [marked(*case) for case in CASES])
def test_malformed_arguments_give_a_result_or_an_error_that_names_them(
    place: str, function: Callable[..., Any], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    wrong = []
    kinds = REFUSED if is_slow(place) else NONSENSE
    values = [(kind, NONSENSE[kind], True) for kind in kinds] + [("None alone", None, False)]
    for kind, value, complete in values:
        try:
            with within(60.0):
                call(place, function, name, value, complete=complete)
        except spm.SpmError as error:
            # A file, and what as_rigid_transform is told.
            named = OTHER_WORDS.get(name, str(value)[:400] if name in FILES else name)
            if name not in str(error) and named not in str(error):
                wrong.append(f"{kind}: {type(error).__name__} does not name {name}: {str(error)[:200]}")
        except Exception as error:
            wrong.append(f"{kind}: {type(error).__name__}: {str(error)[:200]}")
    spm.set_threads(None)
    assert not wrong, "\n".join(wrong)


def test_the_examples_are_accepted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for place, function in {place: function for place, function, _ in CASES}.items():
        if not is_slow(place):
            call(place, function, "", None, complete=True)
    spm.set_threads(None)
