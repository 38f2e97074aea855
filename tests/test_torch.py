"""The torch adapter: the functional environment's values in shared memory."""

import jax
import numpy as np
import pytest

import assistax
from assistax.adapters.partner import batch_of, episode_keys, find_player

torch = pytest.importorskip("torch", reason="needs the extra torch")

from assistax.adapters.torch import TorchEnv  # noqa: E402

LENGTH, NUM_ENVS = 6, 8


@pytest.fixture(scope="module")
def env():
    return batch_of("scratch-v3", "mujoco", {"episode_length": LENGTH}).env


def actions(size, i):
    return np.random.default_rng(i).uniform(-1, 1, (NUM_ENVS, size)).astype(np.float32)


def test_tensors_are_what_the_functional_environment_gives(env):
    """Bit for bit the batch's, also over an end, and when the caller writes into all that came out."""
    many, batch = TorchEnv(env, NUM_ENVS), batch_of(env)
    players = {"human": find_player("still", env, "human")}
    obs = many.reset(seed=0)
    expected, state = batch.reset(players, episode_keys(np.random.default_rng(0), NUM_ENVS))
    np.testing.assert_array_equal(obs.numpy(), expected["robot"])
    plain, functional = state.env, jax.jit(jax.vmap(env.step_env))
    keys = jax.random.split(jax.random.key(0), NUM_ENVS)
    for i in range(LENGTH + 2):
        step = many.step(torch.from_numpy(actions(7, i)))
        state, truth = batch.step("same_step", players, state, {"robot": actions(7, i)})
        for ours, theirs in (
            (step.obs, truth.obs["robot"]),
            (step.reward, truth.reward),
            (step.terminated, truth.terminated),
            (step.truncated, truth.truncated),
            (step.info["metrics"]["return"], truth.info["metrics"]["return"]),
            (step.info["final_observation"], truth.info["final_observation"]["robot"]),
        ):
            assert ours.device == many.device
            np.testing.assert_array_equal(ours.numpy(), theirs)
        assert step.truncated.all() == (i == LENGTH - 1)
        if i < LENGTH:
            human = np.zeros((NUM_ENVS, 3), np.float32)
            seen, plain, rewards, *_ = functional(keys, plain, {"robot": actions(7, i), "human": human})
            np.testing.assert_array_equal(step.info["final_observation"].numpy(), seen["robot"])
            np.testing.assert_array_equal(step.reward.numpy(), rewards["robot"])
        for tensor in (step.obs, step.reward, step.info["final_observation"], *step.info["metrics"].values()):
            tensor.fill_(7)


def test_nothing_is_copied(env, monkeypatch):
    many = TorchEnv(env, NUM_ENVS, agent="both")
    seen, step = {}, many._batch.step

    def watched(*args):
        state, out = step(*args)
        seen.update({"in": args[3], "out": out})
        return state, out

    monkeypatch.setattr(many._batch, "step", watched)
    many.reset(seed=0)
    given = {agent: torch.rand(NUM_ENVS, size) for agent, size in env.action_sizes.items()}
    out = many.step(given)
    for agent in env.agents:
        assert seen["in"][agent].unsafe_buffer_pointer() == given[agent].data_ptr()
        assert out.obs[agent].data_ptr() == seen["out"].obs[agent].unsafe_buffer_pointer()
    assert out.reward.data_ptr() == seen["out"].reward.unsafe_buffer_pointer()
    assert out.truncated.data_ptr() == seen["out"].truncated.unsafe_buffer_pointer()


