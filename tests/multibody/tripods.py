"""Tripods as builders describe them in MJCF: frames of bodies, axes, senses, zeros and the base are arbitrary."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

Array = npt.NDArray[np.float64]


def _list(numbers: Any) -> str:
    return " ".join(repr(float(x)) for x in np.atleast_1d(numbers))


@dataclass
class Body:
    """A body at a pose in the base, with joints that are given in the base too."""

    name: str
    pose: RigidTransform
    joints: list[str] = field(default_factory=list)
    bodies: list[Body] = field(default_factory=list)

    def joint(self, name: str, kind: str, axis: Array, point: Array, ref: float = 0.0, limits: str = "") -> None:
        """Add a joint whose value is `ref` where the body is in the file."""
        at, along = self.pose.inv().apply(point), self.pose.rotation.inv().apply(axis)
        more = f' range="{limits}" limited="true"' if limits else ""
        ref_text = "" if kind == "ball" else f' ref="{ref!r}"'
        self.joints.append(
            f'<joint name="{name}" type="{kind}" axis="{_list(along)}" pos="{_list(at)}"{ref_text}{more}/>'
        )

    def text(self, parent: RigidTransform) -> str:
        """Return the body as XML."""
        own = parent.inv() * self.pose
        quat = np.roll(own.rotation.as_quat(), 1)
        mass = 2.0 if self.name == "plate" else 0.1
        inside = f'{"".join(self.joints)}<inertial pos="0 0 0" mass="{mass}" diaginertia=".01 .01 .01"/>'
        inside += "".join(body.text(self.pose) for body in self.bodies)
        return f'<body name="{self.name}" pos="{_list(own.translation)}" quat="{_list(quat)}">{inside}</body>'


@dataclass(frozen=True)
class Tripod:
    """A tripod in MJCF whose level home is known."""

    kind: str
    base_radius: float
    platform_radius: float
    height: float
    """Of the level plate in the file, above the pivots."""
    numbers: dict[str, float] = field(default_factory=dict)
    azimuths: tuple[float, ...] = (-30.0, 90.0, 210.0)
    """Of the legs in the order of the file, in degrees."""
    closure: str = "connect"
    """"connect" with a free plate, "ball" with the plate on leg 1 in the tree, or "weld" of balls to it."""
    base: RigidTransform = field(default_factory=RigidTransform.identity)
    seed: int = 0
    zeros: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Values of the actuated joints where the file has them."""
    senses: tuple[float, ...] = (1.0, 1.0, 1.0)
    """Of the actuated joints."""
    limits: tuple[float, float] | None = None
    """Of the actuated joints, relative to their values in the file."""

    def knee(self) -> tuple[float, float]:
        """Return the centre of the balls' circles, outwards and up from the pivot, in the file's home."""
        x, z, n = self.platform_radius - self.base_radius, self.height, self.numbers
        if self.kind == "RPS":
            return 0.0, 0.0
        if self.kind == "PRS":
            # The slide stands on the pivot with its direction; the carriage is behind or ahead of the ball.
            c, s = np.cos(n["direction"]), np.sin(n["direction"])
            across = c * z - s * x
            along = c * x + s * z + n["sign"] * np.sqrt(n["rod"] ** 2 - across**2)
            return along * c, along * s
        crank, rod, distance = n["crank"], n["rod"], np.hypot(x, z)
        bend = np.arccos((distance**2 + crank**2 - rod**2) / (2.0 * distance * crank))
        angle = np.arctan2(z, x) + n["sign"] * bend
        return crank * np.cos(angle), crank * np.sin(angle)

    def text(self, change: str = "") -> str:
        """Return the file, perhaps with an error for tests: see the words in this function."""
        rng = np.random.default_rng(self.seed)
        world = self.base

        def pose() -> RigidTransform:
            return RigidTransform.from_components(rng.normal(size=3) * 0.2, Rotation.random(random_state=rng))

        plate = Body("plate", pose())
        legs, ties, motors, names = [], [], [], "abcd"
        azimuths = self.azimuths if change != "four legs" else (*self.azimuths, self.azimuths[0] + 50.0)
        for k, azimuth in enumerate(np.radians(azimuths)):
            name, j = names[k], k % 3
            out, tangent = (
                np.array([np.cos(azimuth), np.sin(azimuth), 0.0]),
                np.array([-np.sin(azimuth), np.cos(azimuth), 0.0]),
            )
            up, sense = np.array([0.0, 0.0, 1.0]), self.senses[j]
            x, z = self.knee()
            pivot, ball = self.base_radius * out, self.platform_radius * out + self.height * up
            knee = pivot + x * out + z * up
            # Each axis has any sense, and its joint is anywhere along it.
            axes = tangent[None] * rng.choice([-1.0, 1.0], size=(2, 1))
            places = np.array([pivot, knee]) + tangent * rng.uniform(-0.1, 0.1, size=(2, 1))
            if change == "upright":
                axes, tangent = np.array([up, up]), up
            if change == "skew knee":
                axes[1] = axes[1] + 0.01 * up
            limits = "" if self.limits is None else _list(self.zeros[j] + np.array(self.limits))
            first, second = Body(f"{name}_first", pose()), Body(f"{name}_second", pose())
            if self.kind == "RPS":
                along = (ball - pivot) / np.linalg.norm(ball - pivot)
                if change == "skew slide":
                    along = along + 0.01 * tangent
                if change == "bent slide":
                    along = along + 0.01 * up
                first.joint(f"{name}_hinge", "hinge", axes[0], places[0])
                second.joint(f"{name}_motor", "slide", sense * along, rng.normal(size=3), self.zeros[j], limits)
            elif self.kind == "PRS":
                direction = self.numbers["direction"]
                slide = np.cos(direction) * out + np.sin(direction) * up
                first.joint(f"{name}_motor", "slide", sense * slide, rng.normal(size=3), self.zeros[j], limits)
                second.joint(f"{name}_knee", "hinge", axes[1], places[1])
            else:
                # About -tangent an angle from outwards to up is positive.
                first.joint(f"{name}_motor", "hinge", -sense * tangent, places[0], self.zeros[j], limits)
                second.joint(f"{name}_knee", "hinge", axes[1], places[1])
            first.bodies.append(second)
            legs.append(first)
            if self.closure == "weld":
                tip = Body(f"{name}_tip", pose())
                tip.joint(f"{name}_ball", "ball", up, ball)
                second.bodies.append(tip)
                ties.append(f'<weld body1="plate" body2="{name}_tip"/>')
            elif self.closure == "ball" and k == 0:
                plate.joint("plate_ball", "ball", up, ball)
                second.bodies.append(plate)
            else:
                ties.append(
                    f'<connect body1="{name}_second" body2="plate" anchor="{_list(second.pose.inv().apply(ball))}"/>'
                )
            if not (change == "motors missing" and k):
                driven = f"{name}_knee" if change == "driven knees" else f"{name}_motor"
                motors.append(f'<motor joint="{driven}"/>')
        if change == "coupled":
            ties.append('<joint joint1="a_motor" joint2="b_motor"/>')
        if self.closure != "ball":
            plate.joints.append('<freejoint name="plate_free"/>')
        base = Body("base", RigidTransform.identity(), bodies=legs)
        if change == "floating":
            base.joints.append('<freejoint name="floating"/>')
        # MuJoCo has free joints in the world only; the base of the file is fixed there and at any place.
        bodies = base.text(world.inv())
        if self.closure != "ball":
            bodies += plate.text(world.inv())
        on_top = '<body name="on_top" pos="0 0 3"><freejoint/><geom size=".02"/></body>'
        return (
            f'<mujoco><compiler angle="radian"/><worldbody>{bodies}{on_top}</worldbody>'
            f"<equality>{''.join(ties)}</equality><actuator>{''.join(motors)}</actuator></mujoco>"
        )
