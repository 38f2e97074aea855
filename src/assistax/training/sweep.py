"""Random search over hyperparameters, the way the paper tuned every algorithm; resumable at any moment.

sweep.json            what was asked for, and the configurations that were drawn
trials/CONFIG-SEED/   a configuration trained with a seed: trial.json when it is finished; before, where it stands,
                      unfinished.safetensors, what is large of it in pieces, see pieces.py
ranking.json          the configurations that have been tried, best first
sweep.png             one panel per hyperparameter; sweep_NAME.png: one, as in the paper's appendix
workers/              who trains what, and what they print, see executors/

Configurations are ranked by the area under the learning curve. A trial's curve has a point per iteration: the mean
reward per step of that iteration times the length of an episode, the return of a whole episode at that rate. Every step
counts, whether its episode has ended or not. The area is the mean of the points. Training that becomes non-finite has
failed and has no area.
"""

import dataclasses
import itertools
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax.errors import UsageError
from assistax.evaluation.statistics import seed_ci
from assistax.executors.drive import Executor, drive
from assistax.executors.jobs import Job, work
from assistax.files import read_json, write_json
from assistax.formats import SWEEP, TRIAL, UNFINISHED
from assistax.learning.tuned import tunable
from assistax.physics import check_faults
from assistax.physics.engine import UNSTABLE
from assistax.results.figures import save as save_figure
from assistax.settings import with_settings
from assistax.stamp import stamp, stamp_changes
from assistax.training import pieces
from assistax.training.checkpoint import read_metadata
from assistax.training.clock import Clock, Stop, progress_bar
from assistax.training.configuration import TrainConfig, check_settings, stored_config, to_json
from assistax.training.loop import CHECKPOINT_SECONDS
from assistax.training.memory import check_memory
from assistax.training.partners import keep_partners
from assistax.training.run import Run
from assistax.training.search import Search, draw, intervals
from assistax.training.seeds import Lanes
from assistax.training.sweep_figures import facets, overview

Trial = tuple[int, int]
"""The number of a configuration, and a seed."""
TRIALS, FINISHED, UNTIL_NOW, WORKERS = "trials", "trial.json", "unfinished.safetensors", "workers"
LAST = 0.1  # share of a trial that its final return and success are of


