"""Runs: one training, one folder, resumable at any moment.

config.json           what was asked for
partners/             copies of the frozen partners that were trained, see partners.py
start/                the run whose networks it began with, see start.py
metrics.jsonl         evaluations.jsonl: see journal.py
checkpoints/          the newest two, each written whole or not at all; what is large lies in pieces, see pieces.py
learning_curve.png    summary.json    rollout.mp4    policies.safetensors
"""

import dataclasses
import json
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from assistax.devices import check_devices
from assistax.env import Env
from assistax.errors import UsageError
from assistax.files import read_json, write_json
from assistax.formats import CONFIG, SUMMARY
from assistax.policies import Player, Team
from assistax.settings import with_settings
from assistax.stamp import stamp_changes
from assistax.training.checkpoint import newest_checkpoint, read_metadata
from assistax.training.configuration import TrainConfig, check_settings, read_config, to_json
from assistax.training.memory import check_memory
from assistax.training.partners import GIVEN, find_partners, keep_partners
from assistax.training.run_folder import learned, playable, snapshot
from assistax.training.seeds import Seeds
from assistax.training.start import begin, keep_start


class Run:
    """A run folder, new or found.

    Args:
      folder: of the run.
      config: what is asked for.
      players: by agent, frozen partners that are one's own Python objects, beside those that `config` names.
    """

    def __init__(self, folder: Path, config: TrainConfig, players: Mapping[str, Player] | None = None):
        self.folder, self.config = folder, config
        self.env = Env(config.task, config.engine, config.env, config.task_config)
        self.iterations = config.iterations
        self.partners = find_partners(config, self.env, folder, players)
        self._frozen = {agent: partner.player for agent, partner in self.partners.items()}
        self.trainer = config.trainer(self.env, self._frozen)
        self.steps_per_iteration = self.trainer.steps_per_iteration
        points = range(1, config.evaluations)
        self.evaluate_at = {i * self.iterations // config.evaluations for i in points} - {0}  # iterations done
        self.seeds = Seeds(config.seeds)

    @classmethod
    def create(cls, config: TrainConfig, folder: Path | str, players: Mapping[str, Player] | None = None) -> "Run":
        """Make the folder; it must be new or empty. Raises UsageError for what cannot be trained here."""
        folder = Path(folder)
        given = tuple(f"{agent}={GIVEN}" for agent in players or {})
        config = dataclasses.replace(config, partners=config.partners + given)
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(f"{folder} is already in use; name another --out, or continue it with --resume {folder}.")
        run = cls(folder, dataclasses.replace(config, partner_copies=()), players)
        check_devices(config.devices, config.num_envs)
        check_memory(run.trainer, config.num_seeds)
        if config.start:
            jax.eval_shape(lambda key: run.init(key, Path(config.start)), jax.random.key(0))
        try:
            (folder / "checkpoints").mkdir(parents=True)
        except OSError as error:
            raise UsageError(f"Cannot write to {folder}: {error.strerror}.") from None
        try:
            if config.start:
                keep_start(Path(config.start), folder)
            run.config = dataclasses.replace(config, partner_copies=keep_partners(run.partners, folder))
            run.write_config()
        except BaseException:  # Ctrl-C, too: a folder without a configuration is of no use
            shutil.rmtree(folder, ignore_errors=True)
            raise
        return run

    @staticmethod
    def clear(folder: Path) -> None:
        """Remove what is left of a run whose process was killed while it made the folder."""
        if folder.is_dir() and not (folder / "config.json").exists() and newest_checkpoint(folder) is None:
            shutil.rmtree(folder)

    @property
    def start(self) -> Path | None:
        """The copy of the run that this one began with; None if it began with nothing."""
        if not self.config.start:
            return None
        if not (self.folder / "start").is_dir():
            raise UsageError(f"{self.folder} has lost its folder start, the run that it began with; restore it.")
        return self.folder / "start"

    def init(self, key: jax.Array, start: Path | None = None) -> Any:
        """The fresh state of a seed, with what it begins with."""
        start, state = start or self.start, self.trainer.init(key)
        return state if start is None else begin(self.config, self.trainer, start, state)

    def write_config(self, steps: int = 0) -> None:
        """Write config.json if it has changed, as when --steps prolongs a run.

        The stamp stays that of the beginning. If the run is continued at `steps` with another version of anything,
        "resumed" and a line on stderr say so.
        """
        path = self.folder / "config.json"
        before = read_json(path, CONFIG) if path.exists() else {}
        content = json.loads(json.dumps(to_json(self.config)))
        now = content["stamp"]
        if before:
            content["stamp"] = before.get("stamp", now)
            content["resumed"] = before.get("resumed", [])
            last = content["resumed"][-1]["stamp"] if content["resumed"] else content["stamp"]
            if changed := stamp_changes(last, now):
                print(f"{self.folder} was trained with {', '.join(changed)}.", file=sys.stderr)
                content["resumed"].append({"steps": steps, "stamp": now})
        if before != content:
            write_json(path, content)

    @classmethod
    def open(
        cls,
        folder: Path | str,
        settings: Mapping[str, Any] | None = None,
        players: Mapping[str, Player] | None = None,
        **changes,
    ) -> "Run":
        """Read a run folder; `changes` replace fields of its configuration, `settings` any by name ("ppo.gamma")."""
        check_settings(settings or {})
        config = read_config(folder := Path(folder))
        changes = {name: value for name, value in changes.items() if value is not None}
        return cls(folder, with_settings(dataclasses.replace(config, **changes), settings or {}), players)

    # -- what it has learned ---------------------------------------------------------------------

    def team(self, state: Any, deterministic: bool | None = None) -> Team:
        """The players of one seed; of its state only params and normalizer are read."""
        return self._team(self.trainer.policy_params(state), deterministic)

    def _team(self, learned: dict[str, Any], deterministic: bool | None) -> Team:
        """Learners, deterministic or not (None: as in the configuration), beside the frozen partners."""
        policy = self.trainer.policy(self.config.deterministic if deterministic is None else deterministic)
        return {agent: Player.of(policy, params) for agent, params in learned.items()} | self._frozen

    def newest_checkpoint(self) -> Path | None:
        """None if nothing has been saved yet."""
        return newest_checkpoint(self.folder)

    def teams(self, deterministic: bool | None = None) -> list[Team]:
        """The policies of each seed, from the newest checkpoint or, of a result without, in half precision."""
        params = learned(self.folder, self.config, self.trainer)
        return [self._team(mine, deterministic) for mine in params]

    def measured(self, seed: int) -> dict[str, Any] | None:
        """What the team of a seed reached at the end of training, as in summary.json; None before that.

        Also None in a run that has been prolonged and is past what its summary tells of.
        """
        path, checkpoint = self.folder / "summary.json", playable(self.folder)
        summary = read_json(path, SUMMARY) if path.exists() else {}
        if checkpoint is None or summary.get("steps") != read_metadata(checkpoint)["steps"]:
            return None
        about = {name: summary[name] for name in ("steps", "commit", "source", "hardware") if name in summary}
        return about | summary["evaluation"][list(self.seeds.seeds).index(seed)]

    def earlier_teams(self, steps: int, deterministic: bool | None = None) -> list[Team]:
        """The policies of each seed as they were at an evaluation; [] if none were kept there, see `snapshots`."""
        return [
            self._team(mine, deterministic) for mine in snapshot(self.folder, steps, self.config, self.trainer) or []
        ]