def test_a_mask_says_who_begins_again(env):
    many = TorchEnv(env, NUM_ENVS, autoreset="disabled")
    first = many.reset(seed=0).clone()
    assert (many.reset() != first).any() and (many.reset(seed=0) == first).all()
    many.step(torch.zeros(NUM_ENVS, 7)).info["metrics"]["length"].fill_(7)  # which is the caller's
    mask = torch.arange(NUM_ENVS) < 3
    many.reset(mask=mask)
    step = many.step(torch.zeros(NUM_ENVS, 7))
    assert step.info["metrics"]["length"].tolist() == [1] * 3 + [2] * 5


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda env: TorchEnv(env, 2).step(torch.zeros(2, 7)), "Call reset before step"),
        (lambda env: TorchEnv(env, 2).reset(mask=torch.ones(2, dtype=torch.bool)), "Reset all environments before"),
        (lambda env: TorchEnv(env, 2, autoreset="NextStep"), "Unknown autoreset 'NextStep'"),
        (lambda env: TorchEnv(env, 2, agent="both", partner="random"), "nobody is left for a partner"),
        (lambda env: TorchEnv(env, 2, partner="stil"), "Did you mean 'still'"),
        (lambda env: TorchEnv(env, 0), "num_envs must be 1 or more"),
        (lambda env: begun(env).step(np.zeros((8, 7))), "must be a tensor, float32 .* not ndarray"),
        (lambda env: begun(env).step(torch.zeros(8, 3)), r"must be float32 \(8, 7\) on cpu, not float32 \(8, 3\)"),
        (lambda env: begun(env).step(torch.zeros(8, 7, dtype=torch.float64)), "not float64"),
        (lambda env: begun(env).step(torch.zeros(8, 7, device="meta")), "on meta"),
        (lambda env: begun(env).step({"robot": torch.zeros(8, 7)}), "must be a tensor"),
        (lambda env: begun(env, agent="both").step(torch.zeros(8, 7)), "a dict of robot and human"),
    ],
)
def test_what_torch_cannot_have_is_refused_in_one_line(env, call, words):
    with pytest.raises(assistax.UsageError, match=words) as error:
        call(env)
    assert "\n" not in str(error.value)


def test_a_torch_that_cannot_reach_jaxs_device_is_refused_in_one_line(env, monkeypatch):
    def refuse(array):
        raise AssertionError("Torch not compiled with CUDA enabled\nmore")

    monkeypatch.setattr(torch, "from_dlpack", refuse)
    with pytest.raises(assistax.UsageError, match=r"not compiled with CUDA.*JAX_PLATFORMS=cpu") as error:
        TorchEnv(env)
    assert "\n" not in str(error.value)


def begun(env, **settings):
    many = TorchEnv(env, NUM_ENVS, **settings)
    many.reset(seed=0)
    return many


# -- TorchRL ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rl():
    return pytest.importorskip("assistax.adapters.torchrl", exc_type=assistax.UsageError)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("agent", ["human", "both"])
def test_torchrls_checker(env, rl, agent):
    from torchrl.envs.utils import check_env_specs

    many = rl.TorchRLEnv(env, NUM_ENVS, agent=agent)
    check_env_specs(many, break_when_any_done="both", seed=0)


@pytest.mark.filterwarnings("ignore")
def test_torchrls_rollouts_are_what_the_tensors_are(env, rl):
    """Over two ends; episodes that have ended begin as the step drew them, others by a reset of their own."""
    many, plain = rl.TorchRLEnv(env, NUM_ENVS, agent="both"), TorchEnv(env, NUM_ENVS, agent="both")
    many.set_seed(0)
    took = many.rollout(2 * LENGTH + 1, break_when_any_done=False)
    obs = plain.reset(seed=0)
    for i in range(2 * LENGTH + 1):
        now = took[:, i]
        step = plain.step({agent: now[agent, "action"][:, 0] for agent in env.agents})
        for agent in env.agents:
            assert (now[agent, "observation"][:, 0] == obs[agent]).all()
            assert (now["next", agent, "observation"][:, 0] == step.info["final_observation"][agent]).all()
            assert (now["next", agent, "reward"][:, 0, 0] == step.reward).all()
        assert (now["next", "truncated"][:, 0] == step.truncated).all()
        obs = step.obs
    mask = torch.arange(NUM_ENVS) < 3
    fresh = many.reset(now["next"].clone().set("_reset", mask.unsqueeze(1)))
    changed = (fresh["robot", "observation"] != now["next", "robot", "observation"]).flatten(1).any(1)
    assert changed.tolist() == mask.tolist()
