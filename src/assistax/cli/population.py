"""`assistax population ...`: partners as data."""

from pathlib import Path
from typing import Annotated, Any

import tyro

from assistax.cli.common import Count, ExecutorSet, File, Name, Number, Set, Switch, check_alone, find_executor
from assistax.errors import UsageError

Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POP")]
Others = Annotated[tuple[Path, ...], tyro.conf.Positional]


def train(
    task: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="TASK", help_behavior_hint="")] = None,
    *,
    out: File = None,
    people: Name = None,
    algorithm: Name = None,
    steps: Number = None,
    seeds: Number = None,
    num_envs: Number = None,
    taught: Name = None,
    set: Set = (),
    resume: File = None,
    processes: Number = None,
    executor: Name = None,
    executor_set: ExecutorSet = (),
    shard: Name = None,
) -> None:
    """Train a population: a team for each person, algorithm and seed.

    Can be stopped and continued at any moment; what is finished never runs again.

    For example:
      assistax population train scratch --out populations/scratch --steps 5e6 --seeds 2 --processes 2
      assistax population train --resume populations/scratch
      assistax population train --resume populations/scratch --executor slurm --executor-set partition=cpu cores=4

    Args:
      task: what to do together.
      out: folder of the population.
      people: who: 8x3, the default (healthy and the seven standard disabilities, by three preferences), 7x4 (without
        the healthy, by one preference more), 8 or 7 (without preferences), opposite (the eight, gentle and brisk),
        paper630, or a JSON file as for env.human.people.
      algorithm: one, or several with commas: ippo,mappo,masac (default ippo).
      steps: of each training (default 5 million).
      seeds: of each person and algorithm (default 1).
      num_envs: environments side by side, of each training (default as in `assistax train`).
      taught: habits that the people are taught at first, one after the other: offers,offers_second_way,... (default
        none, as who is taught by one script would be like all others).
      set: change any setting of all trainings, for example ppo.gamma=0.98.
      resume: continue this population.
      processes: so many trainings side by side (default as many as there is room for; 1 is this process).
      executor: local (default; each process on cores of its own), slurm or ray; see docs/clusters.md.
      executor_set: settings of the executor, as cores=4; slurm has partition, cores, memory_gb, hours and options, ray
        address and cores, local cores.
      shard: i/n trains the i-th of n equal parts. Without it machines that share a folder share the work, too.
    """
    from assistax.files import writing
    from assistax.human import variety
    from assistax.settings import parse_assignments
    from assistax.teamwork import plan

    if (task is None) == (resume is None):
        raise UsageError("Name a task and --out to begin a population, or --resume POP to continue one.")
    given: dict[str, Any] = {"out": out, "people": people, "algorithm": algorithm, "steps": steps, "seeds": seeds}
    given |= {"num-envs": num_envs, "taught": taught, "set": set or None}
    if resume is not None:
        check_alone(given)
    using = find_executor(processes, executor, executor_set, here=shard is not None)  # asked before anything is written
    if using is not None and shard is not None:
        raise UsageError("Processes share the work among themselves; leave out --shard.")
    part = _shard(shard)
    if task is not None:
        if out is None:
            raise UsageError("Say where the population goes: --out populations/NAME.")
        sizes = 1 if seeds is None else seeds, steps, num_envs
        habits = tuple(taught.split(",")) if taught else ()
        who = variety.people(people or "8x3"), tuple((algorithm or "ippo").split(","))
        wanted = plan.Plan(task, *who, *sizes, parse_assignments(set), habits)
        with writing(out):
            wanted.save(out)
    folder = Path(resume or out or "")
    with writing(folder):
        made = plan.train(folder, part) if using is None else plan.train_with(folder, using, processes)
    if made is None:
        print(f"Not all members are finished yet. Continue with: assistax population train --resume {folder}")
    else:
        print(f"{len(made)} members of {made.task} in {folder}")


