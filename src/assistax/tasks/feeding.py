"""Bring a spoon to the mouth without spilling: level on the way, tilted and slow at the end.

Paper: task "Feeding"; reward components r_te, r_o, r_v and r_f. The spoon's up is −x of the tool
frame, its tip is +z.
"""

from dataclasses import dataclass
from math import pi
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco

from assistax.pytree import pytree
from assistax.scenes import MEAL_VIEW, NECK, SceneConfig, geometry
from assistax.tasks.base import Sensors
from assistax.tasks.registry import TaskSpec
from assistax.tasks.rewards import approach, boltzmann, envelope, norm, orientation


@dataclass(frozen=True)
class FeedingConfig:
    reach_scale: float = 2.0
    speed: float = 0.20  # m/s, v*_app far from the mouth
    force: float = 1.0  # N, f* of the contact term
    # What counts as feeding, and for how long in all it must last to be a success.
    mouth_distance: float = 0.03  # m, from the bowl, between its middle (the tool point) and its tip
    bowl: float = 0.036  # m, from middle to tip: as near as the middle gets to a face from the front
    success_seconds: float = 0.5
    # The arm starts with the spoon level. The food is lost when it tips too far while still away from the mouth.
    spill_angle: float = 0.7854  # rad from upright
    spill_distance: float = 0.1  # m


@pytree
class FeedingState:
    spilled: jax.Array  # bool
    mouth_seconds: jax.Array  # at the mouth, with the food


class Feeding:
    title: ClassVar[str] = "Feed a person with a spoon"
    config_type = FeedingConfig

    def __init__(self, config: FeedingConfig, model: mujoco.MjModel, dt: float):
        self.config, self.dt = config, dt

    def reset(self, key) -> FeedingState:
        """Nothing is drawn: the mouth is where the head is."""
        return FeedingState(jnp.bool_(False), jnp.float32(0.0))

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
        return {
            "reach": c.reach_scale * envelope(norm(vector)),
            "orientation": orientation(vector, up=-tool[:, 0], tip=tool[:, 2]),
            "approach": approach(norm(s["tool_vel"]), norm(vector), c.speed),
            "contact": boltzmann(norm(s["tool_force"]) / c.force),
        }

    def advance(self, s: Sensors, state: FeedingState) -> FeedingState:
        c = self.config
        tool, vector = geometry.matrix(s["tool_quat"]), s["mouth_pos"] - s["tool_pos"]
        upright, tip = -tool[2, 0], tool[:, 2]  # cosine of the tilt; unit vector
        from_bowl = norm(vector - tip * jnp.clip(vector @ tip, 0.0, c.bowl))
        tipped = (upright < jnp.cos(c.spill_angle)) & (norm(vector) > c.spill_distance)
        spilled = state.spilled | tipped
        eating = ~spilled & (from_bowl < c.mouth_distance)
        return FeedingState(spilled, state.mouth_seconds + self.dt * eating)

    def outcomes(self, state: FeedingState):
        return {"mouth_seconds": state.mouth_seconds, "spilled": state.spilled.astype(jnp.float32)}

    def success(self, state: FeedingState):
        """Half a second at the mouth before any spill; a spill afterwards undoes it."""
        return ~state.spilled & (state.mouth_seconds >= self.config.success_seconds)

    def terminated(self, state: FeedingState):
        return jnp.bool_(False)

    def markers(self, s: Sensors, state: FeedingState):
        return s["mouth_pos"]


SPECS = (
    TaskSpec(
        "feeding",
        0,
        Feeding,
        SceneConfig(
            "wheelchair",
            "seated",
            "spoon",
            (0.65, 0.3, 0.32),
            pi + 0.5,
            NECK,
            ready=(0.0, -1.3, 0.0, -2.4, 0.0, 2.671, 0.785),  # the spoon level, its tip toward the person
            **MEAL_VIEW,
        ),
        expert="assistax.policies.experts.feeding:FeedingExpert",
        bound=4700,
        preference_budget=1.88,
    ),
)
