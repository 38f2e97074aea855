"""The frozen partners, who do not learn: scripted policies, or policies that were trained before.

A run keeps its own copy of a trained partner, partners/AGENT.safetensors, or of a population, partners/AGENT/. The
copy's hash stands in the run's configuration: whatever becomes of the folder or file that the partner came from, the
run continues with the same partner.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from assistax.env import Env
from assistax.errors import UsageError, choose
from assistax.files import writing
from assistax.formats import PARTNER
from assistax.learning.trainer import Trainer
from assistax.policies import Player, scripted_player
from assistax.policies.habits import HABITS
from assistax.training import splits
from assistax.training.checkpoint import EVERYTHING, content_hash, load_checkpoint, read_metadata, save_checkpoint
from assistax.training.configuration import TrainConfig, read_config, stored_config, to_json, trained_env
from assistax.training.population import Population, is_population
from assistax.training.run_folder import learned
from assistax.training.team_file import params_like, read_team, trained_file


@dataclass(frozen=True)
class Partner:
    """A frozen partner and, if it was trained, all that a copy of it must say."""

    player: Player
    deterministic: bool = False  # whether it acts without noise
    trained: dict[str, Any] | None = None  # the configuration of its training, as JSON
    population: Population | None = None  # or who all its members are


GIVEN = "given"  # the name of a partner that is one's own Python object


def find_partners(
    config: TrainConfig, env: Env, folder: Path, players: Mapping[str, Player] | None = None
) -> dict[str, Partner]:
    """By agent, for the run in `folder`: from its copies if it has them.

    `players` are those that have no name; they have to be given again whenever the run is opened.
    """
    players = dict(players or {})
    copies = dict(split_pair(text) for text in config.partner_copies)
    partners: dict[str, Partner] = {}
    for text in config.partners:
        agent, name = split_pair(text)
        choose("agent", agent, env.agents)
        if agent in partners:
            raise UsageError(f"The {agent} has two partners; name one, which may be a population of several.")
        if name == GIVEN:
            if agent not in players:
                raise UsageError(
                    f"The {agent} of {folder} is a player that Python code has made; open it there, with "
                    f'Run.open(folder, players={{"{agent}": player}}).'
                )
            players[agent].check(env)
            partners[agent] = Partner(players[agent])
        elif agent in copies:
            partners[agent] = _of_copy(folder, copies[agent], env, agent, name)
        else:
            partners[agent] = find_partner(name, env, agent)
    return partners


def keep_partners(partners: Mapping[str, Partner], folder: Path) -> tuple[str, ...]:
    """Write copies of trained partners into a run's folder; returns the run's `TrainConfig.partner_copies`."""
    copies = []
    for agent, partner in partners.items():
        if partner.population is not None:
            place = _path(folder, agent).with_suffix("")
            partner.population.save(place)
            copies.append(f"{agent}={partner.population.hash}")
        if partner.trained is not None:
            path, player = _path(folder, agent), partner.player
            with writing(path):
                path.parent.mkdir(exist_ok=True)
            about = {"partner": partner.trained, "members": player.members, "deterministic": partner.deterministic}
            copies.append(f"{agent}={save_checkpoint(path, {agent: player.params}, about)}")
    return tuple(copies)


def find_partner(name: str | Population, env: Env, agent: str) -> Partner:
    """A frozen partner.

    Args:
      name: a scripted policy (see `policies.scripted_policy`); for the human, a habit (see `policies.habits`);
        "trained", the team in the package; a team file of the same task; a run folder of the same task: its policies
        for that agent, as they acted in training, of which every episode draws one seed; or a population of the same
        task or a part of it, "POP" or "POP:KIND/PART", or the Population itself, whose people `env` must have (see
        `people_of`).
      env: where.
      agent: whom it plays.

    Raises:
      UsageError: there is nobody of that name, or of another task, or who observes or does something else.
    """
    if isinstance(name, Population):
        return _of_population(name, "the population", env, agent)
    if name == "trained":
        return _of_team(trained_file(env.name), env, agent)
    if name.endswith(".safetensors"):
        return _of_team(Path(name), env, agent)
    if is_population(name):
        return _of_population(splits.named(name)[1], name, env, agent)
    if Path(name).is_dir() and not (agent == "human" and name in HABITS):
        return _of_run(Path(name), env, agent)
    try:
        return Partner(scripted_player(name, env, agent))
    except UsageError as error:
        raise UsageError(f"{error} Or name a habit, a run folder, a team file or a population.") from None


def _check_task(task: str, place: Path | str, env: Env, agent: str) -> None:
    if task != env.name:
        raise UsageError(f"{place} is of {task} and cannot play the {agent} in {env.name}; name the task {task}.")


def _of_population(population: Population, place: str, env: Env, agent: str) -> Partner:
    _check_task(population.task, place, env, agent)
    mine = env.config.human.people
    if agent == "human" and mine != population.people:
        raise UsageError(
            f"The members of {place} bring their bodies and preferences along: env.human.people must be "
            f"theirs{', and is another list' if mine != 'none' else ''}."
        )
    population.check_observations(agent, env, place)
    player = population.partner(agent, by_person=agent == "human", env=env)
    return Partner(player, population=population)


def _of_team(path: Path, env: Env, agent: str) -> Partner:
    config = read_team(path)
    trainer = _trainer(config, path, env, agent)
    params = load_checkpoint(path, params_like(trainer)[agent], f"['{agent}']", finite=EVERYTHING)
    return _trained(trainer, [params], config.deterministic, to_json(config))


def _of_run(folder: Path, env: Env, agent: str) -> Partner:
    config = read_config(folder)
    trainer = _trainer(config, folder, env, agent)
    params = [one[agent] for one in learned(folder, config, trainer)]
    return _trained(trainer, params, False, to_json(config))


def _of_copy(folder: Path, expected: str, env: Env, agent: str, name: str) -> Partner:
    """From the run's own copy; of a result, which has none, from the population of this name, if it is still that."""
    path = _path(folder, agent)
    if not path.parent.is_dir():
        if is_population(name) and (population := splits.named(name)[1]).hash == expected:
            return _of_population(population, name, env, agent)
        raise UsageError(
            f"{folder} has no copy of its {agent}, in a folder partners, and {name} is not, or no longer, the "
            "population that it was begun with."
        )
    if path.with_suffix("").is_dir():
        population = Population.load(path.with_suffix(""))
        if population.hash != expected:
            raise UsageError(f"{path.with_suffix('')} is not the population that this run was begun with; restore it.")
        return _of_population(population, str(path.with_suffix("")), env, agent)
    about = read_metadata(path, PARTNER)
    if content_hash(path) != expected:
        raise UsageError(f"{path} is not the partner that this run was begun with; restore it from a copy.")
    config = stored_config(about["partner"], f"the metadata of {path}")
    trainer = _trainer(config, path, env, agent)
    members, one = about["members"], params_like(trainer)[agent]
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct((members, *x.shape), x.dtype), one)
    params = load_checkpoint(path, like, f"['{agent}']", finite=EVERYTHING)
    deterministic = about["deterministic"]
    return Partner(Player(trainer.policy(deterministic), params, members), deterministic, about["partner"])


