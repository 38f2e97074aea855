"""Why a robot of scratch fails, and whether people or itches decide it.

A robot meets every person of a part for the same itches. Failures are told apart by what the tool did: "stuck", it
touched the itch for a fifth of the episode or more, and for over half of that time it was slower than counts as
scratching; "away", it touched the itch for less than a fifth; "other". How much success varies from person to person
and from itch to itch is the standard deviation of their means.

uv run python benchmarks/scratch_failures.py results/teamwork/scratch-v1/runs/taught-best-response-8M-0 --out FILE
"""

import argparse
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from assistax.evaluation import turns
from assistax.evaluation.playing import EVALUATION_SEED
from assistax.stamp import stamp
from assistax.tasks.base import tool_force
from assistax.tasks.rewards import norm
from assistax.tasks.scratch import TOUCHING
from assistax.teamwork.report import meeting_env
from assistax.training import splits
from assistax.training.run import Run

OFTEN = 0.2  # of an episode


def played(run: Run, part: str, itches: int, seed: int, noisy: bool):
    """The people of a part, and of each with every itch: success, the steps on the itch, of these the slow ones."""
    population = splits.named(part)[1]
    env = meeting_env(run, population)
    task, config = env.task, env.task.config
    team = {"robot": run.teams(deterministic=not noisy)[0]["robot"], "human": population.partner("human", env=env)}

    def one(person, itch):
        begin_key, key = jax.random.split(jax.random.fold_in(jax.random.key(seed), itch))
        params, turn = turns.begin(env, team, begin_key, person)

        def step(turn, key):
            turn, *_ = turns.advance(env, team, params, turn, key)
            s, state = env.sensors(turn.state.physics), turn.state.task
            near = norm(task._to_itch(s, state)) < config.scratch_distance
            on = near & (norm(task.on_segment(s, state, tool_force)) > TOUCHING)
            return turn, (on, on & (task.tool_speed(s, state) < config.scratch_speed[0]))

        turn, (on, slow) = jax.lax.scan(step, turn, jax.random.split(key, env.config.episode_length))
        return task.success(turn.state.task), on.mean(), slow.sum() / jnp.maximum(on.sum(), 1)

    people = jnp.repeat(jnp.arange(len(population)), itches)
    found = jax.jit(jax.vmap(one))(people, jnp.tile(jnp.arange(itches), len(population)))
    return population, [np.asarray(x).reshape(-1, itches) for x in found]


def about(success, on, slow) -> dict:
    """Counts of failures by kind, and how much success varies."""
    failed, away = ~success, on < OFTEN
    stuck = failed & ~away & (slow > 0.5)
    counts = {"stuck": stuck.sum(), "away": (failed & away).sum(), "other": (failed & ~away & ~stuck).sum()}
    spread = {"between_people": success.mean(1).std(ddof=1), "between_itches": success.mean(0).std(ddof=1)}
    rounded = {name: round(float(x), 3) for name, x in spread.items()}
    return {"episodes": success.size, "success": round(float(success.mean()), 3), "failures": counts} | rounded


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--population", default="populations/scratch-v1:taught")
    parser.add_argument("--itches", type=int, default=16)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    found = {}
    for folder in given.runs:
        run, found[folder.name] = Run.open(folder), {}
        for draws in range(2):  # the first and the second so many itches
            for part in ("train", "test"):
                for noisy in (False, True):
                    people, arrays = played(
                        run, f"{given.population}/{part}", given.itches, EVALUATION_SEED + draws, noisy
                    )
                    trembling = np.array(["tremor" in row["person"]["disability"] for row in people.rows])
                    one = about(*arrays)
                    one |= {"success_trembling": round(float(arrays[0][trembling].mean()), 3)}
                    one |= {"success_others": round(float(arrays[0][~trembling].mean()), 3)}
                    found[folder.name][f"{part}, itches {draws + 1}{', with noise' * noisy}"] = one
                    print(folder.name, part, draws, noisy, one, flush=True)
    given.out.write_text(json.dumps({"itches": given.itches, "runs": found} | stamp(), indent=2, default=int) + "\n")


if __name__ == "__main__":
    main()
