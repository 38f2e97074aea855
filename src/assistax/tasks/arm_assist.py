"""Bring a person's weak right arm, which hangs over the edge of the bed, back beside the waist.

Paper: task "Arm Assist"; reward components r_t, r_t' and r_R. The wrist target is the middle of the
forearm, as in the paper's figure; d_H is its distance to the waist target.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco

from assistax.pytree import pytree
from assistax.scenes import RIGHT_ARM, SceneConfig, geometry, limited
from assistax.scenes.geometry import norm
from assistax.tasks.base import Sensors, tool_velocity
from assistax.tasks.registry import TaskSpec
from assistax.tasks.rewards import reach, rotation, waist


@dataclass(frozen=True)
class ArmAssistConfig:
    """The numbers in which versions differ; the defaults are version 0's."""

    waist_scale: float = 10.0  # of the waist term
    waist_width: float = 0.1  # m, from the waist, within which most of the waist term is paid
    rotation_scale: float = 0.1  # of the rotation term
    grip: float = 0.0  # m, from the middle of the forearm toward the hand, to where the hook is to come
    unsettled: float = 1.0  # of the waist term is paid unless the forearm is brought back
    speed_seen: bool = False  # whether observations tell how the forearm moves, and whether it was thrown
    # What counts as brought back, and for how long in all it must last to be a success.
    waist_distance: float = 0.10  # m
    settled_speed: float = 1e3  # m/s, of the forearm, at most, while it counts
    carrying_speed: float = 1e3  # m/s, at most, from where it last lay still away from the waist
    success_seconds: float = 0.5  # s, in all
    to_the_end: bool = False  # whether it must also be there at the end


@pytree
class ArmAssistState:
    """What an episode has come to, beside the physics."""

    seconds_at_waist: jax.Array
    thrown: jax.Array  # bool: faster than the carrying speed since it last lay still away from the waist
    there: jax.Array  # bool: the forearm is at the waist


