"""Runs: one training, one folder, resumable at any moment.

config.json           what was asked for
metrics.jsonl         one line per iteration and seed
evaluations.jsonl     one line per evaluation and seed: what each of its episodes came to
checkpoints/          the newest two, each written whole or not at all
partners/             who was trained before and plays beside the learner, see partners.py
learning_curve.png    summary.json    rollout.mp4
"""

import dataclasses
import json
import math
import sys
import time
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation.film import film
from assistax.evaluation.playing import Evaluator, by_episode, summarize, typical
from assistax.files import read_json, read_rows, write_atomically, write_json
from assistax.formats import CONFIG, ROWS
from assistax.physics import check_faults
from assistax.policies import Team
from assistax.policies.player import Player
from assistax.results.figures import learning_curve
from assistax.settings import with_settings
from assistax.stamp import peak_memory_mb, stamp
from assistax.training.checkpoint import load_checkpoint, save_checkpoint
from assistax.training.clock import Clock, Stop, progress_bar
from assistax.training.configuration import TrainConfig, to_json
from assistax.training.partners import find_partners, keep_partners
from assistax.training.run_folder import check_checkpoint, learned, newest_checkpoint, read_config
from assistax.training.seeds import Seeds

CHECKPOINT_SECONDS = 60.0


class Run:
    """A run folder, new or found."""

    def __init__(self, folder: Path, config: TrainConfig):
        self.folder, self.config = folder, config
        self.env = Env(config.task, config.engine, config.env, config.task_config)
        self.iterations = config.iterations
        self.partners = find_partners(config, self.env, folder)
        self._frozen = {agent: partner.player for agent, partner in self.partners.items()}
        self.trainer = config.trainer(self.env, self._frozen)
        self.steps_per_iteration = self.trainer.steps_per_iteration
        points = range(1, config.evaluations)
        self.evaluate_at = {i * self.iterations // config.evaluations for i in points} - {0}  # iterations done
        self.seeds = Seeds(config.seeds)

    @classmethod
    def create(cls, config: TrainConfig, folder: Path) -> "Run":
        """Make the folder; it must be new or empty."""
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(f"{folder} is already in use; name another --out, or continue it with --resume {folder}.")
        run = cls(folder, dataclasses.replace(config, partner_copies=()))
        try:
            (folder / "checkpoints").mkdir(parents=True)
        except OSError as error:
            raise UsageError(f"Cannot write to {folder}: {error.strerror}.") from None
        run.config = dataclasses.replace(config, partner_copies=keep_partners(run.partners, folder))
        run._write_config()
        return run

    def _write_config(self) -> None:
        """Anew if it has changed, as when --steps prolongs a run; the stamp stays that of the beginning."""
        path = self.folder / "config.json"
        before = read_json(path, CONFIG) if path.exists() else {}
        content = json.loads(json.dumps(to_json(self.config)))
        if before | {"stamp": None} != content | {"stamp": None}:
            content["stamp"] = before.get("stamp", content["stamp"])
            write_json(path, content)

    @classmethod
    def open(cls, folder: Path, settings: Mapping[str, Any] | None = None, **changes) -> "Run":
        """Read a run folder; `changes` replace fields of its configuration, `settings` any by name ("ppo.gamma")."""
        config = read_config(folder)
        changes = {name: value for name, value in changes.items() if value is not None}
        return cls(folder, with_settings(dataclasses.replace(config, **changes), settings or {}))

    # -- training ------------------------------------------------------------------------------

    def train(self, seconds: float = math.inf) -> dict[str, Any] | None:
        """Train from the newest checkpoint, if there is one, to the end: the summary.

        None if it had to stop and save before, because of Ctrl-C or because `seconds` have passed.
        """
        if not (self.folder / "checkpoints").is_dir():
            raise UsageError(
                f"{self.folder} is a result without checkpoints, which cannot go on; train anew with --out."
            )
        self._write_config()
        state, done, spent = self._start()
        for name in ("metrics", "evaluations"):
            self._keep_rows(name, done * self.steps_per_iteration)
        collect, improve = self.seeds.jit(self.trainer.collect), self.seeds.jit(self.trainer.improve)
        total = self.iterations * self.steps_per_iteration * self.config.num_seeds
        clock, stop, engine = Clock(spent), Stop(seconds), self.env.engine
        collecting = "policy" if engine.name == "mujoco" else "collect"  # others are part of the same program
        with (
            stop,
            open(self.folder / "metrics.jsonl", "a") as log,
            progress_bar(total, done * total // self.iterations) as bar,
        ):
            saved = time.monotonic()
            leave = done == self.iterations
            while not leave:
                before = engine.seconds
                with clock(collecting):
                    state, batch = jax.block_until_ready(collect(state))
                clock.move(collecting, "physics", engine.seconds - before)
                batches = self.seeds.each(batch)
                for one in batches:
                    check_faults(one["log"]["fault"], self.env.engine.name)
                with clock("update"):
                    state, losses = jax.block_until_ready(improve(state, batch))
                done += 1
                rows = self._rows(done, clock, [one["log"] for one in batches], self.seeds.each(losses))
                log.write("".join(json.dumps(row) + "\n" for row in rows))
                log.flush()
                bar.update(total // self.iterations)
                ended = [row for row in rows if row["episodes"]]
                if ended:
                    mean = np.mean([row["episode"]["return"] for row in ended])
                    success = np.mean([row["episode"]["success"] for row in ended])
                    bar.set_postfix_str(f"return {mean:.0f}, success {success:.0%}", refresh=False)
                if done in self.evaluate_at:
                    with clock("evaluation"):
                        self._evaluate(done, map(self.team, self.seeds.each(state)))
                leave = done == self.iterations or stop.asked
                if leave or time.monotonic() - saved > CHECKPOINT_SECONDS:
                    self._save(state, done, clock)
                    saved = time.monotonic()
        if done < self.iterations:
            return None
        return self._finish(clock)

    def _start(self) -> tuple[Any, int, dict[str, float]]:
        """The newest checkpoint's state, or a fresh one; the iterations done and the seconds spent so far."""
        path = self.newest_checkpoint()
        if path is None:
            return self.seeds.init(self.trainer.init), 0, {}
        about = check_checkpoint(path, self.config)
        state = self.seeds.split(load_checkpoint(path, self.seeds.like(self.trainer.init)))
        return state, about["steps"] // self.steps_per_iteration, about["seconds"]

    def newest_checkpoint(self) -> Path | None:
        return newest_checkpoint(self.folder)

    def _save(self, state: Any, done: int, clock: Clock) -> None:
        steps = done * self.steps_per_iteration
        about = {"task": self.config.task, "algorithm": self.config.algorithm, "steps": steps}
        folder = self.folder / "checkpoints"
        path = folder / f"step_{steps:012d}.safetensors"
        save_checkpoint(path, self.seeds.join(state), about | {"seconds": clock.seconds})
        for old in sorted(folder.glob("step_*.safetensors"))[:-2]:
            old.unlink()

    def _rows(self, done: int, clock: Clock, logs, losses) -> list[dict]:
        """One row of metrics.jsonl per seed."""
        about = {"steps": done * self.steps_per_iteration, "seconds": round(sum(clock.seconds.values()), 3)}
        plain = jax.tree.map(lambda x: np.asarray(x).item(), list(zip(self.seeds.seeds, logs, losses, strict=True)))
        return [about | {"seed": seed} | log | {"losses": loss} for seed, log, loss in plain]

    def _keep_rows(self, name: str, steps: int) -> None:
        """Drop what is after `steps`, and a last line that a crash has torn."""
        kept = [row for row in self.rows(name) if row["steps"] <= steps]
        write_atomically(self.folder / f"{name}.jsonl", "".join(json.dumps(row) + "\n" for row in kept).encode())

    def rows(self, name: str) -> list[dict]:
        """The rows of "metrics" or "evaluations" that are whole."""
        return read_rows(self.folder / f"{name}.jsonl", ROWS[name])

    # -- afterwards ----------------------------------------------------------------------------

    def _finish(self, clock: Clock) -> dict[str, Any]:
        """Write summary, curve and film of a finished run; returns the summary."""
        config = self.config
        print("Evaluating and filming.", file=sys.stderr)  # in software, 200 frames take their time
        self._keep_rows("evaluations", (self.iterations - 1) * self.steps_per_iteration)  # the last is made anew
        results = self._evaluate(self.iterations, self.teams())
        each = [summarize(result) for result in results]
        seconds = sum(clock.seconds.values())
        steps = self.iterations * self.steps_per_iteration
        summary = {
            "task": config.task,
            "algorithm": config.algorithm,
            "preset": config.preset,
            "engine": self.env.engine.name,
            "steps": steps,
            "num_envs": config.num_envs,
            "seeds": [config.seed + i for i in range(config.num_seeds)],
            "success_rate": float(np.mean([one["success_rate"] for one in each])),
            "mean_return": float(np.mean([one["mean_return"] for one in each])),
            "env_steps_per_s": round(steps * config.num_seeds / max(seconds, 1e-9)),
            "seconds": {name: round(value, 1) for name, value in clock.seconds.items() if value},
            "peak_memory_mb": round(peak_memory_mb()),
            "evaluation": each,
            **stamp(),
        }
        write_json(self.folder / "summary.json", summary)
        rows = self.rows("metrics")
        title = f"{config.task}, {config.algorithm} ({config.preset} preset), {steps / 1e6:.1f} M steps"
        learning_curve(rows, title, self.folder / "learning_curve.png")
        try:
            self.film(results[0], typical(results[0]), self.folder / "rollout.mp4")
        except UsageError as error:  # a machine that cannot render can still train
            print(f"No film: {error}", file=sys.stderr)
        return summary

    def _evaluate(self, done: int, teams: Iterable[Team]) -> list[dict[str, Any]]:
        """Play the evaluation with each seed's team and write down the episodes; returns what an Evaluator does."""
        results = []
        with open(self.folder / "evaluations.jsonl", "a") as log:
            for seed, team in zip(self.seeds.seeds, teams, strict=True):
                result = self._evaluator(team)
                found = by_episode(result)
                about = {"steps": done * self.steps_per_iteration, "seed": seed}
                about |= {"deterministic": self.config.deterministic}
                log.write(json.dumps(about | {"episodes": found["metrics"], "terms": found["terms"]}) + "\n")
                results.append(result)
        return results

    @cached_property
    def _evaluator(self) -> Evaluator:
        return Evaluator(self.env, self.config.evaluation_episodes)

    def film(self, result: dict[str, Any], episode: int, path: Path, **camera) -> None:
        """Film one episode of what `evaluation.play` returned."""
        on = result["playing"][episode]
        film(
            self.config.task,
            result["qpos"][episode][on],
            result["marker"][episode][on],
            self.env.dt,
            path,
            **camera,
        )

    def team(self, state: Any, deterministic: bool | None = None) -> Team:
        """The players of one seed; of its state only params and normalizer are read."""
        return self._team(self.trainer.policy_params(state), deterministic)

    def _team(self, learned: dict[str, Any], deterministic: bool | None) -> Team:
        """Learners deterministically or not, unless told as in the configuration, beside the frozen partners."""
        policy = self.trainer.policy(self.config.deterministic if deterministic is None else deterministic)
        return {agent: Player.of(policy, params) for agent, params in learned.items()} | self._frozen

    def teams(self, deterministic: bool | None = None) -> list[Team]:
        """The policies of each seed, from the newest checkpoint."""
        params = learned(self.folder, self.config, self.trainer)
        return [self._team(mine, deterministic) for mine in params]
