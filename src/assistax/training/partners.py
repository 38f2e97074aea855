"""The frozen partners, who do not learn: a scripted policy, or one that was trained before and is frozen."""

from pathlib import Path

from assistax.env import Env
from assistax.errors import UsageError, choose
from assistax.policies import Player, scripted_policy
from assistax.training.configuration import TrainConfig, trained_env
from assistax.training.run_folder import learned, read_config
from assistax.training.team_file import load_team, trained_file


def find_partners(config: TrainConfig, env: Env) -> dict[str, Player]:
    """By agent, the frozen partner."""
    partners = {}
    for text in config.partners:
        agent, equals, name = text.partition("=")
        if not equals:
            raise UsageError(f"A partner is AGENT=WHO, for example human=still, not {text!r}.")
        choose("agent", agent, env.agents)
        partners[agent] = find_partner(name, env, agent)
    return partners


def find_partner(name: str, env: Env, agent: str) -> Player:
    """A frozen partner.

    Args:
      name: a scripted policy (see `policies.scripted_policy`), a team file of the same task, "trained" for the one in
        the package, or a run folder of the same task: its policies for that agent, as they acted in training; every
        episode draws one of its seeds.
      env: where.
      agent: whom it plays.
    """
    if name == "trained" or name.endswith(".safetensors"):
        return load_team(trained_file(env.name) if name == "trained" else Path(name))[1][agent]
    if Path(name).is_dir():
        return _of_run(Path(name), env, agent)
    try:
        return Player(scripted_policy(name, env, agent))
    except UsageError as error:
        raise UsageError(f"{error} Or name a run folder.") from None


def _of_run(folder: Path, env: Env, agent: str) -> Player:
    config = read_config(folder)
    there, trainer = trained_env(config)
    if there.name != env.name or there.observation_sizes[agent] != env.observation_sizes[agent]:
        raise UsageError(f"{folder} cannot play the {agent} here: its task or what it observes is another.")
    if agent not in trainer.learners:
        who = dict(text.split("=", 1) for text in config.partners)[agent]
        raise UsageError(f"The {agent} of {folder} did not learn; name who played it: {agent}={who}.")
    params = [one[agent] for one in learned(folder, config, trainer)]
    return Player.of(trainer.policy(deterministic=False), *params)
