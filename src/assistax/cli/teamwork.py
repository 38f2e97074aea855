"""`assistax teamwork ...`: robots beside people they have never met."""

from pathlib import Path
from typing import Annotated

import tyro

from assistax.cli.common import Count, ExecutorSet, File, Name, Number, Set, aligned, check_alone, find_executor
from assistax.errors import UsageError, choose
from assistax.files import check_folder

Robots = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[NAME=]RUN[,RUN] ...")]
Partners = Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="POP", help_behavior_hint="")]
Methods = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME=]RUN[,RUN] ...")]


def evaluate(
    methods: Methods,
    *,
    population: Annotated[Path, tyro.conf.arg(metavar="POP")],
    split: str = "random",
    part: str = "test",
    episodes: Count = 16,
    best_responses: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN ...")] = (),
    out: File = None,
) -> None:
    """Measure robots with the partners of training and with held-out ones: scores, success, harm, and the gap.

    For example:
      assistax train scratch-v1 --partner human=populations/scratch-v1:random/train --num-seeds 3 --out runs/br
      assistax teamwork evaluate best-response=runs/br --population populations/scratch-v1 --split random

    Args:
      methods: runs whose robots are measured, with the method's name; several runs and all their seeds are one method.
      population: the partners.
      split: of the population, see `assistax population split`.
      part: test for tables, val while developing.
      episodes: with each partner.
      best_responses: runs of robots that were trained with one of these partners, or folders of them as of `teamwork
        best-responses`: a score of 1 is the best of them and of the robot that each partner was trained with; 0 the
        best of the still, the random and the scripted robot.
      out: a .json for all numbers, with a picture of the same name beside it.
    """
    from assistax.files import write_json
    from assistax.teamwork.best_responses import ABOUT, runs_of
    from assistax.teamwork.report import picture, report, table
    from assistax.teamwork.scores import FEWEST
    from assistax.training import splits
    from assistax.training.run import Run

    _check(out, part)
    named = _named(methods)
    populations = {one: splits.named(f"{population}:{split}/{one}")[1] for one in ("train", part)}
    places = [one for p in best_responses for one in (runs_of(p) if (p / ABOUT).exists() else [p])]
    known = {str(place): Run.open(place) for place in places}
    found = report(named, populations, episodes, best_responses=known)
    found |= {"population": population.name, "split": split}
    for one in populations:
        scored = ", ".join(f"{sum(x)} in a {name.replace('_', ' ')}" for name, x in found[one]["scored"].items())
        print(f"{found['task']}, {len(populations[one])} partners to {one}, {episodes} episodes each, 95 % intervals")
        print(aligned(*table(found, one)))
        print(f"Of {len(populations[one])} partners count {scored}; a score needs {FEWEST} or more.\n")
    for name, runs in found["runs"].items():
        if len(steps := sorted({run["steps"] for run in runs if "steps" in run})) > 1:
            print(f"{name}: robots of {steps[0]:,} to {steps[-1]:,} steps are one method here.")
    for name, gaps in found.get("gap", {}).items():
        returns, success = _gap(gaps["return"], ".1f"), _gap(gaps["success"], ".0%")
        regret = f", {_gap(gaps['regret'], '.1f')} of regret" if "regret" in gaps else ""
        print(f"{name}: coordination gap {returns} of return{regret}, {success} of success")
    if out is not None:
        write_json(out, found)
        picture(found, out.with_suffix(".png"))


def best_responses(
    population: Partners = None,
    *,
    split: Name = None,
    part: Name = None,
    out: File = None,
    steps: Number = None,
    set: Set = (),
    resume: File = None,
    processes: Number = None,
    executor: Name = None,
    executor_set: ExecutorSet = (),
) -> None:
    """Train a robot with each of some partners alone: what a score of 1 is worth with them.

    Can be stopped and continued at any moment; what is finished never runs again.

    For example:
      assistax teamwork best-responses populations/scratch-v1 --split taught --out runs/best --processes 2
      assistax teamwork evaluate runs/br --population populations/scratch-v1 --split taught --best-responses runs/best

    Args:
      population: the partners.
      split: of the population, see `assistax population split` (default random).
      part: test, the default, or val.
      out: folder of the robots.
      steps: of each training (default 5 million).
      set: change any setting of all trainings, for example ppo.gamma=0.98.
      resume: continue this folder.
      processes: so many trainings side by side (default as many as there is room for; 1 is this process).
      executor: local (default), slurm or ray; see docs/clusters.md.
      executor_set: settings of the executor, as in `assistax population train`.
    """
    from assistax.files import writing
    from assistax.settings import parse_assignments
    from assistax.teamwork import best_responses as bulk
    from assistax.training import splits

    if (population is None) == (resume is None):
        raise UsageError("Name a population and --out to begin, or --resume FOLDER to continue.")
    given = {"out": out, "split": split, "part": part, "steps": steps, "set": set or None}
    if resume is not None:
        check_alone(given)
    split, part = split or "random", part or "test"
    _check(None, part)
    using = find_executor(processes, executor, executor_set)  # asked before anything is written
    folder = resume or out
    if folder is None:
        raise UsageError("Say where the robots go: --out runs/NAME.")
    with writing(folder):
        if population is not None:
            bulk.begin(folder, splits.named(f"{population}:{split}/{part}")[1], steps, parse_assignments(set))
        through = bulk.train(folder) if using is None else bulk.train_with(folder, using, processes)
    if through:
        print(f"{len(bulk.runs_of(folder))} robots in {folder}, for `assistax teamwork evaluate --best-responses`")
    else:
        print(f"Not all robots are finished yet. Continue with: assistax teamwork best-responses --resume {folder}")


