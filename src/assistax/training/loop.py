"""The training loop: collect, improve, write down, evaluate, save, until it is done or has to stop."""

import json
import math
import sys
import time
from collections.abc import Callable, Container, Iterable, Sequence
from typing import Any

import jax
import numpy as np

from assistax.devices import check_devices, sharing
from assistax.errors import UsageError
from assistax.evaluation.playing import Evaluator, by_episode, summarize
from assistax.files import write_json
from assistax.physics import check_faults
from assistax.policies import Team
from assistax.results.stored import flat
from assistax.stamp import peak_memory_mb, stamp
from assistax.training import journal, pieces
from assistax.training.clock import Clock, Stop, progress_bar
from assistax.training.configuration import to_json
from assistax.training.journal import Journal
from assistax.training.lock import locked
from assistax.training.loggers import Loggers, check_loggers
from assistax.training.run import Run
from assistax.training.run_folder import check_checkpoint, learned, save_policies, save_snapshot

CHECKPOINT_SECONDS = 60.0
_COMPILING = "Compiling, which takes some ten seconds."
# Settings that may change when a run is continued: how long it lasts, how it is watched, what computes it.
_FREE = {
    "steps",
    "evaluations",
    "evaluation_episodes",
    "deterministic",
    "snapshots",
    "engine",
    "devices",
    "env.num_threads",
    "partners",
}


def train(
    run: Run, seconds: float = math.inf, log: Sequence[str] = (), bar: Callable = progress_bar, pictures: bool = True
) -> dict[str, Any] | None:
    """Train from the newest checkpoint, if there is one, to the end: the summary.

    `log` names loggers.LOGGERS that are to have it, too; `bar(total, done)` makes the progress bar; `pictures` are
    learning curve and film.

    None if it had to stop and save before, because of Ctrl-C or another signal, or because `seconds` have passed.

    Raises:
      UsageError: the run cannot be continued as it is asked to; nothing was changed then.
    """
    check_loggers(log)
    if not (run.folder / "checkpoints").is_dir():
        raise UsageError(f"{run.folder} is a result without checkpoints, which cannot continue; train anew with --out.")
    check_devices(run.config.devices, run.config.num_envs)  # again, for a run that another machine may have begun
    with locked(run.folder), sharing(run.config.devices):
        return _Training(run, Stop(seconds), log, bar, pictures).go()