def _trained(trainer: Trainer, params: list[Any], deterministic: bool, trained: dict[str, Any]) -> Partner:
    return Partner(Player.of(trainer.policy(deterministic), *params), deterministic, trained)


def _trainer(config: TrainConfig, place: Path, env: Env, agent: str) -> Trainer:
    """The trainer of what lies at `place`, which must be able to play the agent."""
    _check_task(config.task, place, env, agent)
    there, trainer = trained_env(config)
    if agent not in trainer.learners:
        who = dict(split_pair(text) for text in config.partners)[agent]
        raise UsageError(f"The {agent} of {place} did not learn; name who played it: {agent}={who}.")
    for verb, ours, theirs in (
        ("observes", env.observation_sizes, there.observation_sizes),
        ("acts with", env.action_sizes, there.action_sizes),
    ):
        if ours[agent] != theirs[agent]:
            raise UsageError(
                f"The {agent} of {place} {verb} {theirs[agent]} numbers, but the {agent} here {ours[agent]}: "
                "its settings (preferences, for example) were others."
            )
    return trainer


def _path(folder: Path, agent: str) -> Path:
    return folder / "partners" / f"{agent}.safetensors"


def split_pair(text: str) -> tuple[str, str]:
    """("human", "still") of "human=still"."""
    agent, equals, name = text.partition("=")
    if not equals:
        raise UsageError(f"A partner is AGENT=WHO, for example human=still, not {text!r}.")
    return agent, name