class ArmAssist:
    """The task itself; see `tasks.base.Task` for what each method returns."""

    title: ClassVar[str] = "Lift a person's weak right arm back to the waist"
    config_type = ArmAssistConfig

    def __init__(self, config: ArmAssistConfig, model: mujoco.MjModel, dt: float):
        self.config, self.dt = config, dt

    def reset(self, key) -> ArmAssistState:
        """Nothing is drawn: both targets are sites on the person."""
        return ArmAssistState(jnp.float32(0.0), jnp.bool_(False), jnp.bool_(False))

    @staticmethod
    def _rotation(s: Sensors):
        """R_hookᵀ R_wrist [3, 3]."""
        return geometry.matrix(s["tool_quat"]).T @ geometry.matrix(s["wrist_target_quat"])

    @staticmethod
    def _speed(s: Sensors):
        """Of the forearm in m/s; 0 in version 0, which does not measure it."""
        return norm(s["wrist_target_vel"]) if "wrist_target_vel" in s else jnp.float32(0.0)

    def observe(self, s: Sensors, state: ArmAssistState):
        vector = s["wrist_target_pos"] - s["tool_pos"]
        to_waist = s["waist_target_pos"] - s["wrist_target_pos"]
        blocks = {
            "forearm_pos": s["forearm_pos"],
            "upper_arm_pos": s["upper_arm_pos"],
            "target_vector": vector,
            "target_distance": norm(vector)[None],
            "target_rotation": self._rotation(s).ravel(),
            "waist_vector": to_waist,
            "waist_distance": norm(to_waist)[None],
        }
        if self.config.speed_seen:
            blocks |= {"target_velocity": s["wrist_target_vel"], "thrown": state.thrown.astype(jnp.float32)[None]}
        return blocks

    def reward_terms(self, s: Sensors, state: ArmAssistState):
        c = self.config
        paid = jnp.where(self._settled(s, state, state.thrown), 1.0, c.unsettled)
        to_grip = s["wrist_target_pos"] - s["tool_pos"]
        if c.grip:
            to_grip -= c.grip * geometry.matrix(s["wrist_target_quat"])[:, 2]  # the forearm's axis, to the elbow
        return {
            "reach": reach(norm(to_grip)),
            "waist": c.waist_scale * paid * waist(norm(s["waist_target_pos"] - s["wrist_target_pos"]), c.waist_width),
            "rotation": c.rotation_scale * rotation(self._rotation(s)),
        }

    def advance(self, s: Sensors, state: ArmAssistState) -> ArmAssistState:
        c, there = self.config, self._there(s)
        speed = self._speed(s)
        thrown = (state.thrown & (there | (speed > c.settled_speed))) | (speed > c.carrying_speed)
        settled = self._settled(s, state, thrown)
        return ArmAssistState(state.seconds_at_waist + self.dt * settled, thrown, there)

    def _settled(self, s: Sensors, state: ArmAssistState, thrown):
        """The forearm is at the waist, still, and was carried there."""
        return self._there(s) & ~thrown & (self._speed(s) <= self.config.settled_speed)

    def helping(self, s: Sensors, state: ArmAssistState):
        """The forearm is at the waist, and was carried there."""
        return self._there(s) & ~state.thrown

    def _there(self, s: Sensors):
        """The forearm is at the waist."""
        return norm(s["waist_target_pos"] - s["wrist_target_pos"]) < self.config.waist_distance

    def tool_speed(self, s: Sensors, state: ArmAssistState):
        return norm(tool_velocity(s, "forearm"))

    def outcomes(self, state: ArmAssistState):
        return {"seconds_at_waist": state.seconds_at_waist}

    def success(self, state: ArmAssistState):
        """Half a second at the waist; from version 2 on the arm must be there now, too."""
        held = state.there if self.config.to_the_end else True
        return held & (state.seconds_at_waist >= self.config.success_seconds)

    def terminated(self, state: ArmAssistState):
        return jnp.bool_(False)

    def markers(self, s: Sensors, state: ArmAssistState):
        return s["wrist_target_pos"]


_SCENE = SceneConfig(
    "bed",
    "lying_arm_out",
    "hook",
    (0.15, -0.9, 0.32),
    pi / 2,
    RIGHT_ARM,
    human_strength=0.2,
    targets=("wrist_target", "waist_target"),
    camera=(-1.15, -1.75, 1.65, 0.0, -0.35, 0.68),
    close=(-0.75, -1.15, 1.35, 0.0, -0.38, 0.75),
)

# 0.2 m behind the forearm, as one looks at it from the waist, and 0.06 m above, the hook turned to it.
_BESIDE = (-0.6, -1.18, 0.9, -1.775, 0.86, 1.11, 1.97)

_PAPER = TaskSpec(
    "arm_assist",
    0,
    ArmAssist,
    _SCENE,
    expert="assistax.policies.experts.arm_assist:ArmAssistExpert",
    bound=11280,
    preference_budget=4.512,
    tremor_weakens=True,
)
_HELPING = TaskSpec(
    "arm_assist",
    1,
    ArmAssist,
    replace(limited(_SCENE, "forearm"), ready=_BESIDE),
    ArmAssistConfig(
        waist_width=0.3,
        grip=0.075,
        unsettled=0.7,
        speed_seen=True,
        settled_speed=0.1,
        carrying_speed=0.5,
    ),
    expert="assistax.policies.experts.arm_assist:ArmAssistExpert",
    bound=11280,
    preference_budget=4.512,
    preferences_need_help=True,
)
# An arm that falls out of bed again was not brought back.
_FOR_GOOD = replace(
    _HELPING,
    version=2,
    scene=replace(_HELPING.scene, throat=True),
    config=replace(_HELPING.config, to_the_end=True),
)

SPECS = (_PAPER, _HELPING, _FOR_GOOD)
