"""What partners cost: rollouts and training of a robot beside a population, as a share of self-play's rates.

uv run python benchmarks/partner_speed.py

The people are the paper's 630 in all arrangements, so that the environment is the same. In self-play robot and human
learn; then the human is a population of as many members with random weights, of one architecture or of four. They take
turns in every round, and a share is the median over rounds of that of the round. Then everybody meets one robot, as
`assistax teamwork evaluate` has it, for so many episodes each.
"""

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from assistax.cli.common import Count, Task
from assistax.env import Env, make
from assistax.errors import AssistaxError
from assistax.evaluation.playing import Evaluator
from assistax.human.population import PAPER, people
from assistax.learning.ppo import PPO
from assistax.policies import Mixed, Player, Still
from assistax.results.comparison import markdown
from assistax.training.configuration import configure


def members(env: Env, number: int, algorithm: str = "ippo", recurrent: bool = False) -> Player:
    """So many people with random weights of one architecture."""
    trainer = configure(env.name, {}, algorithm=algorithm, recurrent=recurrent).trainer(env, {})
    shapes = jax.eval_shape(lambda key: trainer.policy_params(trainer.init(key))["human"], jax.random.key(0))
    rng = np.random.default_rng(0)
    params = jax.tree.map(lambda x: jnp.asarray(0.1 * rng.random((number, *x.shape), np.float32)), shapes)
    return Player(trainer.policy(deterministic=False), params, number)


def populations(env: Env) -> dict[str, Player]:
    """By name, a human for each of the people."""
    number = len(people(PAPER))
    one = members(env, number)
    kinds = [
        one,
        members(env, number, recurrent=True),
        members(env, number, "masac"),
        Player(Still(env.action_sizes["human"])),
    ]
    kind = np.arange(number) % len(kinds)
    mixed = Mixed.of_players(kinds, kind, np.where(kind < 3, np.arange(number), 0), by_person=True)
    return {
        "one architecture": Player(one.policy, one.params, number, by_person=True),
        "four architectures": mixed,
    }


class Training:
    """A PPO of the default preset, step by step."""

    def __init__(self, env: Env, partners: dict[str, Player]):
        config = configure(env.name, {"ppo.teachers": ()})
        self.trainer = PPO(env, config.method, config.num_envs, 100, partners)
        self.collect, self.improve = jax.jit(self.trainer.collect), jax.jit(self.trainer.improve)
        self.state = jax.jit(self.trainer.init)(jax.random.key(0))

    def __call__(self) -> np.ndarray:
        """Seconds of one rollout and of one iteration."""
        marks = [time.perf_counter()]
        self.state, batch = jax.block_until_ready(self.collect(self.state))
        marks.append(time.perf_counter())
        self.state, _ = jax.block_until_ready(self.improve(self.state, batch))
        return np.array([marks[1], time.perf_counter()]) - marks[0]


def compare(task: Task = "feeding", rounds: Count = 8, episodes: Count = 4) -> None:
    """Print rates and shares.

    Args:
      task: as `assistax tasks` lists them.
      rounds: of one iteration each.
      episodes: with each of the people, in the evaluation.
    """
    env = make(task, human={"people": PAPER})
    humans = populations(env)
    trainings = {"self-play": Training(env, {})} | {name: Training(env, {"human": one}) for name, one in humans.items()}
    for training in trainings.values():
        training()
    times = {name: [] for name in trainings}
    for _ in range(rounds):
        for name, training in trainings.items():
            times[name].append(training())
    rows, own = [], np.array(times["self-play"])
    for name, training in trainings.items():
        mine = np.array(times[name])
        rates = training.trainer.steps_per_iteration / np.median(mine, 0)
        shares = np.median(own / mine, 0)
        rows.append([name, *(f"{rate:,.0f} ({share:.0%})" for rate, share in zip(rates, shares, strict=True))])
    print(markdown(["people", "rollouts, steps/s (of self-play)", "training, steps/s (of self-play)"], rows))

    who = np.repeat(np.arange(len(people(PAPER))), episodes)
    play = Evaluator(env, len(who))
    robot = Player(Still(env.action_sizes["robot"]))
    for name, human in humans.items():
        began = time.perf_counter()
        play({"robot": robot, "human": human}, people=who)
        print(f"{name}: everybody met one robot for {episodes} episodes in {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    try:
        tyro.cli(compare)
    except AssistaxError as error:
        sys.exit(str(error))
