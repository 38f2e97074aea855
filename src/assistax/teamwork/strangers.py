"""Who has met whom in training: held-out partners must be strangers, and best responses must not."""

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from assistax.errors import UsageError
from assistax.policies import Mixed, Player
from assistax.policies.habits import ALSO, HABITS, Habits
from assistax.policies.people import offer
from assistax.teamwork.crossplay import check_alike
from assistax.teamwork.gather import selves_of
from assistax.training.configuration import stored_config
from assistax.training.partners import split_pair
from assistax.training.population import Population, self_of
from assistax.training.run import Run


def check_robots(runs: Sequence[Run], populations: Mapping[str, Population]) -> None:
    """Raise UsageError unless the robots of these runs learned, in the task of the partners, with the same settings."""
    for population in populations.values():
        for run in runs:
            if run.config.task != population.task:
                raise UsageError(f"{run.folder} is of {run.config.task}, the partners are of {population.task}.")
            if "robot" not in run.trainer.learners:
                raise UsageError(f"The robot of {run.folder} did not learn; there is nothing to measure.")
    check_alike([(run.folder, run.env) for run in runs], free=["env.clock"])  # a robot's own affair


def check_strangers(runs: Sequence[Run], populations: Mapping[str, Population]) -> None:
    """Raise UsageError if a robot has met somebody of any part but "train"."""
    for part, population in populations.items():
        for run in runs if part != "train" else ():
            if met := [one for one, known in zip(population.ids, knows(run, population), strict=True) if known]:
                raise UsageError(
                    f"{run.folder} was trained with {met[0][:12]}, a partner of the {part}, or with another self of it."
                )


def knows(run: Run, population: Population) -> list[bool]:
    """By member, whether the run's robots were trained with that person, or with an earlier or later self of it.

    People are told by what they do, their actors' weights, whatever they were called: a run's partner may have been
    another run, a team file or a population, or the person that learned beside the robot; and by how they were trained,
    as a training may have gone on since: see `self_of`. Habits are told by their names, whatever the body. Who it met
    in the run that it began with, it has met.
    """
    if run.start is not None:
        before = knows(Run.open(run.start), population)
        return [a or b for a, b in zip(before, _met(run, population), strict=True)]
    return _met(run, population)


def _met(run: Run, population: Population) -> list[bool]:
    partner = run.partners.get("human")
    names = [ALSO.get(name, name) for agent, name in map(split_pair, run.config.partners) if agent == "human"]
    people = [partner.player] if partner is not None else [team["human"] for team in run.teams()]
    met = {_fingerprint(actor) for person in people for actor in _actors(person)}
    selves = set()
    if partner is None:
        selves = selves_of(run.config)
    elif partner.population is not None:
        selves = {self_of(row) for row in partner.population.rows}
    elif partner.trained is not None:
        selves = selves_of(stored_config(partner.trained, f"the partner of {run.folder}"))
    ways = offer(run.env).ways
    habits = [_acts(vars(HABITS[name]), ways) for name in names if name in HABITS]
    habits += [_acts(habit, ways) for person in people for habit in _habits(person)]
    return [
        _acts(vars(HABITS[row["habit"]]), ways) in habits
        if "habit" in row
        else self_of(row) in selves or _fingerprint(population.member(row)["human"]["actor"]) in met
        for row in population.rows
    ]


def _actors(player: Player) -> list:
    """Its members' actors; none of a scripted player."""
    if isinstance(player, Mixed):
        return [actor for one in player.players for actor in _actors(one)]
    if not isinstance(player.params, dict) or "actor" not in player.params:
        return []
    return [player.member(i)["actor"] for i in range(player.members)]


def _habits(player: Player) -> list[Mapping[str, Any]]:
    """Of a player's members who have a habit."""
    if isinstance(player, Mixed):
        return [habit for one in player.players for habit in _habits(one)]
    return [player.member(i) for i in range(player.members)] if isinstance(player.policy, Habits) else []


def _acts(habit: Mapping[str, Any], ways: int) -> dict[str, np.float32]:
    """What somebody with a habit does in a task with so many ways to offer, from the last of which it goes on anew."""
    acts = {key: np.float32(value) for key, value in habit.items()}
    return acts | {"way": acts["way"] % ways}


def _fingerprint(actor: Any) -> bytes:
    """Of an actor's weights in half precision, as populations store them."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(actor):
        weights = np.asarray(leaf, np.float16)
        digest.update(repr(weights.shape).encode() + weights.tobytes())
    return digest.digest()
