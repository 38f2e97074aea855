"""Trained teams in NumPy act as they do in JAX."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored import small, stored_run

import assistax
from assistax.cli.export import export
from assistax.errors import UsageError
from assistax.inference import NumPyTeam
from assistax.learning.algorithms import ALGORITHMS
from assistax.policies import Player, Still
from assistax.training.numpy_team import as_numpy

VARIANTS = {"ippo": {}, "gru": {"recurrent": True}, "shared": {"share_parameters": True}, "masac": {},
            "plain": {"normalize_obs": False}}  # fmt: skip


@pytest.fixture(scope="module", params=VARIANTS)
def team(request, scratch):
    """An untrained team of every kind, with a normaliser that has seen something."""
    algorithm = ALGORITHMS["masac" if request.param == "masac" else "ippo"]
    few = {"buffer_size": 64, "warmup": 8} if request.param == "masac" else {"num_minibatches": 1}
    config = algorithm.config_type(**algorithm.switches, **VARIANTS[request.param], **few, num_steps=4)
    trainer = algorithm.trainer(scratch, config, 2, 1, {})
    state = jax.jit(trainer.init)(jax.random.key(0))
    key = iter(jax.random.split(jax.random.key(1), 100))
    stats = jax.tree.map(lambda x: jnp.abs(x + 3.0 + jax.random.normal(next(key), x.shape)), state.normalizer)
    learned = trainer.policy_params(dataclasses.replace(state, normalizer=stats))
    return {agent: Player.of(trainer.policy(True), params) for agent, params in learned.items()}


def test_numpy_acts_as_jax_does(scratch, team, tmp_path):
    numpy_team = as_numpy(team)
    numpy_team.save(tmp_path / "team.npz")
    stored = assistax.load_team(tmp_path / "team.npz")
    rng = np.random.default_rng(0)
    carries = {agent: player.policy.initial_carry() for agent, player in team.items()}
    numpy_team.act({agent: rng.normal(size=n) for agent, n in scratch.observation_sizes.items()})
    for t in range(6):
        obs = {agent: 5.0 * rng.normal(size=n).astype(np.float32) for agent, n in scratch.observation_sizes.items()}
        reset = t in (0, 4)
        if reset:
            numpy_team.reset(), stored.reset()
        mine, theirs = numpy_team.act(obs), stored.act(obs)
        for agent, player in team.items():
            action, carries[agent] = player.policy.act(
                player.member(0), carries[agent], jnp.asarray(obs[agent]), jnp.bool_(reset), jax.random.key(0)
            )
            np.testing.assert_allclose(mine[agent], np.clip(action, -1, 1), atol=1e-6)
            np.testing.assert_array_equal(mine[agent], theirs[agent])


def test_the_packaged_team_is_there_by_its_name():
    team = assistax.load_team("scratch-v0")
    env = assistax.make("scratch-v0", engine="mujoco")
    obs, _ = env.reset(jax.random.key(0))
    actions = team.act({agent: np.asarray(x) for agent, x in obs.items()})
    assert {agent: a.shape for agent, a in actions.items()} == {a: (n,) for a, n in env.action_sizes.items()}


def test_what_is_saved_plays_with_numpy_alone(tmp_path):
    assistax.load_team("scratch-v0").save(tmp_path / "team.npz")
    (tmp_path / "inference.py").write_text(Path(assistax.inference.__file__).read_text())
    code = "import sys, inference; t = inference.NumPyTeam.load('team.npz'); import numpy as np\n"
    code += "print(t.act({'robot': np.zeros(34)})['robot'].shape, 'jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(7,) False"


def test_a_run_folder_and_what_was_exported_of_it_act_alike(tmp_path):
    run = stored_run(tmp_path / "run", small(num_seeds=2))
    export(run.folder, out=tmp_path / "team.npz", seed=0)
    obs = {agent: np.ones(size) for agent, size in run.env.observation_sizes.items()}
    wanted = as_numpy(run.teams()[0]).act(obs)["robot"]
    for what in (run.folder, tmp_path / "team.npz"):
        np.testing.assert_allclose(assistax.load_team(what).act(obs)["robot"], wanted, atol=1e-6)
    for name, content in (("nowhere.npz", None), ("foreign.npz", b"PK"), ("other.npz", {"a": np.zeros(2)})):
        if isinstance(content, dict):
            np.savez(tmp_path / name, **content)
        elif content:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(UsageError, match=f"Cannot read a team from .*{name}"):
            assistax.load_team(tmp_path / name)


def test_a_scripted_agent_is_one_line(scratch):
    with pytest.raises(UsageError, match="Only networks can be had in NumPy, not the Still that plays the human"):
        as_numpy({"human": Player(Still(3))})
    assert isinstance(NumPyTeam({}), NumPyTeam)
