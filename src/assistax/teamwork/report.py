"""The table of ad-hoc teamwork: methods beside references, with partners of training and held-out ones.

One method is one or more runs, whose seeds are its robots; each meets every partner in the environment as it knows it
(who sees the preference), with the same draws.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation.playing import EVALUATION_SEED
from assistax.policies import Player
from assistax.results.figures import STYLE, save
from assistax.stamp import stamp
from assistax.teamwork.adhoc import HURT, Meeting, only
from assistax.teamwork.scores import SCORES, by_pair, difference, gap, scales, summarize
from assistax.teamwork.strangers import check_robots, check_strangers, knows
from assistax.training.configuration import TrainConfig, configure, to_json
from assistax.training.population import Population
from assistax.training.run import Run

SHOWN = (*SCORES, "return", "regret", "success", "safe_success", "gated_preference_return")


def report(
    methods: Mapping[str, Sequence[Run | Player]],
    populations: Mapping[str, Population],
    episodes: int = 16,
    seed: int = EVALUATION_SEED,
    best_responses: Mapping[str, Run] | None = None,
) -> dict[str, Any]:
    """Everybody with everybody.

    Args:
      methods: by name the runs whose robots are measured, whose seeds are the method's; or robots made elsewhere, a
        seed each, who observe what `assistax.make(task)` shows and of whom it is not known whom they have met.
      populations: by part, "test" and perhaps "train": the partners.
      episodes: with each partner.
      seed: of the draws.
      best_responses: by name, runs of robots that were trained with one or more of the partners: references for score
        1 beside those partners.

    Returns:
      ready for JSON: "task", "episodes", "partners" (ids by part), "people" (who they are, by part), by part
      "references" and "methods" (see scores.summarize), which partners are "scored" by score, and the "differences" of
      the other methods from the first, by method and measure; "gap" by method and measure; "runs" by method; "stamp".

    Raises:
      UsageError: a run of another task, whose robot did not learn, observes something else, or has met a held-out
        partner in training; or a run given twice.
    """
    best_responses = best_responses or {}
    _check_given(methods, populations)
    measured = [one for robots in methods.values() for one in robots if isinstance(one, Run)]
    check_robots([*measured, *best_responses.values()], populations)
    check_strangers(measured, populations)
    task = next(iter(populations.values())).task
    config = measured[0].config if measured else configure(task, {})
    everywhere = {part: Meetings(config, population, episodes) for part, population in populations.items()}
    for meetings in everywhere.values():  # who does not fit is refused before anybody has played
        for run in (*measured, *best_responses.values()):
            meetings.of(run)
    played = to_json(everywhere[next(iter(populations))].config)
    found: dict[str, Any] = {"task": task, "episodes": episodes, "seed": seed, "engine": played["engine"]}
    found["env"] = played["env"] | {"human": {k: v for k, v in played["env"]["human"].items() if k != "people"}}
    found["partners"] = {part: list(population.ids) for part, population in populations.items()}
    found["people"] = {part: [kind_of(row) for row in population.rows] for part, population in populations.items()}
    pairs: dict[str, dict[str, Any]] = {}  # by part and method
    for part, meetings in everywhere.items():
        references = meetings.plain.references(seed)
        for name, run in best_responses.items():
            known = np.array(knows(run, meetings.population))
            for k, one in zip(run.seeds.seeds, meetings(run, seed), strict=True):
                references[f"{name} {k}" if run.config.num_seeds > 1 else name] = only(known, one)
        references = {name: one for name, one in references.items() if not np.isnan(one["return"]).all()}
        made = scales(references)
        pairs[part] = {
            name: by_pair([robot for one in robots for robot in meetings(one, seed)], made)
            for name, robots in methods.items()
        }
        first, *others = pairs[part]
        found[part] = {
            "references": {name: summarize(by_pair([one], made)) for name, one in references.items()},
            "methods": {name: summarize(one) for name, one in pairs[part].items()},
            "scored": {name: made[on].scored.tolist() for name, on in SCORES.items() if on in made},
            "differences": {name: difference(pairs[part][name], pairs[part][first]) for name in others},
        }
    if {"train", "test"} <= set(populations):
        found["gap"] = {name: gap(pairs["train"][name], pairs["test"][name]) for name in methods}
    return found | {"runs": {name: [_about(one) for one in robots] for name, robots in methods.items()}} | stamp()


def _check_given(methods: Any, populations: Any) -> None:
    """A run given twice would count as two seeds that agree."""
    if not isinstance(populations, Mapping):
        raise UsageError('The populations must be a dict by part, such as {"test": population}.')
    for name, robots in methods.items():
        if not isinstance(robots, Sequence):
            raise UsageError(f"The robots of {name} must be a list of runs or players, a seed each.")
        places = [one.folder.resolve() for one in robots if isinstance(one, Run)]
        if twice := [place.name for place in places if places.count(place) > 1]:
            raise UsageError(f"{twice[0]} is given twice as a robot of {name}; its seeds would count twice.")


class Meetings:
    """A Meeting for each way of knowing the person, made when it is needed.

    `plain`, for those who need not know the person, is in the environment of `config`.
    """

    def __init__(self, config: TrainConfig, population: Population, episodes: int):
        self.population, self.episodes = population, episodes
        config = _meeting_config(config, population, visibility="both")
        # Each of the runs may have a clock of its own. The partners' own robots see the task's, or that of the runs.
        for clock in dict.fromkeys((None, config.env.clock)):
            config = dataclasses.replace(config, env=dataclasses.replace(config.env, clock=clock))
            env = Env(config.task, config.engine, config.env, config.task_config)
            if population.observes("robot") <= {env.observation_sizes["robot"]}:
                break
        self.config, self.plain = config, Meeting(env, population, episodes)
        self._made: dict[Any, Meeting] = {(config.env, config.task_config): self.plain}

    def of(self, run: Run) -> Meeting:
        """Where the run's robots meet the partners; raises UsageError if they cannot play there."""
        config = _meeting_config(run.config, self.population)
        key = config.env, config.task_config
        if key not in self._made:
            self._made[key] = Meeting(meeting_env(run, self.population), self.population, self.episodes)
        _check_sizes(run, self._made[key].env, self.population)
        return self._made[key]

    def __call__(self, one: Run | Player, seed: int) -> list[dict[str, np.ndarray]]:
        """What the robot of each of a run's seeds reaches, or a robot by itself, see Meeting."""
        if isinstance(one, Player):
            return [self.plain(one, seed)]
        return [self.of(one)(team["robot"], seed) for team in one.teams()]