def make(folder: Folder, runs: Others, *, habits: Switch = False) -> None:
    """Gather finished runs, each trained with one person, into a population; every seed is a member.

    For example:
      assistax train scratch --set env.human.disability=tremor --out runs/tremor
      assistax train scratch --set env.human.disability=weakness --out runs/weak
      assistax population make populations/two runs/tremor runs/weak

    Args:
      folder: of the new population.
      runs: run folders.
      habits: add the scripted people, see docs/populations.md, with the first run's person's body and preferences.
    """
    from assistax.teamwork.gather import gather
    from assistax.training.run import Run

    if not runs:
        raise UsageError("Name the runs whose teams are to be members, after the population's folder.")
    _save(gather(Run.open(run) for run in runs), folder, habits)


def scripted(
    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")],
    *,
    habits: str,
    out: Path,
    people: str = "8x3",
) -> None:
    """Make a population of people who follow scripts: each person with each habit. Nothing is trained.

    For example:
      assistax population scripted scratch --habits shows,shows_second_way --out populations/showing

    Args:
      task: what to do together.
      habits: with commas, see docs/populations.md.
      out: folder of the population.
      people: who, as in `population train`.
    """
    from assistax.human import variety
    from assistax.tasks import task_spec
    from assistax.training.population import Population

    _save(Population.scripted(task_spec(task).id, variety.people(people), habits.split(",")), out)


def merge(folder: Folder, populations: Others) -> None:
    """Put populations of one task together; who is in two of them is in it once.

    Args:
      folder: of the new population.
      populations: to merge.
    """
    from assistax.training.population import Population

    if not populations:
        raise UsageError("Name the populations to merge, after the folder of the new one.")
    _save(Population.merge([Population.load(one) for one in populations]), folder)


def sample(
    population: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POP")],
    *,
    number: Count,
    out: Path,
    seed: Number = None,
    habits: Switch = False,
) -> None:
    """Draw some members of a population, or of a part of it, into a population of their own.

    For example:
      assistax population sample populations/feeding --number 8 --out populations/eight
      assistax population sample populations/feeding:random/train --number 4 --out populations/four --habits

    Args:
      population: a folder, or a part of it by a split, as wherever a partner is named.
      number: how many members.
      out: folder of the new population.
      seed: of the draw (default 0).
      habits: add the scripted people, see docs/populations.md, with the first member's body and preferences.
    """
    from assistax.training import splits

    _save(splits.named(population)[1].sample(number, seed or 0), out, habits)


