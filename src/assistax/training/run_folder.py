"""What was trained, read from a run folder: the policies in its newest checkpoint, and earlier ones."""

import dataclasses
from pathlib import Path
from typing import Any

import jax

from assistax.errors import UsageError
from assistax.formats import CHECKPOINT
from assistax.tasks import stored_task
from assistax.training.checkpoint import EVERYTHING, load_checkpoint, newest_checkpoint, read_metadata, save_checkpoint
from assistax.training.configuration import TrainConfig
from assistax.training.seeds import Seeds
from assistax.training.team_file import in_half, params_like

POLICIES = "policies.safetensors"


def check_checkpoint(path: Path, config: TrainConfig) -> dict[str, Any]:
    """The metadata of a checkpoint, which must be of this task and algorithm."""
    about = read_metadata(path, CHECKPOINT)
    there = {"task": stored_task(about["task"]), "algorithm": about["algorithm"]}
    for name, value in there.items():
        if value != getattr(config, name):
            raise UsageError(f"{path} is of the {name} {value}, not {getattr(config, name)}.")
    return about


def playable(folder: Path) -> Path | None:
    """The newest checkpoint or, of a result without checkpoints, its POLICIES; None if there is neither."""
    kept = folder / POLICIES
    return newest_checkpoint(folder) or (kept if kept.exists() else None)


def learned(folder: Path, config: TrainConfig, trainer: Any) -> list[dict[str, Any]]:
    """By seed and learner the parameters for `trainer.policy()`, from what is `playable`."""
    path = playable(folder)
    if path is None:
        raise UsageError(f"{folder} has no checkpoint yet, nor {POLICIES}, which finished trainings leave.")
    check_checkpoint(path, config)
    if path.name == POLICIES:
        return _by_seed(path, config, trainer)
    like = Seeds(config.seeds).like(trainer.init)
    parts = {name: load_checkpoint(path, getattr(like, name), f".{name}") for name in ("params", "normalizer")}
    states = [jax.tree.map(lambda x, i=i: x[i], parts) for i in range(config.num_seeds)]
    return [trainer.policy_params(dataclasses.replace(like, **state)) for state in states]


def save_policies(folder: Path, config: TrainConfig, steps: int, policies: list[dict[str, Any]]) -> None:
    """Keep what the seeds know in the end, in half precision, for those who have the run without its checkpoints."""
    about = {"task": config.task, "algorithm": config.algorithm, "steps": steps, "seconds": {}}
    small = [{agent: in_half(params) for agent, params in one.items()} for one in policies]
    save_checkpoint(folder / POLICIES, _stacked(small), about)


def save_snapshot(folder: Path, steps: int, policies: list[dict[str, Any]]) -> None:
    """Keep what the seeds know at this step, parameters of `trainer.policy()` by learner."""
    path = folder / "snapshots" / f"step_{steps:012d}.safetensors"
    path.parent.mkdir(exist_ok=True)
    save_checkpoint(path, _stacked(policies), {"steps": steps})


def snapshot(folder: Path, steps: int, config: TrainConfig, trainer: Any) -> list[dict[str, Any]] | None:
    """What `save_snapshot` kept, by seed and learner; None where nothing was kept at this step."""
    path = folder / "snapshots" / f"step_{steps:012d}.safetensors"
    return _by_seed(path, config, trainer) if path.exists() else None


def _stacked(policies: list[dict[str, Any]]) -> dict[str, Any]:
    return jax.tree.map(lambda *seeds: jax.numpy.stack(seeds), *policies)


def _by_seed(path: Path, config: TrainConfig, trainer: Any) -> list[dict[str, Any]]:
    seeds = config.num_seeds
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct((seeds, *x.shape), x.dtype), params_like(trainer))
    stacked = load_checkpoint(path, like, finite=EVERYTHING)
    return [jax.tree.map(lambda x, i=i: x[i], stacked) for i in range(seeds)]
