"""Our PPO beside that of Brax (Freeman et al., 2021), with which MuJoCo Playground trains.

uv run python benchmarks/reference_ppo.py

Only the robot learns; the human is still. All trainers see the same environments, staggered alike and with fresh
targets in every episode, for the same number of steps; their policies are played by `assistax.evaluation.play` on
the same seeds.
"""

import functools
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import tyro
from tqdm import tqdm

from assistax.cli.common import Task
from assistax.env import Env, make
from assistax.errors import AssistaxError, SimulationError, UsageError
from assistax.evaluation.playing import EVALUATION_SEED, play, summarize
from assistax.evaluation.statistics import seed_ci
from assistax.files import write_atomically
from assistax.learning.ppo import PPO, PPOConfig
from assistax.physics import check_faults
from assistax.policies import Player, Still
from assistax.results.comparison import markdown
from assistax.stamp import stamp
from assistax.training import presets

try:
    from brax.training.agents.ppo import train as brax_ppo
    from brax.training.agents.ppo.networks import make_ppo_networks
    from brax.training.networks import ACTIVATION, KERNEL_INITIALIZER

    from assistax.adapters.brax import AgentEnv, wrap
except ImportError:
    sys.exit("Brax is missing. Run this as: uv run python benchmarks/reference_ppo.py")

EPISODES = 64


class Trained(NamedTuple):
    """What a trainer hands back."""

    policy: Callable[[bool], Any]  # of whether it is deterministic
    params: Any
    steps: int  # environment steps it learned from
    seconds: list[float]  # of each iteration; the first ones compile


# -- ours ------------------------------------------------------------------------------------------


