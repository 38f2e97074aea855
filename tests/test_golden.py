"""Version 0 of every task stays what results are of: rewards, observations and joints as they were recorded.

Recorded on the C engine, one environment: the reset of one seed, and 360 steps (2.9 s, all with contact) of the
expert's actions in hundredths, which are played again as they were. `python tests/test_golden.py` records anew: for a
new version of a task, or with a MuJoCo or JAX that computes or draws otherwise. Numbers are compared and not bits:
other processors may round otherwise (other instruction sets here change the rewards by 3e-7, and no joint).
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax
from assistax.policies import scripted_team

TASKS = ("scratch-v0", "bed_bath-v0", "arm_assist-v0", "feeding-v0", "tooth_brushing-v0")
RECORDED = Path(__file__).with_name("golden.npz")
STEPS, EVERY = 360, 40  # of observations and joints


def played(task: str, hundredths: dict[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
    """By name what happens with these actions by agent [STEPS, n], or with the expert's."""
    env = assistax.make(task, engine="mujoco")
    team = {} if hundredths else scripted_team("expert", env)
    carries = {agent: player.policy.initial_carry() for agent, player in team.items()}

    def step(carry, now):
        (state, carries), (t, given) = carry, now
        for agent, player in team.items():
            action, carries[agent] = player.policy.act((), carries[agent], state, t == 0, jax.random.key(t))
            given[agent] = jnp.round(100 * action).astype(jnp.int8)
        actions = {agent: x / jnp.float32(100) for agent, x in given.items()}
        obs, state, rewards, *_ = env.step_env(jax.random.key(0), state, actions)
        return (state, carries), (rewards["robot"], given, obs | {"joints": state.physics.qpos})

    @jax.jit
    def play(key):
        return jax.lax.scan(step, (env.reset(key)[1], carries), (jnp.arange(STEPS), hundredths or {}))[1]

    rewards, given, seen = play(jax.random.key(0))
    found = {"rewards": rewards} | {f"action {agent}": x for agent, x in given.items()}
    return jax.tree.map(np.asarray, found | {f"seen {name}": x[EVERY - 1 :: EVERY] for name, x in seen.items()})


@pytest.mark.parametrize("task", TASKS)
def test_version_0_is_as_it_was(task):
    with np.load(RECORDED) as file:
        recorded = {name.partition("/")[2]: file[name] for name in file.files if name.startswith(task)}
    found = played(task, {agent: recorded[f"action {agent}"] for agent in ("robot", "human")})
    assert found.keys() == recorded.keys()
    for name, before in recorded.items():
        np.testing.assert_allclose(found[name], before, rtol=1e-5, atol=1e-5 * np.abs(before).max(), err_msg=name)


if __name__ == "__main__":
    np.savez_compressed(RECORDED, **{f"{task}/{name}": x for task in TASKS for name, x in played(task).items()})
