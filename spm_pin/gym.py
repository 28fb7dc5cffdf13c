"""A Gymnasium environment in MuJoCo: keep a ball on the platform of a stage by its three actuators.

Importing this module registers it, as `gymnasium.make("spm_pin.gym:spm_pin/BallBalancer-v0")` does:
nothing else of the package imports it, or Gymnasium and MuJoCo of the extra `gym`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.description import Ball, actuated_joints, joint_values, mjcf_text
from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.stage_displacement import inverse_physical
from spm_pin.machine import RRS, Configuration, Stage
from spm_pin.support.arguments import FloatArray, check_instance, real_array, real_number, type_and_value
from spm_pin.workspace import height_range

try:
    import gymnasium
    import mujoco
except ImportError as error:
    raise MissingExtraError("gym", str(error.name)) from error

OBSERVATION = ("ball_x", "ball_y", "ball_vx", "ball_vy", "roll", "pitch", "height", "roll_rate", "pitch_rate", "speed")
"""Names of the observation's components: place of the ball on the plate [m], and its velocity against the base [m/s],
both along the platform's x and y; the platform's roll, pitch [rad] and height [m], as in `Configuration`, and
their rates."""

STEPS = 20
"""Number of simulation steps, of 1 ms each, in one step of the environment."""
_TRIES = 256


class BallBalancer(gymnasium.Env[FloatArray, npt.NDArray[np.float32]]):
    """A ball on the platform of a stage, which falls off unless the platform tilts against it.

    An action is the target of the three actuators, -1 for the least reading and 1 for the largest, see `action`; their
    velocity is limited as in the description. The rate is 50 actions per second. An observation has the components of
    `OBSERVATION`: positions and angles have bounds, rates do not. The reward is 1 - (distance from the middle of the
    plate / its radius)², and the episode is terminated where the ball leaves the plate. Made by `gymnasium.make` it is
    truncated after ten seconds.

    `reset` chooses a random tilt, height, and position of the ball within half the plate's radius, at rest. All joint
    values are computed in closed form, so that the loops are closed to rounding. Its `options` may have `readings` (3,)
    and the position of the `ball` (2,) [m] instead. The `info` of reset and step have the `distance` [m], the
    `loop_error`, the largest gap of the loops [m], and `has_fallen`.

    Parameters
    ----------
    stage : Stage, optional
        The machine, nominal or calibrated, with limits; by default a balancer of three servos, 0.12 m high.
    ball : Ball, optional
        The ball and its plate.
    max_tilt : float
        Largest tilt of the platform after a reset [rad].
    render_mode : str, optional
        "rgb_array": `render` returns a picture. Without a screen MuJoCo needs MUJOCO_GL=egl or osmesa in the
        environment before it is imported.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012  # Gymnasium's own form

    def __init__(
        self,
        stage: Stage | None = None,
        *,
        ball: Ball | None = None,
        max_tilt: float = 0.1,
        render_mode: str | None = None,
    ) -> None:
        default = Stage(0.08, 0.09, RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))
        self.stage = default if stage is None else check_instance(stage, Stage, "stage")
        if self.stage.limits is None or not self.stage.limits.are_finite:
            raise ArgumentError("stage", "one whose readings have limits, between which actions are", repr(self.stage))
        self.ball = Ball() if ball is None else check_instance(ball, Ball, "ball")
        expected = "an angle from 0 to 0.5 rad"
        self.max_tilt = real_number(max_tilt, "max_tilt", expected, least=0.0, most=0.5, cause="Given in degrees?")
        if render_mode not in (None, "rgb_array"):
            raise ArgumentError("render_mode", "rgb_array or None", repr(render_mode))
        self.render_mode = render_mode
        self.model = mujoco.MjModel.from_xml_string(mjcf_text(self.stage, ball=self.ball))
        self.data = mujoco.MjData(self.model)
        self._renderer: Any = None
        self._heights = height_range(self.stage)
        if math.isnan(self._heights[0]):
            raise ArgumentError("stage", "one whose platform can be level within its limits", repr(self.stage))
        joints = [self.model.joint(name) for name in actuated_joints(self.stage)]
        velocities = self.model.numeric("velocity_limit").data
        self._steps = self.model.opt.timestep * velocities[[joint.id for joint in joints]]
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,))
        most = self._largest_observation()
        self.observation_space = gymnasium.spaces.Box(-most, most, dtype=np.float64)

    def _largest_observation(self) -> FloatArray:
        """Return the largest magnitudes of an observation's components (10,): infinite for rates."""
        height, longest = self.stage.size, np.abs(self.stage.reading_limits - self.stage.legs.offsets).max()
        bounds = dict.fromkeys(OBSERVATION, math.inf) | {"roll": math.pi, "pitch": 0.5 * math.pi}
        bounds["height"] = height + (longest if self.stage.unit == "m" else 0.0)
        # The episode ends where the ball has left the plate.
        bounds["ball_x"] = bounds["ball_y"] = 2.0 * self.ball.plate(self.stage)[0]
        return np.array(list(bounds.values()))

    def action(self, readings: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Return the action (3,) for commanded readings (3,) [m], for RRS legs [rad]."""
        low, high = self.stage.reading_limits
        own = real_array(readings, "readings", (3,), f"commanded readings of the actuators, in {self.stage.unit}")
        return np.asarray(np.clip((2.0 * own - low - high) / (high - low), -1.0, 1.0), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Assemble the stage in another state and put the ball on it; see the class."""
        super().reset(seed=seed)
        options = options or {}
        if not options.keys() <= {"readings", "ball"}:
            raise ArgumentError("options", "no keys but readings and ball", ", ".join(map(repr, options)))
        state = self._state(options["readings"]) if "readings" in options else self._random_state()
        radius = 0.5 * self.ball.plate(self.stage)[0] * math.sqrt(self.np_random.uniform())
        angle = self.np_random.uniform(-math.pi, math.pi)
        place = radius * np.array([math.cos(angle), math.sin(angle)])
        if "ball" in options:
            place = real_array(options["ball"], "ball", (2,), "x and y on the plate in metres")
            plate = self.ball.plate(self.stage)[0]
            if place.shape != (2,) or math.hypot(*place) > plate:
                expected = f"x and y of a place on the plate, whose radius is {plate:g} m"
                raise ArgumentError("ball", expected, type_and_value(options["ball"]))
        mujoco.mj_resetData(self.model, self.data)
        for name, value in joint_values(state).items():
            self.data.joint(name).qpos[0] = value
        self.data.joint("ball_free").qpos[:3] = self.ball.at_rest(self.stage, state.pose.as_matrix(), place)
        self.data.ctrl[:] = state.readings
        mujoco.mj_forward(self.model, self.data)
        return self._observed()

    def step(self, action: npt.ArrayLike) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Move the actuators towards their commands for 20 ms; see the class."""
        shares = np.clip(real_array(action, "action", (3,), "from -1 to 1"), -1.0, 1.0)
        if shares.shape != (3,):
            raise ArgumentError("action", "shape (3,), a single action", f"shape {shares.shape}")
        low, high = self.model.actuator_ctrlrange.T
        goal = 0.5 * (low + high + shares * (high - low))
        for _ in range(STEPS):
            self.data.ctrl += np.clip(goal - self.data.ctrl, -self._steps, self._steps)
            mujoco.mj_step(self.model, self.data)
        # Values derived from q are those at the beginning of the last step.
        mujoco.mj_forward(self.model, self.data)
        observation, info = self._observed()
        has_fallen = info["has_fallen"]
        reward = 0.0 if has_fallen else 1.0 - (info["distance"] / self.ball.plate(self.stage)[0]) ** 2
        return observation, reward, has_fallen, False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture (480, 640, 3), None without a `render_mode`."""
        if self.render_mode is None:
            return None
        if self._renderer is None:
            try:
                self._renderer = mujoco.Renderer(self.model, 480, 640)
            except Exception as error:  # GLFW, EGL and OSMesa raise different types without a screen
                expected = "a screen, or MUJOCO_GL=egl or osmesa in the environment before MuJoCo is imported"
                raise ArgumentError("render_mode", expected, "'rgb_array' without them", str(error)) from error
        camera = mujoco.MjvCamera()
        camera.lookat[:] = 0.0, 0.0, sum(self._heights) / 2.0
        camera.distance, camera.azimuth, camera.elevation = 2.5 * self.stage.size, 120.0, -20.0
        seen = mujoco.MjvOption()
        seen.sitegroup[:] = 0
        self._renderer.update_scene(self.data, camera, seen)
        return np.asarray(self._renderer.render())

    def close(self) -> None:
        """Free the pictures' memory."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _random_state(self) -> Configuration:
        """Return a state of the middle of the range of heights, within the limits."""
        (low, high), draw = self._heights, self.np_random.uniform
        heights = low + (high - low) * draw(0.25, 0.75, _TRIES)
        azimuths = draw(-math.pi, math.pi, _TRIES)
        states = inverse_physical(self.stage, heights, tilt=draw(0.0, self.max_tilt, _TRIES), azimuth=azimuths)
        good = states.exists & ~np.any(states.limit_excess, axis=-1)
        if not good.any():
            cause = "Give a smaller max_tilt, or wider limits"
            raise ArgumentError(
                "stage", f"a stage that tilts by {self.max_tilt:g} rad", "a stage with less tilt", cause
            )
        return states[int(good.argmax())]

    def _state(self, readings: npt.ArrayLike) -> Configuration:
        state = forward_physical(self.stage, readings)
        if state.shape or not state.exists:
            raise ArgumentError(
                "readings", "three readings at which the stage can be assembled", "other readings", state.missing_reason
            )
        return state

    def _observed(self) -> tuple[FloatArray, dict[str, Any]]:
        """Return the observation, and the `info` of `reset` and `step`."""
        platform, velocity = self.data.body("platform"), np.zeros(6)
        state = Configuration.from_arrays(self.stage, platform.xmat.reshape(3, 3).copy(), platform.xpos.copy())
        place = (self.data.body("ball").xpos - platform.xpos) @ state.rotation
        speed = self.data.joint("ball_free").qvel[:3] @ state.rotation
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self.model, self.data, kind, platform.id, velocity, 0)
        (_, y, z), (dx, dy, dz) = state.normal, np.cross(velocity[:3], state.normal)
        level = math.hypot(y, z)
        rates = (y * dz - z * dy) / level**2, dx / level, velocity[5]
        observation = np.array([*place[:2], *speed[:2], state.roll, state.pitch, state.height, *rates])
        distance, radius = math.hypot(*place[:2]), self.ball.plate(self.stage)[0]
        error = float(np.abs(self.data.efc_pos[: self.data.ne]).max())
        has_fallen = distance > radius or bool(place[2] < 0.0)
        return observation, {"distance": distance, "loop_error": error, "has_fallen": has_fallen}


gymnasium.register("spm_pin/BallBalancer-v0", entry_point=f"{__name__}:BallBalancer", max_episode_steps=500)