def meeting_env(run: Run, population: Population) -> Env:
    """The run's environment with the population's people in place of its own; its robot must be able to play there."""
    config = _meeting_config(run.config, population)
    env = Env(config.task, config.engine, config.env, config.task_config)
    _check_sizes(run, env, population)
    return env


def _check_sizes(run: Run, env: Env, population: Population) -> None:
    if env.observation_sizes["robot"] != run.env.observation_sizes["robot"]:
        preferring = any(person.preference != "none" for person in population.people)
        raise UsageError(
            f"The robot of {run.folder} observes {run.env.observation_sizes['robot']} numbers, but beside these "
            f"partners {env.observation_sizes['robot']}: its people had {'no ' * preferring}preferences."
        )


def kind_of(row: Mapping[str, Any]) -> dict[str, str]:
    """What kind of person a row of a manifest is of: body, preference, and what was taught or the habit, if any."""
    return row["person"] | {name: row[name] for name in ("taught", "habit") if name in row}


def by_partner(measure: Mapping[str, Any]) -> np.ndarray:
    """Means over seeds [partners] of a measure of a report; NaN for those without a number."""
    return np.array(measure["by_pair"], float).mean(0)


def table(found: Mapping[str, Any], part: str = "test") -> tuple[list[str], list[list[str]]]:
    """Head and rows: references, then methods, with means, intervals, the worst tenth, and the share that was hurt."""
    rows = []
    measures = [m for m in SHOWN if any(m in one for one in found[part]["methods"].values())]
    for group in ("references", "methods"):
        for name, one in found[part][group].items():
            cells = [name]
            for measure in measures:
                cells.append(_cell(one[measure]) if measure in one else "")
            cells.append(f"{one['safe_success']['worst']:.0%}" if "safe_success" in one else "")
            cells += [f"{one[hurt]['mean']:.0%}" if hurt in one else "" for hurt in HURT]
            cells.append(f"{one['peak_force']['mean']:.0f}")
            rows.append(cells)
    return ["robot", *(m.replace("_", " ") for m in measures), "worst tenth, safe", *HURT, "peak force, N"], rows


def picture(found: Mapping[str, Any], path: Path) -> None:
    """Safe success, score or return by method, training partners beside held-out ones, a dot for each partner."""
    parts = [part for part in ("train", "val", "test") if part in found]
    names = list(found[parts[-1]]["methods"])
    everywhere = set.intersection(*(set(found[part]["methods"][name]) for part in parts for name in names))
    measure = next(one for one in ("safe_success", "score", "return") if one in everywhere)
    with rc_context(STYLE):
        figure = Figure(figsize=(2.0 + 1.6 * len(names), 3.6), layout="constrained")
        axes = figure.subplots()
        for k, part in enumerate(parts):
            for i, name in enumerate(names):
                one = found[part]["methods"][name][measure]
                x = i + (k - (len(parts) - 1) / 2) * 0.25
                dots = by_partner(one)
                axes.plot(x + np.linspace(-0.06, 0.06, len(dots)), dots, ".", color=f"C{k}", alpha=0.35, ms=4)
                low, high = one["ci"] or (one["mean"], one["mean"])
                error = [[max(one["mean"] - low, 0.0)], [max(high - one["mean"], 0.0)]]
                axes.errorbar(x, one["mean"], error, fmt="o", color=f"C{k}", capsize=3, label=part if i == 0 else None)
        axes.set_xticks(range(len(names)), names)
        axes.set_ylabel(measure.replace("_", " "))
        axes.set_title(f"{found['task']}, 95 % intervals over seeds and partners")
        axes.legend(title="partners")
        save(figure, path, dpi=150)


def _cell(one: Mapping[str, Any]) -> str:
    text = f"{one['mean']:.3g}"
    return text if one["ci"] is None else f"{text} [{one['ci'][0]:.3g}, {one['ci'][1]:.3g}]"


def _about(one: Run | Player) -> dict[str, Any]:
    if isinstance(one, Player):
        return {"policy": type(one.policy).__name__}
    config = one.config
    about: dict[str, Any] = {
        "run": one.folder.name,
        "algorithm": config.algorithm,
        "steps": config.steps,
        "seeds": list(config.seeds),
    }
    if config.env.clock is not None:
        about["clock"] = config.env.clock
    settings = {name: value for name, value in to_json(config).items() if name != "stamp"}
    return about | {"config": hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]}


def _meeting_config(config: TrainConfig, population: Population, **knowing: Any) -> TrainConfig:
    """The run's configuration with the population's people in place of its own."""
    who: dict[str, Any] = {"people": population.people, "weights": (), "disability": "none", "preference": "none"}
    who |= {"random_share": 0.0, "redraw_every": 1}  # which are ways of training
    human = dataclasses.replace(config.env.human, **who, **knowing)
    return dataclasses.replace(config, env=dataclasses.replace(config.env, human=human))
