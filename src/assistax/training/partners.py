"""Who plays the seats that do not learn: a scripted policy, or one that was trained before and is frozen."""

from pathlib import Path

import jax
import jax.numpy as jnp
from assistax.learning.seats import Partner
from assistax.training.run_folder import learned, read_config

from assistax.env import Env
from assistax.errors import UsageError, choose
from assistax.policies import scripted_policy
from assistax.training.configuration import TrainConfig, trained_env
from assistax.training.team_file import load_team, trained_file


def find_partners(config: TrainConfig, env: Env) -> dict[str, Partner]:
    """By agent, who plays the seats that do not learn."""
    partners = {}
    for text in config.partners:
        agent, equals, name = text.partition("=")
        if not equals:
            raise UsageError(f"A partner is AGENT=WHO, for example human=still, not {text!r}.")
        choose("agent", agent, env.agents)
        partners[agent] = find_partner(name, env, agent)
    return partners


def find_partner(name: str, env: Env, agent: str) -> Partner:
    """Who plays a seat that does not learn.

    Args:
      name: a scripted policy (see `policies.scripted_policy`), a team file of the same task, "trained" for the one in
        the package, or a run folder of the same task: its policies for that seat, as they acted in training; every
        episode draws one of its seeds.
      env: where.
      agent: the seat.
    """
    if name == "trained" or name.endswith(".safetensors"):
        policy, params = load_team(trained_file(env.name) if name == "trained" else Path(name))[1][agent]
        return Partner(policy, jax.tree.map(lambda x: x[None], params))
    if Path(name).is_dir():
        return _of_run(Path(name), env, agent)
    try:
        return Partner(scripted_policy(name, env, agent))
    except UsageError as error:
        raise UsageError(f"{error} Or name a run folder.") from None


def _of_run(folder: Path, env: Env, agent: str) -> Partner:
    config = read_config(folder)
    there, trainer = trained_env(config)
    if there.name != env.name or there.observation_sizes[agent] != env.observation_sizes[agent]:
        raise UsageError(f"{folder} cannot play the {agent} here: its task or what it observes is another.")
    if agent not in trainer.learners:
        who = dict(text.split("=", 1) for text in config.partners)[agent]
        raise UsageError(f"The {agent} of {folder} did not learn; name who played it: {agent}={who}.")
    params = [one[agent] for one in learned(folder, config, trainer)]
    return Partner(trainer.policy(deterministic=False), jax.tree.map(lambda *xs: jnp.stack(xs), *params), len(params))