class Sweep:
    """A sweep folder, new or found. Use `create` or `open`."""

    def __init__(
        self,
        folder: Path,
        config: TrainConfig,
        search: Search,
        drawn: Sequence[dict[str, Any]],
        side_by_side: int | None = None,
    ):
        if side_by_side is None:
            side_by_side = 1 if jax.default_backend() == "cpu" else config.num_seeds
        if side_by_side < 1:
            raise UsageError(f"side_by_side must be 1 or more, not {side_by_side}.")
        self.side_by_side = side_by_side  # the same for all machines that share the work
        self.folder, self.config, self.search, self.drawn = folder, config, dict(search), list(drawn)
        self.seeds = range(config.seed, config.seed + config.num_seeds)
        floats = {f"{config.group}.{name}" for name in tunable(config.method)}
        check_settings(search)
        for name in search:  # so that a name that does not exist is reported as such, not as one that takes choices
            with_settings(config, {name: _value(config, name)})
        if compiled_in := set(intervals(search)) - floats:
            known = ", ".join(sorted(floats))
            raise UsageError(f"{min(compiled_in)} takes choices like A,B,C; an interval is possible for {known}.")
        configs = [with_settings(config, settings) for settings in drawn]  # all are checked now
        first = Run(folder, configs[0])
        inputs = floats if hasattr(jax.eval_shape(first.trainer.init, jax.random.key(0), {}), "tuned") else set()
        self._inputs = [{n.split(".")[1]: v for n, v in settings.items() if n in inputs} for settings in drawn]
        # Configurations that differ only in inputs are trained by the same program.
        programs: dict[str, list[int]] = {}
        for i, settings in enumerate(drawn):
            constants = {name: value for name, value in settings.items() if name not in inputs}
            programs.setdefault(json.dumps(constants, sort_keys=True), []).append(i)
        self._programs = list(programs.values())
        runs = {mine[0]: Run(folder, configs[mine[0]]) if mine[0] else first for mine in self._programs}
        self._runs = {i: runs[mine[0]] for mine in self._programs for i in mine}
        self._compiled: Program | None = None

    @classmethod
    def create(
        cls, config: TrainConfig, folder: Path, count: int, search: Search, side_by_side: int | None = None
    ) -> "Sweep":
        """Draw `count` configurations and make the folder, which must be new or empty.

        `side_by_side` says how many trials a program trains at once (default: on an accelerator as many as there are
        seeds, on a CPU one).
        """
        if count < 1:
            raise UsageError(f"configs must be 1 or more, not {count}.")
        if not search:
            raise UsageError(
                "Nothing is left to search: --set fixes all hyperparameters that are searched by default, if any. "
                "Name one with --search."
            )
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(f"{folder} is already in use; name another --out, or continue it with --resume {folder}.")
        sweep = cls(folder, config, search, draw(search, count, config.seed), side_by_side)
        for run in set(sweep._runs.values()):
            check_memory(run.trainer)
            if run.config.devices > 1:
                raise UsageError(f"devices = {run.config.devices}, and a sweep trains on one; leave it out.")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"Cannot write to {folder}: {error.strerror}.") from None
        copies = keep_partners(sweep._runs[0].partners, folder)
        sweep.config = config = dataclasses.replace(config, partner_copies=copies)
        about = {"search": sweep.search, "drawn": sweep.drawn, "side_by_side": sweep.side_by_side}
        write_json(folder / "sweep.json", {"config": to_json(config)} | about)
        return sweep

    @classmethod
    def open(cls, folder: Path) -> "Sweep":
        """Read a sweep folder; it must have been begun with the versions and the source that are installed now."""
        config, search, drawn, side_by_side, begun = read_sweep(folder)
        if differ := stamp_changes(begun, stamp()):
            raise UsageError(f"{folder} was begun with {', '.join(differ)}. Go back to that, or start a new sweep.")
        return cls(folder, config, search, drawn, side_by_side)

    def trials(self) -> dict[Trial, dict[str, Any]]:
        """What the finished trials came to."""
        found = {}
        for path in sorted(self.folder.glob(f"{TRIALS}/*/{FINISHED}")):
            row = read_json(path, TRIAL)
            if not self._belongs(row) or path.parent.name != _name((row["config"], row["seed"])):
                raise UsageError(f"{path} is of another sweep; remove its folder.")
            found[row["config"], row["seed"]] = row
        return found

    def _belongs(self, row: Any) -> bool:
        i = row["config"]
        known = i < len(self.drawn) and row["seed"] in self.seeds
        return known and row["settings"] == self.drawn[i] and row["steps"] == self._steps(i)

    def _steps(self, config: int) -> int:
        run = self._runs[config]
        return run.iterations * run.steps_per_iteration

    # -- training ------------------------------------------------------------------------------

    def run(self, seconds: float = math.inf) -> list[dict[str, Any]] | None:
        """Train what has not been trained, nor is just being trained by others, for about so many seconds.

        Returns the ranking, or None if not all is finished: after Ctrl-C or `seconds`, or because others are at it.
        """
        self.trials()  # what is of another sweep is refused before anything is trained

        def report():
            ranking = self._report()
            best = max((one["auc"] for one in ranking if one["auc"] is not None), default=math.nan)
            bar.set_postfix_str(f"{sum(one['seeds'] for one in ranking)} trials, best area {best:.0f}", False)

        mine = self.jobs(seconds, lambda steps: bar.update(steps), report)
        with progress_bar(sum(job.size for job in mine), sum(job.done() for job in mine)) as bar:
            work(self.folder / WORKERS, mine)
        return self.finish()

    def run_with(self, using: Executor, workers: int | None = None) -> list[dict[str, Any]] | None:
        """`run` in as many processes as an executor starts."""
        command = [sys.executable, "-m", "assistax", "sweep", "--resume", str(self.folder.resolve())]
        drive(self.folder / WORKERS, self.jobs(), using, command, workers, progress_bar)
        return self.finish()

    def finish(self) -> list[dict[str, Any]] | None:
        """The ranking, written down with all pictures, if all trials are finished; None before."""
        if len(self.trials()) < len(self.drawn) * len(self.seeds):
            return None
        ranking = self._report()
        for name in intervals(self.search):
            path = self.folder / f"sweep_{name.split('.')[-1]}.png"
            save_figure(facets(ranking, self.search, name, self._title()), path)
        return ranking

    def jobs(
        self,
        seconds: float = math.inf,
        advance: Callable[[int], Any] = lambda steps: None,
        report: Callable[[], Any] = lambda: None,
    ) -> list[Job]:
        """The trials, or batches of `side_by_side`, which stop when the time is spent.

        `advance` is told of steps, `report` called after each.
        """
        deadline = time.monotonic() + seconds
        found = []
        for members in self._programs:  # whose trials come one after the other, so that each is compiled once
            every = [(i, seed) for seed in self.seeds for i in members]
            for at in range(0, len(every), self.side_by_side):
                found.append(self._job(every[at : at + self.side_by_side], deadline, advance, report))
        return found

    def _job(self, chunk: list[Trial], deadline: float, advance: Callable, report: Callable) -> Job:
        place = self._place(chunk[0])

        def left():
            return [trial for trial in chunk if not (self._place(trial) / FINISHED).exists()]

        def done():
            missing, stored = left(), None
            finished = size - sum(self._steps(i) for i, _ in missing)
            with suppress(UsageError):  # somebody has just finished it; or it is damaged, as whoever continues will say
                stored = _read_unfinished(place / UNTIL_NOW, missing) if missing else None
            steps = len(stored["points"][0]) * self._runs[chunk[0][0]].steps_per_iteration if stored else 0
            return min(finished + steps * len(missing), size - bool(missing))

        def do():
            with Stop(deadline - time.monotonic()) as stop:
                rows = None if time.monotonic() > deadline else self._train(left(), place, stop, advance)
            if rows is None:
                return False
            for row in rows:
                self._place((row["config"], row["seed"])).mkdir(exist_ok=True)
                write_json(self._place((row["config"], row["seed"])) / FINISHED, row)
            (place / UNTIL_NOW).unlink(missing_ok=True)
            pieces.prune(place)
            report()
            return not stop.signalled

        size = sum(self._steps(i) for i, _ in chunk)
        return Job(_name(chunk[0]), size, done, do)

    def _place(self, trial: Trial) -> Path:
        return self.folder / TRIALS / _name(trial)

    def _program(self, run: Run, count: int) -> "Program":
        """Compiled once for all trials of a kind, which come one after the other."""
        if self._compiled is None or self._compiled.run is not run or self._compiled.count != count:
            self._compiled = Program(run, count)
        return self._compiled

    def _train(
        self, chunk: list[Trial], place: Path, stop: Stop, advance: Callable[[int], Any]
    ) -> list[dict[str, Any]] | None:
        """What some trials come to, from their checkpoint in `place` if there is one; None if stopped."""
        run, path = self._runs[chunk[0][0]], place / UNTIL_NOW
        program = self._program(run, len(chunk))
        lanes = program.lanes
        keys = [jax.random.key(seed) for _, seed in chunk]
        tuned = [{name: jnp.float32(value) for name, value in self._inputs[i].items()} for i, _ in chunk]
        about: dict[str, Any] = {"trials": [list(trial) for trial in chunk]}
        if stored := _read_unfinished(path, chunk):
            state = lanes.split(pieces.load(path, lanes.like(run.trainer.init, keys, tuned), finite=()))
            about["points"], clock = stored["points"], Clock(stored["seconds"])
        else:
            state = program.start(keys, tuned)
            about["points"], clock = [[] for _ in chunk], Clock({})
        points = about["points"]
        done, saved = len(points[0]), time.monotonic()
        while done < run.iterations and any(map(is_sound, points)):
            leave = stop.asked
            if leave or time.monotonic() - saved > CHECKPOINT_SECONDS:
                place.mkdir(parents=True, exist_ok=True)
                pieces.save(path, lanes.join(state), about | {"seconds": clock.seconds})
                pieces.prune(place)
                saved = time.monotonic()
            if leave:
                return None
            with clock("training"):
                state, batch = program.collect(state)
                state, _ = program.improve(state, batch)
                logs = jax.device_get([one["log"] for one in lanes.each(batch)])
            for mine, log in zip(points, logs, strict=True):
                check_faults(log["fault"] & ~UNSTABLE, run.env.engine.name)
                mine.append(point(log, run.env.episode_length))
            done += 1
            advance(run.steps_per_iteration * len(chunk))
        advance((run.iterations - done) * run.steps_per_iteration * len(chunk))
        place.mkdir(parents=True, exist_ok=True)
        seconds = round(sum(clock.seconds.values()) / len(chunk), 1)
        return [
            {"config": i, "seed": seed, "settings": self.drawn[i], "steps": self._steps(i), "seconds": seconds}
            | outcome(mine, run.steps_per_iteration)
            for (i, seed), mine in zip(chunk, points, strict=True)
        ]

    def _title(self) -> str:
        seeds = f"{len(self.seeds)} seed{'s' * (len(self.seeds) > 1)}"
        return f"{self.config.task}, {self.config.algorithm}: {len(self.drawn)} configurations, {seeds}"

    def _report(self) -> list[dict[str, Any]]:
        ranking = rank(self.trials().values())
        write_json(self.folder / "ranking.json", ranking)
        save_figure(overview(ranking, self.search, self._title()), self.folder / "sweep.png")
        return ranking


