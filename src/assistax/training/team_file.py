"""Team files: the policies of one trained team in one small file, with all that is needed to play them.

The best team of every task is part of the package: `assistax play TASK`.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from assistax.env import Env
from assistax.errors import UsageError
from assistax.files import mismatch
from assistax.formats import TEAM
from assistax.policies import Player, Team
from assistax.settings import with_settings
from assistax.tasks import TASKS, task_spec
from assistax.training.checkpoint import EVERYTHING, load_checkpoint, read_metadata, save_checkpoint
from assistax.training.configuration import TrainConfig, check_settings, stored_config, to_json, trained_env

TRAINED = Path(__file__).parents[1] / "trained"


def trained_file(task: str) -> Path:
    """The team that comes with the package for this task; for a bare name that of the newest version that has one."""
    newest = task_spec(task)
    versions = [newest] if task == newest.id else [spec for spec in TASKS.values() if spec.name == newest.name]
    for spec in sorted(versions, key=lambda spec: spec.version, reverse=True):
        if (path := TRAINED / f"{spec.id}.safetensors").exists():
            return path
    there = [name for name in TASKS if (TRAINED / f"{name}.safetensors").exists()]
    raise UsageError(f"No trained team comes with {task} yet; there is one for {', '.join(there) or 'none'}.")


def save_team(path: Path, team: Team, config: TrainConfig, measured: dict[str, Any] | None = None) -> None:
    """Write a team that was trained by this configuration, and what was measured of it, if anything was.

    Weights in half precision: tens of KB, and no more rounding than a small change of the observation.
    """
    if path.suffix != ".safetensors":
        raise UsageError(f"A team file is called NAME.safetensors, not {path.name!r}.")
    if absent := ", ".join(text.partition("=")[0] for text in config.partners):
        raise UsageError(f"Only whole teams can be exported; in this run the {absent} did not learn.")
    params = {agent: in_half(player.member(0)) for agent, player in team.items()}
    about = {"team": to_json(dataclasses.replace(config, num_seeds=1))}
    save_checkpoint(path, params, about | ({"measured": measured} if measured else {}))


def in_half(params: Any) -> Any:
    """What is called "actor" in half precision; other numbers, as a normaliser's, may be beyond that."""
    if not isinstance(params, dict) or "actor" not in params:
        return params
    return params | {"actor": jax.tree.map(lambda x: x.astype(jnp.float16), params["actor"])}


def read_team(path: Path) -> TrainConfig:
    """What the team in a file was trained for."""
    about = read_metadata(path)
    if isinstance(about, dict) and "team" not in about:
        kind = "a partner in a run's folder" if "partner" in about else "a checkpoint"
        raise UsageError(f"{path} is {kind}, not a team; give its run folder.")
    if wrong := mismatch(about, TEAM):
        raise UsageError(f"{path} is damaged: in its metadata, {wrong}.")
    return stored_config(about["team"], f"the metadata of {path}")


def read_measured(path: Path) -> dict[str, Any] | None:
    """What the team in a file reached when its training ended, see Run.measured; None if the file does not say."""
    read_team(path)
    return read_metadata(path).get("measured")


def load_team(path: Path, settings: Mapping[str, Any] | None = None, engine: str | None = None) -> tuple[Env, Team]:
    """The team in a file, and the environment it was trained in but for `settings`."""
    check_settings(settings or {})
    config = read_team(path)
    if engine is not None:
        config = dataclasses.replace(config, engine=engine)
    config = with_settings(config, settings or {})
    env, trainer = trained_env(config)
    params, policy = (
        load_checkpoint(path, params_like(trainer), finite=EVERYTHING),
        trainer.policy(config.deterministic),
    )
    return env, {agent: Player.of(policy, params[agent]) for agent in env.agents}


def params_like(trainer: Any) -> dict[str, Any]:
    """By learner, shapes and dtypes of the parameters of `trainer.policy()`."""
    return jax.eval_shape(lambda key: trainer.policy_params(trainer.init(key)), jax.random.key(0))