def adapt(
    methods: Methods,
    *,
    population: Annotated[Path, tyro.conf.arg(metavar="POP")],
    split: str = "random",
    part: str = "test",
    in_a_row: Count = 5,
    repeats: Count = 4,
    out: File = None,
) -> None:
    """Let robots play several episodes in a row with each partner, and read from their memory with whom they were.

    For example:
      assistax train feeding --recurrent --partner human=populations/feeding:random/train --out runs/gru \\
          --set env.human.redraw_every=3 env.human.visibility=human
      assistax teamwork adapt gru=runs/gru oracle=runs/oracle --population populations/feeding

    Args:
      methods: runs whose robots are measured, with the method's name, as in `teamwork evaluate`.
      population: the partners.
      split: of the population, see `assistax population split`.
      part: test for tables, val while developing.
      in_a_row: episodes with the same partner, between which a robot keeps its memory.
      repeats: such series with each partner.
      out: a .json for all numbers.
    """
    from assistax.files import write_json
    from assistax.teamwork.adaptation import adaptation
    from assistax.training import splits

    _check(out, part)
    partners = splits.named(f"{population}:{split}/{part}")[1]
    found = adaptation(_named(methods), partners, in_a_row, repeats)
    print(f"{found['task']}, {len(partners)} partners to {part}, {in_a_row} episodes in a row, {repeats} times each")
    rows = []
    for name, one in found["methods"].items():
        read = [one["probe"][what].get("8", one["probe"][what].get("1")) for what in ("preference", "body")]
        measures = [one.get(name, {}).get("by_episode", []) for name in ("score", "return", "safe_success")]
        cells = [" ".join(f"{x:.3g}" for x in measure) for measure in measures]
        rows.append([name, *cells, *("–" if x is None else f"{x:.2f}" for x in read)])
    head = ["robot", "score by episode", "return", "safe success", "preference read (R²)", "body read (R²)"]
    print(aligned(head, rows))
    if out is not None:
        write_json(out, found)


def validity(
    population: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POP")],
    *,
    sample: Number = None,
    episodes: Count = 8,
    robots: Robots = (),
    oracles: Robots = (),
    out: File = None,
) -> None:
    """Ask whether partners matter in a task: what robots lose when they meet each other's people.

    They matter if cross-play loses a fifth of self-play's success, return (above a still robot's) or preference return,
    and everybody's own robot, or an oracle, has a tenth more of it than the best single robot with all of them. What
    preferences pay counts in episodes that succeed.

    For example:
      assistax teamwork validity populations/scratch-v1 --sample 16 --robots best-response=runs/br

    Args:
      population: whose robots and people meet.
      sample: so many members, drawn at random (default all).
      episodes: of each pair.
      robots: runs whose robots may be the best single one, beside the members' own.
      oracles: runs whose robots are told who the person is.
      out: a .json for the matrices, with a picture of the same name beside it.
    """
    from assistax.files import write_json
    from assistax.teamwork.validity import matrix_picture, validity_of
    from assistax.training.population import Population

    _check(out)
    known, told = (_named(texts) if texts else {} for texts in (robots, oracles))
    found = validity_of(Population.load(population), episodes, sample, robots=known, oracles=told)
    for name in found["matrix"]:
        own, cross = found["self_play"][name], found["cross_play"][name]
        print(
            f"{name.replace('_', ' '):24} self-play {own:.3g}, cross-play {cross:.3g}, lost {found['lost'][name]:.0%}; "
            f"best single robot, {found['best_single'][name]['robot']}: {found['best_single'][name]['mean']:.3g}; "
            f"who knows the partner, {found['best_knowing'][name]['robot']}: {found['best_knowing'][name]['mean']:.3g}"
        )
    expert = found["others"]["expert"]["success"]
    print(f"The scripted expert, who knows all that the simulator does, succeeds in {sum(expert) / len(expert):.0%}.")
    where = " and ".join(found["matters_in"]).replace("_", " ")
    print(f"Partners matter, in {where}." if found["valid"] else f"Not valid for ad-hoc scores: {found['why']}.")
    if out is not None:
        write_json(out, found)
        matrix_picture(found, out.with_suffix(".png"))


def _gap(one: dict, form: str) -> str:
    interval = f" [{one['ci'][0]:{form}}, {one['ci'][1]:{form}}]" if one["ci"] else ""
    return f"{one['mean']:{form}}{interval}"


def _check(out: Path | None, part: str = "test") -> None:
    choose("part", part, ["test", "val"])
    if out is not None and out.suffix != ".json":
        raise UsageError(f"--out must be a .json file, not {out}.")
    if out is not None:
        check_folder(out)


def _named(methods: tuple[str, ...]) -> dict:
    """The runs of "NAME=RUN,RUN", by name."""
    from assistax.training.run import Run

    if not methods:
        raise UsageError("Name the runs whose robots are to be measured, for example best-response=runs/br.")
    named: dict[str, list[Run]] = {}
    for text in methods:
        name, equals, places = text.rpartition("=")
        runs = [Run.open(Path(place)) for place in places.split(",")]
        if (label := name if equals else Path(places.split(",")[0]).name) in named:
            raise UsageError(f"Two methods are called {label}; give each a name, NAME=RUN, or put them together.")
        named[label] = runs
    return named


COMMANDS = {"adapt": adapt, "best-responses": best_responses, "evaluate": evaluate, "validity": validity}