class _Training:
    """One process's work on a run."""

    def __init__(
        self, run: Run, stop: Stop, log: Sequence[str] = (), bar: Callable = progress_bar, pictures: bool = True
    ):
        self.run, self.stop, self.log, self.bar, self.pictures = run, stop, log, bar, pictures
        self.trainer, self.seeds, self.engine = run.trainer, run.seeds, run.env.engine
        self.evaluator = Evaluator(run.env, run.config.evaluation_episodes)
        self.evaluated: set[int] = set()  # iterations; a run that is prolonged had other ones before than it has now
        self.loggers = Loggers((), run.folder, self.seeds.seeds, 0, {})  # nobody yet

    def go(self) -> dict[str, Any] | None:
        with self.stop:
            state, done, self.clock = self._start()
            steps = done * self.run.steps_per_iteration
            with Loggers(self.log, self.run.folder, self.seeds.seeds, steps, _all_settings(self.run)) as self.loggers:
                return self._go_on(state, done)

    def _go_on(self, state: Any, done: int) -> dict[str, Any] | None:
        run, per_iteration = self.run, self.run.steps_per_iteration
        collect, improve = self.seeds.jit(self.trainer.collect), self.seeds.jit(self.trainer.improve)
        total = run.iterations * per_iteration * run.config.num_seeds
        collecting = "policy" if self.engine.name == "mujoco" else "collect"  # others are part of the same program
        saved = time.monotonic()
        began = done
        with (
            Journal(run.folder, "metrics") as self.metrics,
            Journal(run.folder, "evaluations") as self.evaluations,
            self.bar(total, done * total // run.iterations) as bar,
        ):
            if done == 0:
                self._save(state, done)  # before any row, so that a run that has rows can always be continued
            self._evaluate_due(done, state)  # a signal may have kept it from that
            leave = done == run.iterations or self.stop.signalled
            while not leave:
                before = self.engine.seconds
                with self.clock(collecting):
                    state, batch = jax.block_until_ready(collect(state))
                self.clock.move(collecting, "physics", self.engine.seconds - before)
                if done == began and self.stop.signalled:
                    return None  # nothing is lost yet, and the rest of the iteration has to be compiled
                batches = self.seeds.each(batch)
                for one in batches:
                    check_faults(one["log"]["fault"], self.engine.name)
                with self.clock("update"):
                    state, losses = jax.block_until_ready(improve(state, batch))
                done += 1
                rows = self._rows(done, [one["log"] for one in batches], self.seeds.each(losses))
                self.metrics.write(rows)
                self.loggers.rows(rows)
                bar.update(total // run.iterations)
                if ended := [row for row in rows if row["episodes"]]:
                    mean = np.mean([row["episode"]["return"] for row in ended])
                    success = np.mean([row["episode"]["success"] for row in ended])
                    bar.set_postfix_str(f"return {mean:.0f}, success {success:.0%}", refresh=False)
                self._evaluate_due(done, state)
                leave = done == run.iterations or self.stop.asked
                if leave or time.monotonic() - saved > CHECKPOINT_SECONDS:
                    self._save(state, done)
                    saved = time.monotonic()
        if done < run.iterations or self.stop.signalled:
            return None
        try:
            return self._finish()
        except KeyboardInterrupt:
            return None

    # -- the beginning -------------------------------------------------------------------------

    def _start(self) -> tuple[Any, int, Clock]:
        """The newest checkpoint's state, or a fresh one; the iterations done and the time spent so far."""
        run, path = self.run, self.run.newest_checkpoint()
        if path is None:
            if any(journal.read(run.folder, name) for name in ("metrics", "evaluations")):
                raise UsageError(
                    f"{run.folder} has results but no checkpoint to continue from. Put its checkpoints back, or remove "
                    "the folder and train anew."
                )
            run.write_config()
            for name in ("metrics", "evaluations"):  # of what a crash has left of a first line
                journal.keep(run.folder, name, 0)
            print(_COMPILING, file=sys.stderr)
            return self.seeds.init(run.init), 0, Clock({})
        about = check_checkpoint(path, run.config)
        _check_settings(run, about.get("settings", {}), path.name)
        done, over = divmod(about["steps"], run.steps_per_iteration)
        self.evaluated = set(about.get("evaluated", run.evaluate_at))  # those of earlier versions do not say
        if over:
            raise UsageError(
                f"{path} is at step {about['steps']}, which no iteration of {run.steps_per_iteration} steps ends at: "
                "config.json was changed; put it back."
            )
        if done > run.iterations:
            raise UsageError(
                f"{run.folder} has been trained for {about['steps']} steps, which is more than --steps "
                f"{run.config.steps}; name more steps, or leave --steps out."
            )
        print(_COMPILING, file=sys.stderr)
        state = self.seeds.split(pieces.load(path, self.seeds.like(self.trainer.init)))
        run.write_config(about["steps"])
        for name in ("metrics", "evaluations"):
            journal.keep(run.folder, name, about["steps"])
        for name, gap in self._missing(done).items():
            if gap:
                print(f"{run.folder}/{name}.jsonl lacks {gap} rows; curves have a gap there.", file=sys.stderr)
        return state, done, Clock(about["seconds"])

    def _missing(self, done: int) -> dict[str, int]:
        """By file, the rows that are not there."""
        run = self.run
        wanted = {"metrics": range(1, done + 1), "evaluations": [i for i in self.evaluated if i < done]}
        return {
            name: journal.missing(run.folder, name, [i * run.steps_per_iteration for i in at], self.seeds.seeds)
            for name, at in wanted.items()
        }

    # -- on the way ----------------------------------------------------------------------------

    def _rows(self, done: int, logs, losses) -> list[dict]:
        """One row of metrics.jsonl per seed."""
        steps, spent = done * self.run.steps_per_iteration, sum(self.clock.seconds.values())
        about = {"steps": steps, "seconds": round(spent, 3)}
        plain = jax.tree.map(lambda x: np.asarray(x).item(), list(zip(self.seeds.seeds, logs, losses, strict=True)))
        return [about | {"seed": seed} | log | {"losses": loss} for seed, log, loss in plain]

    def _evaluate_due(self, done: int, state: Any) -> None:
        """The evaluation that is due after so many iterations, of the seeds that have none yet."""
        if done not in self.run.evaluate_at:
            return
        self.evaluated.add(done)
        steps = done * self.run.steps_per_iteration
        there = {row["seed"] for row in journal.read(self.run.folder, "evaluations") if row["steps"] == steps}
        with self.clock("evaluation"):
            if self.run.config.snapshots:
                policies = [self.trainer.policy_params(one) for one in self.seeds.each(state)]
                save_snapshot(self.run.folder, steps, policies)
            self._evaluate(done, map(self.run.team, self.seeds.each(state)), there)

    def _evaluate(self, done: int, teams: Iterable[Team], there: Container[int] = ()) -> list[dict[str, Any]]:
        """Play the evaluation with the team of each seed that is not `there`, until a signal comes, and write it down.

        Returns what an Evaluator does.
        """
        results = []
        for seed, team in zip(self.seeds.seeds, teams, strict=True):
            if seed in there or self.stop.signalled:
                continue
            result = self.evaluator(team)
            found = by_episode(result)
            about = {"steps": done * self.run.steps_per_iteration, "seed": seed}
            about |= {"deterministic": self.run.config.deterministic}
            row = about | {"episodes": found["metrics"], "terms": found["terms"]}
            self.evaluations.write([row])
            self.loggers.rows([row])
            results.append(result)
        return results

    def _save(self, state: Any, done: int) -> None:
        """A checkpoint, and before it on the disk all rows that it knows of."""
        self.metrics.sync()
        self.evaluations.sync()
        config, steps = self.run.config, done * self.run.steps_per_iteration
        about = {
            "task": config.task,
            "algorithm": config.algorithm,
            "steps": steps,
            "settings": _settings(self.run),
            "seconds": self.clock.seconds,
            "evaluated": sorted(self.evaluated),
        }
        folder = self.run.folder / "checkpoints"
        path = folder / f"step_{steps:012d}.safetensors"
        pieces.save(path, self.seeds.join(state), about)
        for old in sorted(folder.glob("step_*.safetensors"))[:-2]:
            old.unlink()
        pieces.prune(folder)

    # -- the end -------------------------------------------------------------------------------

    def _finish(self) -> dict[str, Any] | None:
        """Write summary, curve and film of a finished run; returns the summary, None if a signal kept it from that."""
        run, config = self.run, self.run.config
        print(f"Evaluating{' and filming' * self.pictures}.", file=sys.stderr)  # 200 frames take their time
        journal.keep(run.folder, "evaluations", (run.iterations - 1) * run.steps_per_iteration)  # the last is made anew
        with Journal(run.folder, "evaluations") as self.evaluations:
            results = self._evaluate(run.iterations, run.teams())
        self.stop.at_once = True
        if self.stop.signalled:
            return None
        each = [summarize(result) for result in results]
        policies = learned(run.folder, config, self.trainer)
        save_policies(run.folder, config, run.iterations * run.steps_per_iteration, policies)
        spent = self.clock.seconds
        steps = run.iterations * run.steps_per_iteration
        summary = {
            "task": config.task,
            "algorithm": config.algorithm,
            "preset": config.preset,
            "engine": self.engine.name,
            "steps": steps,
            "num_envs": config.num_envs,
            "seeds": list(config.seeds),
            **{
                name: float(np.mean([one[name] for one in each]))
                for name in ("success_rate", "safe_success_rate", "mean_return")
                if name in each[0]  # harm is not measured in version 0
            },
            "env_steps_per_s": round(steps * config.num_seeds / max(sum(spent.values()), 1e-9)),
            "seconds": {name: round(value, 1) for name, value in spent.items() if value},
            "peak_memory_mb": round(peak_memory_mb()),
            "evaluation": each,
            **stamp(),
        }
        if gaps := {name: count for name, count in self._missing(run.iterations).items() if count}:
            summary["missing_rows"] = gaps
        write_json(run.folder / "summary.json", summary)
        if not self.pictures:
            return summary
        from assistax.evaluation.film import film  # not before: a first update would wait a second for Matplotlib
        from assistax.results.figures import learning_curve

        title = f"{config.task}, {config.algorithm} ({config.preset} preset), {steps / 1e6:.1f} M steps"
        if rows := journal.read(run.folder, "metrics"):
            learning_curve(rows, title, run.folder / "learning_curve.png")
        try:
            film(results[0]["filmed"], run.folder / "rollout.mp4")
            self.loggers.film(steps, run.folder / "rollout.mp4")
        except UsageError as error:  # a machine that cannot render can still train
            print(f"No film: {error}", file=sys.stderr)
        return summary


def _all_settings(run: Run) -> dict[str, Any]:
    """All settings by full name."""
    return dict(flat(json.loads(json.dumps(to_json(run.config)))))


def _settings(run: Run) -> dict[str, Any]:
    """By full name, the settings that must not change when a run is continued."""
    return {name: value for name, value in _all_settings(run).items() if name not in _FREE}


def _check_settings(run: Run, then: dict[str, Any], checkpoint: str) -> None:
    now = _settings(run)
    if changed := [name for name in then if name in now and then[name] != now[name]]:
        name = changed[0]
        raise UsageError(
            f"{run.folder}/config.json was changed: {name} is {now[name]}, and was {then[name]} when {checkpoint} was "
            "written; put it back, or train anew."
        )
