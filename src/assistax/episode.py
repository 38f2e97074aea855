"""What is added up over an episode, whatever the task: returns, force on the person, work of both agents."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from assistax.tasks.base import Sensors

Sums = dict[str, jax.Array]
"""By name a number so far: `return` and, with preferences, `task_return` and `preference_return`, which add up to it;
`cost`, see Env.step; `peak_force` (N) and `seconds_over_force_limit` of the robot on the person; `work_robot` and
`work_human` (J)."""


@dataclass(frozen=True)
class Bookkeeping:
    """Of one environment's episodes."""

    dt: float  # s per control step
    force_limit: float  # N, of the whole robot on the person
    preferring: bool  # whether the person has preferences

    def start(self) -> Sums:
        """All at zero, at the beginning of an episode."""
        names = ["return", "cost", "peak_force", "seconds_over_force_limit", "work_robot", "work_human"]
        names += ["task_return", "preference_return"] * self.preferring
        return {name: jnp.float32(0.0) for name in names}

    def add(self, sums: Sums, s: Sensors, robot_force: jax.Array, task_reward, preference_reward, cost) -> Sums:
        """After a control step with these sensors, force of the robot on the person (N), rewards and cost."""
        work = {
            "work_robot": jnp.abs(s["torque_robot"] * s["dtheta_robot"]).sum() * self.dt,
            "work_human": jnp.abs(s["torque_human"] * s["dtheta_driven"]).sum() * self.dt,
        }
        over = self.dt * (robot_force > self.force_limit)
        apart = {"task_return": task_reward, "preference_return": preference_reward} if self.preferring else {}
        return {name: sums[name] + reward for name, reward in apart.items()} | {
            "return": sums["return"] + task_reward + preference_reward,
            "cost": sums["cost"] + cost,
            "peak_force": jnp.maximum(sums["peak_force"], robot_force),
            "seconds_over_force_limit": sums["seconds_over_force_limit"] + over,
            **{name: sums[name] + joules for name, joules in work.items()},
        }
