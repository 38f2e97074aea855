"""Bring a spoon to the mouth without spilling: level on the way, tilted and slow at the end.

Paper: task "Feeding"; reward components r_te, r_o, r_v and r_f. The spoon's up is −x of the tool
frame, its tip is +z.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco

from assistax.filters import low_pass
from assistax.pytree import pytree
from assistax.scenes import MEAL_VIEW, NECK, SceneConfig, geometry, limited
from assistax.scenes.geometry import norm
from assistax.tasks.base import Sensors, tool_force, tool_velocity
from assistax.tasks.registry import TaskSpec
from assistax.tasks.rewards import UP, approach, boltzmann, envelope, orientation

GRAVITY = 9.81  # m/s²


@dataclass(frozen=True)
class FeedingConfig:
    """The numbers in which versions differ; the defaults are version 0's."""

    reach_scale: float = 2.0  # of the reach term
    reach_of_bowl: bool = False  # whether that is of the part of the bowl that is nearest, or of the tool point
    speed: float = 0.20  # m/s, v*_app far from the mouth
    force: float = 1.0  # N, f* of the contact term
    pay_help_only: bool = False  # whether the contact term pays only while the person can eat, or anywhere
    aim_inward: bool = False  # whether the tip is to point along the mouth's axis, or at its middle
    most_tilt: float = pi  # rad, of the wanted up side from upright
    # What counts as feeding, and for how long in all it must last to be a success.
    mouth_distance: float = 0.03  # m, from the bowl, between its middle (the tool point) and its tip
    bowl: float = 0.036  # m, from middle to tip: as near as the middle gets to a face from the front
    mouth_width: float = 1e3  # m, from the bowl to the middle of the mouth, to either side of the face
    mouth_height: float = 1e3  # m, the same up or down the face
    mouth_angle: float = pi  # rad: bowl from straight ahead, its tip from straight in, its upper side from up
    mouth_speed: float = 1e3  # m/s, at most
    mouth_force: float = 0.0  # N, on the face, at least
    success_seconds: float = 0.5  # s, in all
    # The arm starts with the spoon level. The food is lost when it tips too far while still away from the mouth.
    spill_angle: float = 0.7854  # rad from upright
    spill_distance: float = 0.1  # m, from the mouth; nearer than this only spill_anywhere counts
    spill_seconds: float = 0.0  # s, for so long in all; 0: at once
    spill_anywhere: float = pi  # rad, from upright, at once, also at the mouth
    # The food feels gravity less the bowl's acceleration, low-pass filtered over so long; 0: gravity alone.
    filter_seconds: float = 0.0  # s
    spill_when_fed: bool = True  # whether it can be lost after it was eaten


@pytree
class FeedingState:
    """What an episode has come to, beside the physics."""

    spilled: jax.Array  # bool
    mouth_seconds: jax.Array  # at the mouth, with the food
    tipped_seconds: jax.Array  # tipped too far on the way
    velocity: jax.Array  # [3] m/s, of the bowl a step ago
    acceleration: jax.Array  # [3] m/s², of the bowl, low-pass filtered