def list_(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")] = Path("populations")) -> None:
    """List populations: their tasks, members and sizes.

    Args:
      folder: a population, or a folder with populations in it.
    """
    from assistax.cli.common import aligned
    from assistax.training.population import MANIFEST, Population

    cells = []
    for place in sorted(path.parent for path in (folder / MANIFEST, *folder.glob(f"*/{MANIFEST}")) if path.is_file()):
        found = Population.load(place)
        size = sum(path.stat().st_size for kind in (MANIFEST, "weights-*") for path in place.glob(kind))
        cells.append([str(place), found.task, str(len(found)), str(len(set(found.people))), f"{size / 1e6:.1f} MB"])
    if not cells:
        raise UsageError(f"There is no population in {folder}; `assistax population train` makes one.")
    print(aligned(["population", "task", "members", "people", "size"], cells))


def show(folder: Folder, *, out: File = None) -> None:
    """List the members of a population: who they are, how they were trained, what they reach.

    Args:
      folder: of the population.
      out: a .png, .svg or .pdf of who there is and what they reach.
    """
    from assistax.cli.common import aligned
    from assistax.results.figures import check_format
    from assistax.teamwork.portrait import portrait
    from assistax.training.population import Population

    if out is not None:
        check_format(out)
    found, rows = Population.load(folder), []
    if out is not None:
        portrait(found, out)
    for row in found.rows:
        who, how = row["person"], row.get("habit") or f"{row['algorithm']}, seed {row['seed']}"
        how += f", taught {row['taught']}" if "taught" in row else ""
        cells = [row["id"][:12], who["disability"], who["preference"], how, f"{row['steps'] / 1e6:.1f} M"]
        cells += [f"{row['mean_return']:.0f}" if "mean_return" in row else ""]
        cells += [f"{row[name]:.0%}" if name in row else "" for name in ("success_rate", "safe_success_rate")]
        rows.append(cells)
    print(aligned(["id", "disability", "preference", "how", "steps", "return", "success", "safely"], rows))


def verify(folder: Folder) -> None:
    """Check that all members of a population are as they were saved.

    Args:
      folder: of the population.
    """
    from assistax.training.population import ABOUT, Population, find, is_sealed

    found = Population.load(place := find(folder))
    print(f"{len(found)} members of {found.task}, all as they were saved")
    if not is_sealed(place):
        print(f"What the manifest says they reach is not checked, nor whether somebody is gone: there is no {ABOUT}.")


def split(
    folder: Folder, *, kind: str = "random", crossplay: File = None, out: File = None, seed: Number = None
) -> None:
    """Split a population into members to train with, to develop with and to test with.

    For example:
      assistax population split populations/scratch --kind disability
      assistax train scratch --partner human=populations/scratch:disability/train

    Args:
      folder: of the population.
      kind: random (6 : 2 : 2), extreme (the paper's: train with the five who weigh speed most), interpolate or
        extrapolate (by how hard moving is), disability, preference, algorithm or taught (whole groups left out),
        convention (whole groups of people whom the same robots serve well).
      crossplay: for convention, the .json of `assistax teamwork validity`.
      out: where the split goes, a .json (default: into the population).
      seed: of what is drawn (default 0).
    """
    from assistax.files import read_json
    from assistax.formats import VALIDITY
    from assistax.training import splits
    from assistax.training.population import Population

    played = None if crossplay is None else read_json(crossplay, VALIDITY)
    parts = splits.split(Population.load(folder), kind, seed or 0, played)
    path = out or splits.path_of(folder, kind)
    splits.save(path, parts)
    print(", ".join(f"{len(ids)} to {name}" for name, ids in parts.items()) + f", in {path}")


def push(folder: Folder, name: Annotated[str, tyro.conf.Positional], *, private: Switch = False) -> None:
    """Put a population onto the Hugging Face Hub, as a dataset with a card.

    For example:
      assistax population push populations/feeding somebody/feeding-people

    Args:
      folder: of the population.
      name: OWNER/NAME of the dataset.
      private: for yourself alone, if it is new.
    """
    from assistax.training import hub

    print(f"{name}, commit {hub.push(folder, name, private)}")


def pull(name: Annotated[str, tyro.conf.Positional], *, out: File = None, revision: Name = None) -> None:
    """Fetch a population from the Hugging Face Hub and check that it is as it was saved.

    For example:
      assistax population pull somebody/feeding-people --out populations/feeding

    Args:
      name: OWNER/NAME of the dataset.
      out: folder of the population (default populations/NAME).
      revision: a commit, tag or branch (default the newest).
    """
    from assistax.training import hub

    folder = out or Path("populations") / name.rpartition("/")[2]
    found = hub.pull(name, folder, revision)
    print(f"{len(found)} members of {found.task} in {folder}")


def _save(made, folder: Path, habits: bool = False) -> None:
    """Write a new population, with people with habits if they are wanted, and say who is in it."""
    from assistax.training.population import Population

    if habits:
        made = Population.merge([made, Population.scripted(made.task, [made.people[0]])])
    made.save(folder)
    print(f"{len(made)} members of {made.task} in {folder}")


def _shard(text: str | None) -> tuple[int, int]:
    first, _, number = (text or "1/1").partition("/")
    if not (first.isdigit() and number.isdigit() and 1 <= int(first) <= int(number)):
        raise UsageError(f"--shard is I/N with I from 1 to N, for example 2/4, not {text!r}.")
    return int(first), int(number)


COMMANDS = {
    "train": train,
    "make": make,
    "scripted": scripted,
    "merge": merge,
    "sample": sample,
    "list": list_,
    "show": show,
    "verify": verify,
    "split": split,
    "push": push,
    "pull": pull,
}
