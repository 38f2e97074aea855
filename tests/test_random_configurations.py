"""Anything that can be configured can be played: random tasks, engines, people, settings and batch shapes."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import random_actions

import assistax
from assistax.human import DISABILITIES, disability, preference
from assistax.tasks import TASKS

SEEDS = range(20, 28)  # which bring every task and every way to name a person
SEEN_BY = {"robot": ("both", "oracle"), "human": ("both", "human", "shown", "oracle")}
NAMES = list(dict.fromkeys(spec.name for spec in TASKS.values()))


def configuration(seed):
    """(task, settings, batch shape), drawn from everything that is allowed; JSON can hold all of it."""
    rng = np.random.default_rng(seed)

    def number(low, high):
        return round(float(rng.uniform(low, high)), 4)

    def disabled():
        parts = rng.permutation(list(disability.RANGES))[: rng.integers(1, 5)]
        numbers = " ".join(f"{part}={number(*disability.RANGES[part])}" for part in parts)
        return str(rng.choice(["none", "standard", *DISABILITIES, numbers, numbers, numbers]))

    def preferring():
        parts = []
        for name, (least, most) in preference.RANGES.items():
            low = number(least, most - preference.NARROWEST[name])
            parts.append(f"{name}={low}:{number(low + preference.NARROWEST[name] + 1e-4, most)}")
        weights = [number(*bounds) for bounds in preference.WEIGHTS.values()]
        parts.append("weights=" + ",".join(map(str, weights[: rng.integers(3, 5)])))
        return str(rng.choice(["none", "default", "sweep", *[" ".join(parts)] * 3]))

    def listed():
        drawn = [{"disability": disabled(), "preference": preferring()} for _ in range(rng.integers(1, 5))]
        fixed = [p for p in drawn if p["disability"] != "standard" and p["preference"] not in ("none", "sweep")]
        return fixed or "paper630"

    human = {"people": listed()} if rng.random() < 0.3 else {"disability": disabled(), "preference": preferring()}
    settings = {
        "human": human | {"visibility": str(rng.choice(["both", "human", "none", "shown", "oracle"]))},
        "episode_length": int(rng.integers(1, 5)),
        "substeps": int(rng.integers(1, 6)),
        "control": str(rng.choice(["torque", "position"])),
        "torque_scale": number(0.01, 1.0),
        "reset_noise": number(0.0, 0.05),
        "force_limit": number(0.0, 50.0),
        "num_threads": int(rng.integers(0, 3)),
    }
    batch = tuple(int(n) for n in rng.integers(1, 4, seed % 3))
    versions = [task for task, spec in TASKS.items() if spec.name == NAMES[seed % len(NAMES)]]
    return versions[seed // len(NAMES) % len(versions)], settings, batch


def test_the_seeds_bring_every_task():
    assert {TASKS[configuration(seed)[0]].name for seed in SEEDS} == set(NAMES)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("engine", ["mujoco", pytest.param("warp", marks=pytest.mark.slow)])
def test_any_configuration_plays(engine, seed):
    """Through several resets: finite, of the promised shapes and types, without an engine's fault."""
    task, settings, batch = configuration(seed)
    env = assistax.make(task, engine, **json.loads(json.dumps(settings)))
    step, reset = env.step, env.reset
    for _ in batch:
        step, reset = jax.vmap(step), jax.vmap(reset)

    @jax.jit
    def play(key):
        obs, state = reset(jax.random.split(key, batch) if batch else key)

        def one(carry, key):
            _, state = carry
            actions = jax.tree.map(lambda a: 1.5 * a, random_actions(env, key, batch))  # clipped beyond 1
            obs, state, rewards, terminated, truncated, info = step(
                jax.random.split(key, batch) if batch else key, state, actions
            )
            return (obs, state), (rewards, terminated, truncated, info)

        return jax.lax.scan(one, (obs, state), jax.random.split(key, 6))

    (obs, state), (rewards, terminated, truncated, info) = play(jax.random.key(seed))
    for agent in env.agents:
        for seen in (obs[agent], info["final_observation"][agent][-1]):
            assert seen.shape == (*batch, *env.observation_space(agent).shape) and seen.dtype == jnp.float32
        assert rewards[agent].shape == (6, *batch)
    assert info["final_global_observation"].shape == (6, *batch, env.global_size)
    for leaf in jax.tree.leaves((obs, rewards, info, state)):
        assert np.isfinite(leaf).all()
    assert not info["fault"].any()
    done = np.asarray(terminated["__all__"] | truncated["__all__"])
    assert done[env.episode_length - 1 :: env.episode_length].all()
    assert (np.asarray(state.t) < env.episode_length).all()

    human = env.config.human
    total = sum(term for term in info["reward_terms"].values())
    np.testing.assert_allclose(rewards["robot"], total, rtol=1e-4, atol=1e-4)
    liked = sum(term for name, term in info["reward_terms"].items() if name.startswith("prefer"))
    assert human.preferring == ("preference_return" in info["metrics"])
    assert np.all(liked <= TASKS[task].preference_budget + 1e-4)
    for agent in env.agents:
        seeing = human.preferring and human.visibility in SEEN_BY[agent]
        assert seeing == ("preference" in env.obs_layout(agent))
        if seeing:
            wanted = state.person.preference
            vector = jnp.concatenate([wanted.speed, wanted.force, wanted.weights[..., :3]], -1)
            np.testing.assert_array_equal(obs[agent][..., env.obs_layout(agent)["preference"]], vector)
