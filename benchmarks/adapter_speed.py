"""What an adapter costs: environment steps per second, as a share of the functional loop's.

uv run --extra torchrl python benchmarks/adapter_speed.py

All step the same environments with the same actions beside a still human, for one episode a round, its reset included.
They take turns in every round, and the share is the median over rounds of that of the round: whatever else the machine
does meets all of them. The functional loop is `jax.lax.scan` over `jax.vmap(env.step)`.
"""

import sys
import time
from collections.abc import Callable

import jax
import numpy as np
import tyro

from assistax.cli.common import Count, Task
from assistax.env import Env, make
from assistax.errors import AssistaxError
from assistax.results.comparison import markdown

Run = Callable[[], object]  # steps all environments through one episode


def functional(env: Env, actions: dict[str, np.ndarray], step: Callable | None = None) -> Run:
    """Pure functions in a scan; `step` of one environment returns (observations, state, ...)."""
    n, step = len(actions["robot"]), step or env.step
    keys = jax.random.split(jax.random.key(0), n)

    @jax.jit
    def episode(state, actions):
        def one(state, _):
            obs, state, rewards, *_ = jax.vmap(step)(keys, state, actions)
            return state, (obs, rewards["robot"])

        state, (obs, rewards) = jax.lax.scan(one, state, length=env.episode_length)
        return state, obs["robot"].sum() + rewards.sum()

    return going_on(jax.jit(jax.vmap(env.reset))(keys)[1], episode, actions)


def going_on(state, episode: Callable, actions) -> Run:
    def run():
        nonlocal state
        state, told = jax.block_until_ready(episode(state, actions))
        return told

    return run


def jaxmarl(env: Env, actions: dict[str, np.ndarray]) -> Run:
    from assistax.adapters.jaxmarl import MultiAgent

    return functional(env, actions, MultiAgent(env, same_sizes=False).step)


def brax(env: Env, actions: dict[str, np.ndarray], own_wrappers: bool = False) -> Run:
    from brax.envs.wrappers import training

    from assistax.adapters.brax import AgentEnv, wrap

    many = (training.wrap if own_wrappers else wrap)(AgentEnv(env), episode_length=env.episode_length)

    @jax.jit
    def episode(state, action):
        def one(state, _):
            state = many.step(state, action)
            return state, (state.obs, state.reward)

        state, (obs, rewards) = jax.lax.scan(one, state, length=env.episode_length)
        return state, obs.sum() + rewards.sum()

    keys = jax.random.split(jax.random.PRNGKey(0), len(actions["robot"]))
    return going_on(jax.jit(many.reset)(keys), episode, actions["robot"])


def stepped(env: Env, many, actions) -> Run:
    """From Python; the batched ones reset by themselves."""
    many.reset(seed=0)

    def run():
        for _ in range(env.episode_length):
            many.step(actions)

    return run


def gymnasium(env: Env, actions: dict[str, np.ndarray]) -> Run:
    from assistax.adapters.gymnasium import AgentVectorEnv

    many = AgentVectorEnv(env, len(actions["robot"]), autoreset_mode="SameStep")
    return stepped(env, many, actions["robot"])


def torch(env: Env, actions: dict[str, np.ndarray]) -> Run:
    from torch import from_numpy

    from assistax.adapters.torch import TorchEnv

    many = TorchEnv(env, len(actions["robot"]))
    return stepped(env, many, from_numpy(actions["robot"]).to(many.device))


def torchrl(env: Env, actions: dict[str, np.ndarray]) -> Run:
    from torch import from_numpy

    from assistax.adapters.torchrl import TorchRLEnv

    many = TorchRLEnv(env, len(actions["robot"]))
    action, now = from_numpy(actions["robot"]).to(many.device), many.reset()

    def run():
        nonlocal now
        for _ in range(env.episode_length):
            _, now = many.step_and_maybe_reset(now.set("action", action))

    return run


def gymnasium_single(env: Env, actions: dict[str, np.ndarray]) -> Run:
    from assistax.adapters.gymnasium import AgentEnv

    return reset_and_stepped(env, AgentEnv(env), actions["robot"][0])


def pettingzoo(env: Env, actions: dict[str, np.ndarray]) -> Run:
    from assistax.adapters.pettingzoo import parallel_env

    return reset_and_stepped(env, parallel_env(env), {agent: action[0] for agent, action in actions.items()})


def reset_and_stepped(env: Env, one, actions) -> Run:
    def run():
        one.reset()
        for _ in range(env.episode_length):
            one.step(actions)

    return run


BATCHED = {
    "functional loop": functional,
    "JaxMARL": jaxmarl,
    "Brax, `wrap`": brax,
    "Brax, its own wrappers": lambda env, actions: brax(env, actions, own_wrappers=True),
    "PyTorch": torch,
    "TorchRL": torchrl,
    "Gymnasium, batched": gymnasium,
}
SINGLE = {"functional loop": functional, "Gymnasium": gymnasium_single, "PettingZoo": pettingzoo}


def shares(env: Env, contenders: dict[str, Callable], num_envs: int, rounds: int) -> list[list[str]]:
    """Rows of the table."""
    rng = np.random.default_rng(0)
    actions = {
        agent: rng.uniform(-1, 1, (num_envs, size)).astype(np.float32) for agent, size in env.action_sizes.items()
    }
    actions["human"][:] = 0.0
    runs = {name: contender(env, actions) for name, contender in contenders.items()}
    for run in runs.values():
        run()  # compiles
    seconds = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            began = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - began)
    reference = np.array(seconds["functional loop"])
    rows = []
    for name, took in seconds.items():
        rate = num_envs * env.episode_length / np.median(took)
        share = reference / np.array(took)
        rows.append(
            [name, str(num_envs), f"{rate:,.0f}", f"{np.median(share):.0%}", f"{share.min():.0%}–{share.max():.0%}"]
        )
    return rows


def compare(
    task: Task = "scratch-v1",
    *,
    num_envs: Count = 256,
    episode_length: Count = 100,
    rounds: Count = 7,
    engine: str = "auto",
) -> None:
    """Measure the adapters beside the functional loop.

    Args:
      task: `assistax tasks` lists them.
      num_envs: environments side by side, of the batched adapters.
      episode_length: steps of an episode.
      rounds: how often each is measured, in turns.
      engine: auto, mujoco, warp or mjx.
    """
    env = make(task, engine, episode_length=episode_length)
    rows = shares(env, BATCHED, num_envs, rounds) + shares(env, SINGLE, 1, rounds)
    print(markdown(["adapter", "environments", "steps/s", "of the functional loop", "over rounds"], rows))


if __name__ == "__main__":
    try:
        tyro.cli(compare)
    except AssistaxError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