def read_sweep(folder: Path) -> tuple[TrainConfig, dict[str, str], list[dict[str, Any]], int, dict[str, Any]]:
    """What sweep.json says: the configuration, the search, what was drawn, how many side by side, and its stamp."""
    path = folder / "sweep.json"
    if not path.exists():
        raise UsageError(f"{folder} is not a sweep folder: it has no sweep.json.")
    stored = read_json(path, SWEEP)
    if not stored["drawn"] or any(one.keys() != stored["search"].keys() for one in stored["drawn"]):
        raise UsageError(f"Cannot read {path}: what was drawn is not what was searched for.")
    config = stored_config(stored["config"], str(path))
    return config, stored["search"], stored["drawn"], stored.get("side_by_side", 1), stored["config"]["stamp"]


def _name(trial: Trial) -> str:
    """Of a trial's folder, and of its job."""
    return f"{trial[0]:04d}-{trial[1]}"


def _read_unfinished(path: Path, chunk: list[Trial]) -> dict[str, Any] | None:
    """What a checkpoint says beside its arrays, if there is one and it is of these trials."""
    stored = read_metadata(path, UNFINISHED) if path.exists() else {}
    return stored if stored.get("trials") == [list(trial) for trial in chunk] else None


def _value(config: TrainConfig, name: str) -> Any:
    """The value of a setting; anything for one that does not exist."""
    group, _, field = name.partition(".")
    found: Any = config.method if group == config.group else config
    for part in (field if group == config.group else name).split("."):
        found = getattr(found, part, None)
    return found


