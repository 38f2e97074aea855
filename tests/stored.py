"""Run folders and team files with random weights, made without training or compiling."""

from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from assistax.pytree import pytree
from assistax.training import loop
from assistax.training.checkpoint import save_checkpoint
from assistax.training.configuration import TrainConfig, configure, to_json, trained_env
from assistax.training.run import Run
from assistax.training.seeds import Seeds
from assistax.training.team_file import params_like

SMALL = {"ppo.num_steps": 8, "ppo.num_minibatches": 2, "ppo.update_epochs": 1, "ppo.hidden": (8, 8)}
SMALL |= {"env.episode_length": 16}


@pytree
class State:
    """The part of a trainer's state that plays."""

    params: Any
    normalizer: Any


def small(task="scratch", settings=None, **choices) -> TrainConfig:
    return configure(task, SMALL | (settings or {}), num_envs=8, engine="mujoco", **choices)


def randomly(like, seed=0):
    """Arrays with the shapes of `like`."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda x: rng.uniform(0.5, 1.5, x.shape).astype(x.dtype), like)


@contextmanager
def without_pictures():
    """Trainings end without curve and film, which take as long as a small training."""
    with pytest.MonkeyPatch.context() as patch:
        for picture in ("results.figures.learning_curve", "evaluation.film.film"):
            patch.setattr(f"assistax.{picture}", lambda *_, **__: None)
        yield


def train_without_pictures(run: Run):
    with without_pictures():
        return loop.train(run)


def stored_run(folder: Path, config: TrainConfig, seed=0) -> Run:
    """A run folder with a checkpoint that can play but not go on."""
    run = Run.create(config, folder)
    store_checkpoint(run, 64, seed)
    return run


def store_checkpoint(run: Run, steps: int, seed=0) -> Path:
    like = Seeds(run.config.seeds).like(run.trainer.init)
    about = {"task": run.config.task, "algorithm": run.config.algorithm, "steps": steps, "seconds": {}}
    path = run.folder / "checkpoints" / f"step_{steps:012d}.safetensors"
    save_checkpoint(path, State(randomly(like.params, seed), randomly(like.normalizer, seed)), about)
    return path


def stored_team(path: Path, config: TrainConfig, seed=0) -> Path:
    _, trainer = trained_env(config)
    save_checkpoint(path, randomly(params_like(trainer), seed), {"team": to_json(config)})
    return path
