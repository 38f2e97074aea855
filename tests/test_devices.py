"""Environments shared by several devices of one machine; XLA makes a CPU look like several."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from stored import small, stored_run

from assistax.devices import by_environment, check_devices, part_of_batch
from assistax.errors import UsageError
from assistax.training.configuration import TrainConfig
from assistax.training.loop import train
from assistax.training.run import Run
from assistax.training.sweep import Sweep

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

# A run of two iterations on the first number of devices, continued for one on each of the others.
RUNS = """
import json, sys
from pathlib import Path
import jax
from stored import small, train_without_pictures
from assistax.training import loop
from assistax.training.run import Run

save, used = loop._Training._save, []

def noting(self, state, done):
    used.append(max(len(x.sharding.device_set) for x in jax.tree.leaves(state)))
    save(self, state, done)

loop._Training._save = noting
folder, (first, *others) = Path(sys.argv[1]), json.loads(sys.argv[2])
config = small(steps=128, settings={"devices": first, "evaluations": 2, "evaluation_episodes": 4})
summaries = [train_without_pictures(Run.create(config, folder))]
for i, devices in enumerate(others, 3):
    summaries.append(train_without_pictures(Run.open(folder, {"devices": devices}, steps=64 * i)))
rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
played = [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]
print(json.dumps([used, [one["steps"] for one in summaries], [one["reward"] for one in rows],
                  {one["steps"]: one["episodes"]["return"] for one in played}]))
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


@pytest.mark.slow
def test_a_run_is_trained_evaluated_saved_and_continued_on_another_number_of_devices(tmp_path):
    used, steps, rewards, returns = on_devices(2, RUNS, str(tmp_path / "a"), "[2, 1]")
    assert used == [2, 2, 1] and steps == [128, 192]  # the first is saved before it begins, too
    assert list(returns) == ["64", "128", "192"] and all(len(one) == 4 for one in returns.values())
    _, _, alone, played = on_devices(1, RUNS, str(tmp_path / "b"), "[1, 1]")
    for ours, theirs in zip(rewards, alone, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-3, abs=1e-4)
    for at, theirs in played.items():
        np.testing.assert_allclose(returns[at], theirs, rtol=1e-3)


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


def test_devices_that_cannot_be_leave_nothing_behind(tmp_path):
    asked = small(settings={"devices": 3, "evaluations": 1})
    with pytest.raises(UsageError, match="devices = 3, and there are 1 on this machine"):
        Run.create(asked, tmp_path / "run")
    with pytest.raises(UsageError, match="devices = 3, and a sweep trains on one; leave it out"):
        Sweep.create(asked, tmp_path / "sweep", 1, {"ppo.gamma": "0.9,0.99"})
    assert not list(tmp_path.iterdir())
    begun = stored_run(tmp_path / "run", small())  # by another machine, which has three
    changed = json.loads((begun.folder / "config.json").read_text()) | {"devices": 3}
    (begun.folder / "config.json").write_text(json.dumps(changed))
    files = {path: path.read_bytes() for path in begun.folder.rglob("*") if path.is_file()}
    found = Run.open(begun.folder)  # it plays here all the same
    with pytest.raises(UsageError, match="devices = 3, and there are 1 on this machine"):
        train(found)
    assert files == {path: path.read_bytes() for path in begun.folder.rglob("*") if path.is_file()}