class Program:
    """A trainer's functions for `count` trials at once, compiled once."""

    def __init__(self, run: Run, count: int):
        self.run, self.count, self.lanes, trainer = run, count, Lanes(count), run.trainer
        self.start = self.lanes.start(trainer.init)
        self.collect, self.improve = self.lanes.jit(trainer.collect), self.lanes.jit(trainer.improve)


# -- results of trials -------------------------------------------------------------------------


def point(log: Mapping[str, Any], episode_length: int) -> list[float]:
    """Of an iteration's log: the return of an episode at that rate of reward, episodes that ended, successes.

    The return is NaN if the simulation broke.
    """
    episodes = int(log["episodes"])
    reward = math.nan if log["fault"] else float(sum(log["reward"].values()))
    return [episode_length * reward, episodes, episodes * float(log["episode"].get("success", math.nan))]


def is_sound(points: Sequence[Sequence[float]]) -> bool:
    """Whether training has not become non-finite."""
    return all(math.isfinite(one[0]) for one in points)


def outcome(points: Sequence[Sequence[float]], every: int) -> dict[str, Any]:
    """The result of a trial, from its points, `every` steps apart."""
    sound = list(itertools.takewhile(lambda one: math.isfinite(one[0]), points))
    curve = [[(k + 1) * every, round(one[0], 3)] for k, one in enumerate(sound)]
    result = {"curve": curve, "auc": None, "final_return": None, "success": None, "failed": len(sound) < len(points)}
    if result["failed"]:
        return result
    last = np.array(points[-max(1, round(LAST * len(points))) :])
    result |= {"auc": float(np.mean([one[0] for one in points])), "final_return": float(last[:, 0].mean())}
    if last[:, 1].sum() and np.isfinite(last[:, 2]).all():
        result["success"] = float(last[:, 2].sum() / last[:, 1].sum())
    return result


def rank(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Configurations by the mean area over their seeds, best first. A failed trial counts as the worst that did not."""
    by_config: dict[int, list[dict]] = {}
    for row in rows:
        by_config.setdefault(row["config"], []).append(row)
    areas = [row["auc"] for mine in by_config.values() for row in mine if not row["failed"]]
    worst, ranking = min(areas, default=None), []
    for config, mine in by_config.items():
        entry = {"config": config, "settings": mine[0]["settings"], "auc": None, "interval": None}
        if worst is not None:
            scores = np.array([worst if row["failed"] else row["auc"] for row in mine])
            entry |= {"auc": float(scores.mean()), "interval": seed_ci([scores])}
        for name in ("final_return", "success"):
            known = [row[name] for row in mine if row[name] is not None]
            entry[name] = float(np.mean(known)) if known else None
        ranking.append(entry | {"seeds": len(mine), "failed": sum(row["failed"] for row in mine)})
    return sorted(ranking, key=lambda entry: -entry["auc"] if areas else 0)