def train_ours(env: Env, config: PPOConfig, num_envs: int, steps: int, seed: int) -> Trained:
    iterations = -(-steps // (num_envs * config.num_steps))
    still = {"human": Player(Still(env.action_sizes["human"]))}
    trainer = PPO(env, config, num_envs, iterations, still)
    state = jax.jit(trainer.init)(jax.random.key(seed))
    collect, improve = jax.jit(trainer.collect), jax.jit(trainer.improve)
    seconds = []
    for _ in tqdm(range(iterations), leave=False):
        began = time.perf_counter()
        state, batch = collect(state)
        check_faults(batch["log"]["fault"], env.engine.name)
        state, _ = jax.block_until_ready(improve(state, batch))
        seconds.append(time.perf_counter() - began)
    steps = iterations * trainer.steps_per_iteration
    return Trained(trainer.policy, trainer.policy_params(state)["robot"], steps, seconds)


# -- Brax's ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BraxPolicy:
    """What Brax trained, as a policy of ours."""

    make: Callable
    deterministic: bool

    def initial_carry(self):
        return ()

    def act(self, params, carry, obs, reset, key):
        return self.make(params, self.deterministic)(obs, key)[0], carry


def by_name(setting: str, value: Any) -> Any:
    """The value of a network setting, or the function that it names."""
    if setting == "activation":
        return ACTIVATION[value]
    return KERNEL_INITIALIZER[value] if setting.endswith("init_fn") else value


def train_brax(env: Env, settings: dict[str, Any], steps: int, seed: int) -> Trained:
    """Train with `settings` of Brax's `train`; in its "networks", functions are given by name."""
    settings = dict(settings)
    networks = {name: by_name(name, value) for name, value in settings.pop("networks").items()}
    per_iteration = settings["batch_size"] * settings["num_minibatches"] * settings["unroll_length"]
    iterations = -(-steps // per_iteration)
    seconds, bar = [], tqdm(total=iterations, leave=False)

    def progress(_, metrics):
        if not np.isfinite(metrics["training/total_loss"]):
            raise SimulationError("The losses are no longer finite: the physics or Brax failed.")
        seconds.append(per_iteration / metrics["training/sps"])
        bar.update()

    with bar:
        make_policy, params, _ = brax_ppo.train(
            AgentEnv(env),
            num_timesteps=iterations * per_iteration,
            num_evals=iterations + 1,  # so that it reports after every iteration
            run_evals=False,
            num_eval_envs=1,
            # Environments start at different times of their episodes, as in PPO.init.
            wrap_env_fn=functools.partial(wrap, staggered=True),
            episode_length=env.episode_length,
            network_factory=functools.partial(make_ppo_networks, **networks),
            progress_fn=progress,
            max_devices_per_host=1,
            seed=seed,
            **settings,
        )
    return Trained(functools.partial(BraxPolicy, make_policy), params, iterations * per_iteration, seconds)


def in_brax_terms(config: PPOConfig, num_envs: int) -> dict[str, Any]:
    """Our settings for Brax's `train`, as far as it has them.

    It has one gradient norm for both networks where we have one each, does not clip normalised observations,
    starts the critic's last layer with the gain of the others, and explores independently at every step.
    """
    gain = {"scale": 2.0**0.5}
    return {
        "num_envs": num_envs,
        "unroll_length": config.num_steps,
        "num_minibatches": config.num_minibatches,
        "batch_size": num_envs // config.num_minibatches,
        "num_updates_per_batch": config.update_epochs,
        "learning_rate": config.learning_rate,
        "entropy_cost": config.entropy_coef,
        "discounting": config.gamma,
        "reward_scaling": 1.0 - config.gamma,
        "gae_lambda": config.gae_lambda,
        "clipping_epsilon": config.clip_eps,
        "vf_loss_coefficient": config.value_coef,
        "max_grad_norm": config.max_grad_norm,
        "normalize_observations": config.normalize_obs,
        "networks": {
            "policy_hidden_layer_sizes": config.hidden,
            "value_hidden_layer_sizes": config.hidden,
            "activation": config.activation,
            "distribution_type": "normal",
            "noise_std_type": "log",
            "init_noise_std": float(np.exp(config.initial_log_std)),
            "policy_network_kernel_init_fn": "orthogonal",
            "policy_network_kernel_init_kwargs": gain,
            "value_network_kernel_init_fn": "orthogonal",
            "value_network_kernel_init_kwargs": gain,
            "mean_kernel_init_fn": "orthogonal",
            "mean_kernel_init_kwargs": {"scale": 0.01},
        },
    }


# MuJoCo Playground's for PandaPickCubeCartesian, its task with the shortest training of a Panda, 5 M steps
# (mujoco_playground/config/manipulation_params.py); what it leaves out stays as Brax has it.
PLAYGROUND = {
    "num_envs": 1024,
    "unroll_length": 10,
    "num_minibatches": 8,
    "batch_size": 256,
    "num_updates_per_batch": 8,
    "learning_rate": 5e-4,
    "entropy_cost": 7.5e-3,
    "discounting": 0.97,
    "reward_scaling": 0.1,
    "max_grad_norm": 1.0,
    "normalize_observations": True,
    "networks": {"policy_hidden_layer_sizes": (256, 256), "value_hidden_layer_sizes": (256,) * 5},
}


# -- the comparison --------------------------------------------------------------------------------


def evaluated(env: Env, trained: Trained) -> dict[str, Any]:
    """How the robot does beside the still human, by its mean actions and by those it draws."""
    found = {}
    for name, deterministic in (("deterministic", True), ("sampled", False)):
        human = Still(env.action_sizes["human"])
        team = {"robot": Player.of(trained.policy(deterministic), trained.params), "human": Player(human)}
        summary = summarize(play(env, team, EPISODES))
        found[name] = {key: summary[key] for key in ("mean_return", "return_ci", "success_rate", "success_ci", "terms")}
    return found


def compare(
    task: Task = "scratch-v0",
    *,
    steps: int = 2_000_000,
    num_envs: int | None = None,
    seed: int = 0,
    num_seeds: int = 3,
    preset: str = "default",
    engine: str = "auto",
    out: Path = Path("results/compare/reference_ppo.json"),
) -> None:
    """Train our PPO and Brax's beside a still human, and compare what they reach.

    Three rows: "assistax" is ours; "brax" is theirs with the same networks, start and settings; "brax, playground"
    is theirs as MuJoCo Playground tuned it for a Panda.

    Args:
      task: `assistax tasks` lists them.
      steps: environment steps of each training; rounded up to whole iterations.
      num_envs: environments side by side, of the first two rows (default: the preset's).
      seed: first random seed.
      num_seeds: trainings per row.
      preset: of our settings.
      engine: auto, mujoco, warp or mjx.
      out: the result, written anew after each training; must not exist.
    """
    num_envs = presets.num_envs(preset, "ippo") if num_envs is None else num_envs
    for name, value in {"steps": steps, "num-envs": num_envs, "num-seeds": num_seeds}.items():
        if value < 1:
            raise UsageError(f"--{name} must be 1 or more, not {value}.")
    if out.exists():
        raise UsageError(f"{out} exists; name another --out, or move it away.")
    config = PPOConfig(**presets.preset(preset, "ippo", task))
    if num_envs % config.num_minibatches:
        raise UsageError(f"--num-envs must be a multiple of {config.num_minibatches}, the minibatches, not {num_envs}.")
    env = make(task, engine)
    same = in_brax_terms(config, num_envs)
    rows: dict[str, tuple[dict, Callable[[int], Trained]]] = {
        "assistax": (asdict(config), lambda seed: train_ours(env, config, num_envs, steps, seed)),
        "brax": (same, lambda seed: train_brax(env, same, steps, seed)),
        "brax, playground": (PLAYGROUND, lambda seed: train_brax(env, PLAYGROUND, steps, seed)),
    }
    origin = stamp()
    origin["versions"] |= {name: metadata.version(name) for name in ("brax", "flax")}
    report: dict[str, Any] = {
        "task": task,
        "engine": env.engine.name,
        "preset": preset,
        "num_envs": num_envs,
        "episodes": EPISODES,
        "evaluation_seed": EVALUATION_SEED,
        "rows": {name: {"settings": settings, "runs": []} for name, (settings, _) in rows.items()},
        **origin,
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    for one in range(seed, seed + num_seeds):  # rows take turns, so that all meet the same state of the machine
        for name, (_, train) in rows.items():
            trained = train(one)
            rate = round(trained.steps / len(trained.seconds) / float(np.median(trained.seconds)))
            about = {"seed": one, "steps": trained.steps, "env_steps_per_s": rate}
            runs = report["rows"][name]["runs"]
            runs.append(about | evaluated(env, trained))
            for mode in ("deterministic", "sampled"):
                returns = np.array([run[mode]["mean_return"] for run in runs])
                report["rows"][name][mode] = {"mean_return": float(returns.mean()), "seed_ci": seed_ci([returns])}
            write_atomically(out, json.dumps(report, indent=2).encode())
            print(f"{name}, seed {one}: {runs[-1]['deterministic']['mean_return']:.0f}", file=sys.stderr)
    print(table(report))


def table(report: dict[str, Any]) -> str:
    """Returns with 95 % intervals over seeds, the share of episodes with success, speed."""
    lines = []
    for name, row in report["rows"].items():
        runs = row["runs"]
        cells = [name, f"{runs[0]['steps']:,}", str(len(runs))]
        for mode in ("deterministic", "sampled"):
            ci = row[mode]["seed_ci"]
            cells.append(f"{row[mode]['mean_return']:.0f}" + (f" [{ci[0]:.0f}, {ci[1]:.0f}]" if ci else ""))
        cells.append(f"{np.mean([run['sampled']['success_rate'] for run in runs]):.0%}")
        cells.append(f"{np.median([run['env_steps_per_s'] for run in runs]):,.0f}")
        lines.append(cells)
    head = ["PPO", "steps", "seeds", "return", "return, sampled", "success, sampled", "env steps/s"]
    return markdown(head, lines)


if __name__ == "__main__":
    try:
        tyro.cli(compare)
    except AssistaxError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