class Feeding:
    """The task itself; see `tasks.base.Task` for what each method returns."""

    title: ClassVar[str] = "Feed a person with a spoon"
    config_type = FeedingConfig

    def __init__(self, config: FeedingConfig, model: mujoco.MjModel, dt: float):
        self.config, self.dt = config, dt

    def reset(self, key) -> FeedingState:
        """Nothing is drawn: the mouth is where the head is."""
        return FeedingState(jnp.bool_(False), jnp.float32(0.0), jnp.float32(0.0), jnp.zeros(3), jnp.zeros(3))

    def observe(self, s: Sensors, state: FeedingState):
        vector = s["mouth_pos"] - s["tool_pos"]
        rotation = geometry.matrix(s["tool_quat"]).T @ geometry.matrix(s["mouth_quat"])
        return {
            "mouth_pos": s["mouth_pos"],
            "target_vector": vector,
            "target_distance": norm(vector)[None],
            "target_rotation": rotation.ravel(),
        }

    def reward_terms(self, s: Sensors, state: FeedingState):
        c = self.config
        vector, tool = s["mouth_pos"] - s["tool_pos"], geometry.matrix(s["tool_quat"])
        eating = self.helping(s, state) & (self.tool_speed(s, state) <= c.mouth_speed)
        paid = eating if c.pay_help_only else 1.0
        own = (-geometry.matrix(s["mouth_quat"])[:, 0], c.most_tilt) if c.aim_inward else ()
        return {
            "reach": c.reach_scale * envelope(norm(self._from_bowl(s) if c.reach_of_bowl else vector)),
            "orientation": orientation(vector, -tool[:, 0], tool[:, 2], *own),
            "approach": approach(self.tool_speed(s, state), norm(vector), c.speed),
            "contact": paid * boltzmann(norm(s["tool_force"]) / c.force),
        }

    def advance(self, s: Sensors, state: FeedingState) -> FeedingState:
        c = self.config
        up, acceleration = -geometry.matrix(s["tool_quat"])[:, 0], self._acceleration(s, state)
        upright = up @ geometry.unit(UP + acceleration / GRAVITY)  # cosine of the tilt
        away = norm(s["mouth_pos"] - s["tool_pos"]) > c.spill_distance
        tipped = state.tipped_seconds + self.dt * (away & (upright < jnp.cos(c.spill_angle)))
        lost = (tipped > c.spill_seconds) | (upright < jnp.cos(c.spill_anywhere) - 1e-6)
        if not c.spill_when_fed:
            lost &= state.mouth_seconds < c.success_seconds
        spilled = state.spilled | lost
        eating = ~spilled & self._at_mouth(s) & (self.tool_speed(s, state) <= c.mouth_speed)
        return FeedingState(spilled, state.mouth_seconds + self.dt * eating, tipped, s["tool_vel"], acceleration)

    def _acceleration(self, s: Sensors, state: FeedingState):
        """Of the bowl [3], in world axes, low-pass filtered: from its mean over the control step."""
        if not self.config.filter_seconds:
            return state.acceleration
        now = (s["tool_vel"] - state.velocity) / self.dt
        return low_pass(state.acceleration, now, self.dt, self.config.filter_seconds)

    def _at_mouth(self, s: Sensors):
        """Whether the bowl, between its middle and its tip, is at the mouth: in front, tip in, upper side up, and
        felt."""
        c = self.config
        tool, face = geometry.matrix(s["tool_quat"]), geometry.matrix(s["mouth_quat"])
        vector, tip, ahead = s["mouth_pos"] - s["tool_pos"], tool[:, 2], face[:, 0]
        from_bowl = self._from_bowl(s)
        _, aside, above = jnp.abs(face.T @ from_bowl)
        behind = -vector - c.bowl * tip  # from the mouth to where the handle begins, never at the mouth itself
        cosines = jnp.stack([geometry.unit(behind) @ ahead, -tip @ ahead, -tool[2, 0]])
        near = (norm(from_bowl) < c.mouth_distance) & (aside < c.mouth_width) & (above < c.mouth_height)
        felt = norm(tool_force(s, "head")) >= c.mouth_force
        return near & felt & (cosines >= jnp.cos(c.mouth_angle) - 1e-6).all()

    def _from_bowl(self, s: Sensors):
        """Vector [3] m to the mouth, in world axes, from the part of the bowl that is nearest to it."""
        vector, tip = s["mouth_pos"] - s["tool_pos"], geometry.matrix(s["tool_quat"])[:, 2]
        return vector - tip * jnp.clip(vector @ tip, 0.0, self.config.bowl)

    def helping(self, s: Sensors, state: FeedingState):
        """At the mouth, with the food."""
        return self._at_mouth(s) & ~state.spilled

    def tool_speed(self, s: Sensors, state: FeedingState):
        return norm(tool_velocity(s, "head"))

    def outcomes(self, state: FeedingState):
        return {"mouth_seconds": state.mouth_seconds, "spilled": state.spilled.astype(jnp.float32)}

    def success(self, state: FeedingState):
        """Half a second at the mouth before any spill; a spill afterwards undoes it."""
        return ~state.spilled & (state.mouth_seconds >= self.config.success_seconds)

    def terminated(self, state: FeedingState):
        return jnp.bool_(False)

    def markers(self, s: Sensors, state: FeedingState):
        return s["mouth_pos"]


_SCENE = SceneConfig(
    "wheelchair",
    "seated",
    "spoon",
    (0.65, 0.3, 0.32),
    pi + 0.5,
    NECK,
    ready=(0.0, -1.3, 0.0, -2.4, 0.0, 2.671, 0.785),  # the spoon level, its tip toward the person
    **MEAL_VIEW,
)

_PAPER = TaskSpec(
    "feeding",
    0,
    Feeding,
    _SCENE,
    expert="assistax.policies.experts.feeding:FeedingExpert",
    bound=4700,
    preference_budget=1.88,
    tremor_weakens=True,
)
_HELPING = TaskSpec(
    "feeding",
    1,
    Feeding,
    limited(_SCENE, "head"),
    FeedingConfig(
        mouth_angle=pi / 3,
        mouth_speed=0.1,
        spill_seconds=0.1,
        spill_anywhere=pi / 2,
        filter_seconds=0.05,
        spill_when_fed=False,
        pay_help_only=True,
        aim_inward=True,
        most_tilt=pi / 12,
    ),
    expert="assistax.policies.experts.feeding:FeedingExpert",
    bound=4700,
    preference_budget=1.88,
    preferences_need_help=True,
)
# Within 3 cm of the mouth is the chin, too, from where the middle of a spoon comes nearer to it than from ahead.
_AT_THE_LIPS = replace(
    _HELPING,
    version=2,
    config=replace(_HELPING.config, reach_of_bowl=True, mouth_width=0.02, mouth_height=0.01),
)

# Food that is poured out 7 cm before the mouth is on the clothes, and a spoon that never touches a lip feeds nobody.
_ON_THE_LIPS = replace(
    _AT_THE_LIPS,
    version=3,
    scene=replace(_AT_THE_LIPS.scene, throat=True),
    config=replace(_AT_THE_LIPS.config, spill_distance=0.0, mouth_force=0.1),
)

SPECS = (_PAPER, _HELPING, _AT_THE_LIPS, _ON_THE_LIPS)
