"""Environments shared by several devices of one machine; XLA makes a CPU look like several."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from assistax.devices import by_environment, check_devices, part_of_batch
from assistax.errors import UsageError
from assistax.training.configuration import TrainConfig

# Trainings of one seed in one process: on one device, on two, on two again, and on two beside another seed.
TRAININGS = """
import json, sys
import jax, numpy as np
from games import Fines
from assistax.devices import sharing
from assistax.learning.ppo import PPO, PPOConfig
from assistax.training.seeds import Seeds

recurrent, central = json.loads(sys.argv[1])
config = PPOConfig(num_steps=8, num_minibatches=2, hidden=(8, 8), recurrent=recurrent, cost_limit=1.0,
                   central_critic=central, noise_correlation=0.5)

def trained(devices, seeds=(0,), side_by_side=False):
    trainer = PPO(Fines(), config, 32, 4)
    lanes = Seeds(seeds)
    lanes._side_by_side = side_by_side  # as on an accelerator
    with sharing(devices):
        collect, improve = lanes.jit(trainer.collect), lanes.jit(trainer.improve)
        state = lanes.init(trainer.init)
        for _ in range(4):
            state, batch = jax.block_until_ready(collect(state))  # as training does; else XLA's few threads may wait
            state, losses = jax.block_until_ready(improve(state, batch))  # for each other for ever
    state, losses = lanes.each(state)[0], lanes.each(losses)[0]
    parts = {len({str(shard.index) for shard in x.addressable_shards}) for x in jax.tree.leaves(state.obs)}
    weights = [np.asarray(x).ravel() for x in jax.tree.leaves((state.params, state.obs, losses))]
    return np.concatenate(weights).tolist(), sorted(parts)

print(json.dumps([trained(1), trained(2), trained(2), trained(2, (0, 1), True)]))
"""

# Whole steps of a real task, with episodes that end, on one device and on two.
STEPS = """
import json, sys
import jax
import assistax
from assistax.devices import by_environment, sharing

env = assistax.make(sys.argv[1], sys.argv[2], episode_length=3)
n = 6

def roll(key):
    obs, state = by_environment(env.reset)(jax.random.split(key, n))

    def step(carry, key):
        actions = {a: jax.random.uniform(key, (n, size), minval=-1.0) for a, size in env.action_sizes.items()}
        obs, state, reward, *_ = by_environment(env.step)(jax.random.split(key, n), carry[1], actions)
        return (obs, state), (reward["robot"], obs)

    return jax.lax.scan(step, (obs, state), jax.random.split(key, 5))[1]

rolled = []
for devices in (1, 2):
    with sharing(devices):
        rewards, obs = jax.jit(roll)(jax.random.key(0))
    rolled.append([rewards.tolist(), obs["robot"].tolist(), obs["human"].tolist()])
print(json.dumps(rolled))
"""


def on_devices(count: int, code: str, *words: str):
    """What a process prints as JSON that has so many devices."""
    flags = {"XLA_FLAGS": f"--xla_force_host_platform_device_count={count}", "JAX_PLATFORMS": "cpu"}
    where = {"PYTHONPATH": str(Path(__file__).parent)}
    command = [sys.executable, "-c", code, *words]
    done = subprocess.run(command, env=os.environ | flags | where, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize(
    ("recurrent", "central"), [(False, False), pytest.param(True, True, marks=pytest.mark.slow)], ids=["ippo", "mappo"]
)
def test_two_devices_learn_what_one_does(recurrent, central):
    one, two, again, beside = on_devices(2, TRAININGS, json.dumps([recurrent, central]))
    assert one[1] == [1]  # parts
    assert two[1] == [2]
    np.testing.assert_allclose(two[0], one[0], rtol=2e-4, atol=2e-5)
    assert two == again
    np.testing.assert_allclose(beside[0], one[0], rtol=2e-4, atol=2e-5)


def test_two_devices_step_a_task_as_one_does():
    one, two = on_devices(2, STEPS, "scratch", "mujoco")
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_two_devices_step_a_task_by_warp_as_one_does():
    one, two = on_devices(2, STEPS, "scratch", "warp")
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4)


def test_one_device_has_everything():
    x = np.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(by_environment(lambda k, row: k * row, whole=1)(2.0, x), 2.0 * x)
    assert part_of_batch(x) is x


def test_devices_that_are_not_there_and_environments_that_do_not_divide_are_named(monkeypatch):
    with pytest.raises(UsageError, match=r"devices = 2, and there are 1 on this machine; take 1 or fewer\."):
        check_devices(2, 256)
    monkeypatch.setattr("jax.local_device_count", lambda: 3)
    with pytest.raises(UsageError, match="num_envs = 256 do not divide into devices = 3; take --num-envs 255"):
        check_devices(3, 256)
    check_devices(3, 255)
    with pytest.raises(UsageError, match="devices = 2, and masac trains on one; leave it out"):
        TrainConfig("scratch", "masac", devices=2)
    with pytest.raises(UsageError, match="devices must be 1 or more, not 0"):
        TrainConfig("scratch", devices=0)
