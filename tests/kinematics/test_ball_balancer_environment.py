"""The Gymnasium environment of a ball on a stage: exact resets, its rules, and a controller that balances."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from error_fields import with_fields

import spm_pin as spm
from spm_pin.description import Ball
from spm_pin.errors import ArgumentError
from spm_pin.machine import home_readings

gymnasium = pytest.importorskip("gymnasium")
mujoco = pytest.importorskip("mujoco")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from spm_pin.gym import OBSERVATION, BallBalancer  # noqa: E402

NAME = "spm_pin.gym:spm_pin/BallBalancer-v0"
STAGES = {
    "servos": None,
    "servos as built": spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), (-0.6, 1.2)).perturbed(3, length=1e-3),
    "cylinders": spm.Stage(0.10, 0.09, spm.RPS(), limits=(0.10, 0.20)),
    "screws": spm.Stage(0.12, 0.08, spm.PRS(rod=0.15), limits=(-0.03, 0.08)),
}


@pytest.fixture(scope="module")
def balancer() -> BallBalancer:
    return BallBalancer()


@pytest.fixture(scope="module", params=STAGES)
def each(request: pytest.FixtureRequest) -> BallBalancer:
    return BallBalancer(STAGES[request.param])


def named(observation: np.ndarray) -> dict[str, float]:
    return dict(zip(OBSERVATION, observation.tolist(), strict=True))


@pytest.mark.filterwarnings("ignore:.*A Box observation space m[a-z]*imum value is -?infinity")
def test_gymnasium_has_nothing_to_say_against_it() -> None:
    check_env(gymnasium.make(NAME).unwrapped, skip_render_check=True)


def test_observations_of_whole_episodes_are_in_their_space(each: BallBalancer) -> None:
    balancer, rng = each, np.random.default_rng(0)
    most = named(balancer.observation_space.high)
    assert {key for key, value in most.items() if np.isinf(value)} == {
        "ball_vx", "ball_vy", "roll_rate", "pitch_rate", "speed"
    }  # fmt: skip
    assert (most["roll"], most["pitch"]) == (np.pi, np.pi / 2.0)
    _, highest = spm.workspace.height_range(balancer.stage)
    assert highest < most["height"] < 3.0 * highest
    for seed in range(2):
        observation, _ = balancer.reset(seed=seed)
        has_fallen, aside = False, rng.uniform(-1.0, 1.0, 3)
        while not has_fallen:
            assert observation in balancer.observation_space
            observation, _, has_fallen, _, _ = balancer.step(np.clip(aside + rng.normal(size=3), -1.0, 1.0))
        assert observation in balancer.observation_space


def test_a_reset_is_a_closed_state_of_the_stage_with_the_ball_on_its_plate(each: BallBalancer) -> None:
    balancer, stage = each, each.stage
    joints = spm.description.actuated_joints(stage)
    zeros = home_readings(stage) + stage.legs.offsets
    low, high = balancer.stage.reading_limits
    places, tilts = [], []
    for seed in range(12):
        observation, info = balancer.reset(seed=seed)
        assert info["loop_error"] < 1e-9
        seen = named(observation)
        readings = np.array([balancer.data.joint(joint).qpos[0] for joint in joints]) + zeros
        assert ((low <= readings) & (readings <= high)).all()
        # The closed form of what the actuators read, against MuJoCo's own positions of the bodies.
        state = spm.forward_physical(stage, readings)
        np.testing.assert_allclose(
            [seen["roll"], seen["pitch"], seen["height"]], [state.roll, state.pitch, state.height], atol=1e-12
        )
        np.testing.assert_allclose(balancer.data.body("platform").xpos, state.translation, atol=1e-12)
        # The ball touches the plate.
        above = (balancer.data.body("ball").xpos - state.translation) @ state.normal
        assert above == pytest.approx(0.2 * stage.platform_radius + 0.02, abs=1e-12)
        places.append([seen["ball_x"], seen["ball_y"]])
        tilts.append(float(state.tilt))
        np.testing.assert_array_equal(observation[[2, 3, 7, 8, 9]], 0.0)
    assert np.linalg.norm(places, axis=-1).max() <= 0.75 * stage.platform_radius
    assert np.std(places, axis=0).min() > 0.1 * stage.platform_radius
    assert 0.03 < max(tilts) <= 0.1


def test_a_seed_makes_an_episode_and_options_choose_its_start(balancer: BallBalancer) -> None:
    action = np.array([0.3, -0.2, 0.1], dtype=np.float32)
    first, second = [[balancer.reset(seed=5)[0], *(balancer.step(action)[0] for _ in range(5))] for _ in range(2)]
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(balancer.reset()[0], first[0])
    observation, _ = balancer.reset(options={"readings": [0.2, 0.4, 0.6], "ball": [0.03, -0.02]})
    np.testing.assert_allclose(observation[:2], [0.03, -0.02], atol=1e-15)
    state = spm.forward_physical(balancer.stage, [0.2, 0.4, 0.6])
    np.testing.assert_allclose(observation[4:7], [state.roll, state.pitch, state.height], atol=1e-12)


def test_an_action_leads_the_servos_to_readings_and_no_faster_than_they_turn(balancer: BallBalancer) -> None:
    wanted = np.array([0.1, 0.5, 0.9])
    start = spm.inverse_physical(balancer.stage, 0.12).readings
    balancer.reset(options={"readings": start, "ball": [0.0, 0.0]})
    for k in range(1, 30):
        observation, *_ = balancer.step(balancer.action(wanted))
        way = np.minimum(6.0 * 0.02 * k, np.abs(wanted - start)) * np.sign(wanted - start)
        np.testing.assert_allclose(balancer.data.ctrl, start + way, atol=1e-6)
    state = spm.forward_physical(balancer.stage, wanted)
    # The servos give way by a quarter of a millimetre.
    np.testing.assert_allclose(observation[4:6], [state.roll, state.pitch], atol=2e-3)
    assert observation[6] == pytest.approx(state.height, abs=5e-4)
    low, high = balancer.stage.reading_limits
    np.testing.assert_allclose(np.stack([low, high]), [[-0.6] * 3, [1.2] * 3], atol=1e-12)
    np.testing.assert_allclose([balancer.action(low), balancer.action(high)], [[-1.0] * 3, [1.0] * 3], atol=1e-6)


def test_rates_are_those_of_what_is_observed(balancer: BallBalancer) -> None:
    """By differences over one step of the simulation, whose positions change by the velocities after it."""
    balancer.reset(seed=2)
    for _ in range(4):
        balancer.step([0.8, -0.5, 0.2])
    rows = []
    for _ in range(2):
        mujoco.mj_step(balancer.model, balancer.data)
        mujoco.mj_forward(balancer.model, balancer.data)
        frame = balancer.data.body("platform").xmat.reshape(3, 3).copy()
        rows.append((balancer._observed()[0], balancer.data.body("ball").xpos.copy(), frame))
    (before, was, _), (here, now, frame) = rows
    np.testing.assert_allclose(here[7:], (here - before)[4:7] / 1e-3, atol=5e-3 * np.abs(here[7:]).max())
    np.testing.assert_allclose(here[2:4], (frame.T @ (now - was))[:2] / 1e-3, atol=1e-9)


def test_an_episode_ends_where_the_ball_falls_and_after_ten_seconds() -> None:
    env = gymnasium.make(NAME, max_tilt=0.0)
    low, high = env.unwrapped.stage.reading_limits
    tipped = env.unwrapped.action([low[0], high[1], high[2]])
    env.reset(seed=0)
    rewards = []
    for _ in range(200):
        _, reward, terminated, truncated, info = env.step(tipped)
        rewards.append(reward)
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["has_fallen"]
    assert rewards[-1] == 0.0
    assert 0.7 < rewards[0] <= 1.0
    assert env.spec.max_episode_steps == 500


def lean(balancer: BallBalancer, observation: np.ndarray) -> Any:
    """A controller of proportional and derivative terms, as in the example."""
    slope = -3.0 * observation[:2] - observation[2:4]
    slope *= min(1.0, 0.2 / max(np.linalg.norm(slope), 1e-9))
    normal = [*slope, np.sqrt(1.0 - slope @ slope)]
    height = sum(spm.workspace.height_range(balancer.stage)) / 2.0
    return balancer.action(spm.inverse_physical(balancer.stage, height, normal=normal).readings)


@pytest.mark.parametrize("name", ["servos", "cylinders"])
def test_a_controller_balances_the_ball(name: str) -> None:
    balancer = BallBalancer(STAGES[name])
    for seed in range(2):
        observation, info = balancer.reset(seed=seed)
        errors = []
        for _ in range(150):
            observation, reward, terminated, _, info = balancer.step(lean(balancer, observation))
            errors.append(info["loop_error"])
            assert not terminated
        assert info["distance"] < 1e-3
        assert reward > 0.9999
        assert max(errors) < 3e-4


def test_another_ball() -> None:
    heavy = BallBalancer(ball=Ball(radius=0.03, mass=0.5, plate_radius=0.2))
    heavy.reset(seed=1)
    assert heavy.model.geom("platform_plate").size[0] == 0.2


APART = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), ((0.0, 0.0, 0.8), (0.1, 0.1, 0.9)))
WRONG: list[tuple[str, Callable[[BallBalancer], Any]]] = [
    *(("stage", lambda _, stage=stage: BallBalancer(stage)) for stage in ("stage.yaml", spm.Stage(0.10, 0.09), APART)),
    ("max_tilt", lambda _: BallBalancer(max_tilt=10.0)),
    ("render_mode", lambda _: BallBalancer(render_mode="human")),
    *(("action", lambda b, x=x: b.step(x)) for x in ([0.0, np.nan, 0.0], [0.0, 0.0], np.zeros((1, 3)))),
    ("readings", lambda b: b.action([0.0, 0.0])),
    ("readings", lambda b: b.reset(options={"readings": [-0.6, 1.2, 9.0]})),
    *(("ball", lambda b, x=x: b.reset(options={"ball": x})) for x in ("middle", [0.2, 0.0], [[0.0, 0.0]])),
    ("options", lambda b: b.reset(options={"reading": [0.1] * 3})),
]


def test_arguments_that_are_wrong_are_named(balancer: BallBalancer) -> None:
    balancer.reset(seed=0)
    for argument, call in WRONG:
        with pytest.raises(ArgumentError, check=with_fields(argument=argument)):
            call(balancer)


def test_it_is_copied_by_its_specification_and_pictures_need_a_mode(balancer: BallBalancer) -> None:
    env = gymnasium.make(copy.deepcopy(gymnasium.make(NAME, stage=STAGES["cylinders"]).spec))
    assert env.unwrapped.stage == STAGES["cylinders"]
    assert balancer.render() is None


RENDER = """
import gymnasium
from gymnasium.utils.env_checker import check_env
from spm_pin.gym import BallBalancer
balancer = BallBalancer(render_mode="rgb_array")
balancer.reset(seed=0)
picture = balancer.render()
balancer.close()
assert picture.shape == (480, 640, 3)
orange = (picture[..., 0] > 150) & (picture[..., 2] < 60)
print(orange.sum())
check_env(gymnasium.make("spm_pin/BallBalancer-v0", render_mode="rgb_array").unwrapped)
"""


def test_a_missing_screen_is_an_error_that_says_what_to_set() -> None:
    caught = "try:\n    balancer.render()\nexcept ValueError as error:\n    exit(str(error))"
    code = RENDER.replace("picture = balancer.render()", caught)
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment["MUJOCO_GL"] = "glfw"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert "render_mode: expected a screen, or MUJOCO_GL=egl or osmesa" in done.stderr.splitlines()[-1]


def test_a_picture_shows_the_ball() -> None:
    """In a process of its own: what draws is chosen when MuJoCo is imported."""
    for library in ("egl", "osmesa"):
        environment = {**os.environ, "MUJOCO_GL": library}
        done = subprocess.run(
            [sys.executable, "-c", RENDER], env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode == 0:
            assert int(done.stdout) > 200
            return
    pytest.skip("MuJoCo draws neither by EGL nor by OSMesa here (Debian: libegl1 or libosmesa6)")
