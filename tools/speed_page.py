"""docs/speed.md: rates of environments and trainings, and what takes the time, from results/bench."""

import json
from pathlib import Path

import numpy as np

from assistax.diagnostics import measurements
from assistax.diagnostics.figure import speeds
from assistax.files import read_json
from assistax.results.comparison import markdown
from assistax.results.figures import save

PAGE = """# Speed

Everything is included: observations, rewards, auto-reset and, open loop, random actions. "Of the bare engine" is the
rate over that of physics alone, same scene and states, in alternating rounds. A training is of IPPO, rollouts and
updates without evaluations; rollouts are environments and policies. Written from `results/bench/*.json`, which
`assistax bench --all --out FILE` makes, by `python tools/pages.py speed`. Rates are of version 1 of the tasks or of
version 0, those of the start-up of a later one.

{machines}

Beside Assistive Gym on two cores (two processes, Panda and acting human, resets not counted), and the paper's figures
for its own implementation on an A100 with 1024 environments. An environment step is 8 ms of 4 physics steps here and
0.1 s of 5 there, so that there are three ratios:

{others}

## Processes and cores

Steps/s of IPPO without evaluations, while it imitates scripted teachers, of all processes together, medians
(`benchmarks/executors.py`, `results/bench/executors`). The trainings above, at commit 56081635354e, had no
teachers. While teachers are followed a training is about half as fast: for 1 M steps in arm assist, feeding and tooth
brushing, and to the end in scratch and bed bath, whose `ppo.teaching_floor` is above 0:

{cores}

On two cores a process for each of them, pinned, has {side} times what one process has with both. Rounds differ by up to
a fifth. More than {bound} times as much cannot be had like this, as one process is {alone} times as fast with both
cores as with one. What more cores would give was not measured. By these numbers it is the following, if of one
process's time for a step a part does not get shorter with more cores (Amdahl's law), and processes with a core each
share nothing. So a list of trainings is shared between a process for each core, unless you say otherwise. Not pinned
these had 5 % more, which is less than rounds differ by; they are pinned so that each has a core of its own.

{predicted}

Sixteen trainings of {jobs_steps} steps, the whole command from an empty cache of compiled programs:

{jobs}

## Start-up

Seconds on the same machine, from an empty cache of compiled programs or, warm, from a filled one
(`benchmarks/start_up.py`, `results/bench/start_up`):

{waits}

A cold start compiles for 54 s of one core: the networks' first state 14, collecting 29, improving 12 (measured once).
XLA shares that between the cores by itself. Compiling all three at once, each in its own thread, made a cold start no
shorter, 55 s and 53 s without (measured once, another day). Nor are LLVM's optimisations what takes long: on a faster
machine the three took 29 s of a core, and 31 without its expensive passes (measured once, with others beside). A warm
start traces and lowers the same programs, which is Python's work and takes one core. Matplotlib and SciPy are imported
after the first update, which saves a tenth of it: 10.4 and 10.4 s before, 9.4 and 9.3 since (measured in turn, once).

## What version 1 costs

Of version 0's rates on one core, with 256 environments, the fastest of {rounds} short rounds in which versions take
turns (`benchmarks/versions.py`, `results/bench/versions`). In all tasks but bed bath most of what version 1 costs are
the brakes that keep joints to their speeds; in bed bath they are 6 of 20 points. In scratch a physics step had 14.6 µs
in version 0 and 16.7 in version 1 (measured once): sensors of harm take 0.4 of these, integrating implicitly, which
brakes need, 1.0, and their 20 actuators 0.8.

{versions}

## What a physics step is made of

Shares of MuJoCo's stages in a physics step with random actions, by `assistax bench TASK --profile`, and how many
contacts and constraints there are on average. Finding collisions takes most in scratch, bed bath and arm assist, and as
much as the solver in feeding and tooth brushing, though hardly anything touches. Of the rest the solver, integration
(implicit, for the tools' and joints' damping), kinematics and velocities take 9 to 18 % each. So no single stage is
worth rewriting. What finding collisions takes is the search for pairs, not the pairs: bounding boxes, and furniture
that MuJoCo compares with arm and robot at every step. Naming arm and mattress as pairs took 3 to 5 % off a physics step
beside the bed (measured once); in the wheelchair the same gains nothing.

{stages}
"""
MACHINE = """## {hardware}, {engine} engine

{tasks}

Open loop by number of environments, steps/s:

{sizes}

![Speed over number of environments](images/{picture}.png)

At commit {commit}."""
ASSISTIVE_GYM = {"scratch": 301, "bed_bath": 138, "arm_assist": 217, "feeding": 326}  # env steps/s
PAPER_A100 = {"scratch": 31_698, "bed_bath": 39_945, "arm_assist": 39_154}  # env steps/s, its table of speeds
TWO_CORES = "two_cores"  # the file that is compared with Assistive Gym


def page(folder: Path, pictures: Path) -> str:
    """The page of speeds; a figure for each machine goes to the folder `pictures`."""
    machines = []
    for path in sorted(folder.glob("*.json")):
        report = read_json(path, measurements.FORMAT)
        picture = f"speed_{path.stem}"
        save(speeds(report), pictures / f"{picture}.png")
        about = {"engine": report["rows"][0]["engine"], "picture": picture}
        machines.append(MACHINE.format(**about, **_machine(report), **report))
    two_cores = read_json(folder / f"{TWO_CORES}.json", measurements.FORMAT)
    others = []
    for task, theirs in ASSISTIVE_GYM.items():
        r = next(rows[0] for name, rows in _rows(two_cores, None).items() if name.startswith(f"{task}-v"))
        rate = r["env_steps_per_s"]
        ratios = rate / theirs, r["physics_steps_per_s"] / (5 * theirs), r["simulated_seconds_per_s"] / (0.1 * theirs)
        paper = f"{rate / PAPER_A100[task]:.2f}x" if task in PAPER_A100 else ""
        others.append([task, *(f"{ratio:.0f}x" if ratio > 10 else f"{ratio:.1f}x" for ratio in ratios), paper])
    head = [
        "task",
        "env steps against Assistive Gym",
        "physics steps",
        "simulated seconds",
        "env steps against the A100",
    ]
    parts = {
        "rounds": json.loads((folder / "versions/one_core.json").read_text())["rounds"],
        "machines": "\n\n".join(machines),
        "others": markdown(head, others),
        "stages": _stages(folder / "profile" / f"{TWO_CORES}.json"),
        "waits": _waits(folder / "start_up" / f"{TWO_CORES}.json"),
        "versions": _versions(folder / "versions/one_core.json"),
        **_arrangements(folder / "executors/two_cores.json"),
    }
    return PAGE.format(**parts)


STARTS = (("", "cold"), (", warm", "warm"))
MORE_CORES = (4, 8, 16, 64)
WAYS = {"here": "one process, both cores", "local": "`local`, two processes", "ray": "`ray`, two workers"}


def _arrangements(path: Path) -> dict[str, str]:
    """Tables: "cores" of steps/s by arrangement, "predicted" of those of more cores, "jobs" of 16 trainings."""
    found = json.loads(path.read_text())
    medians = {task: {how: float(np.median(x)) for how, x in rates.items()} for task, rates in found["cores"].items()}
    names = next(iter(medians.values()))
    cores = [[name, *(f"{rates[name]:,.0f}" for rates in medians.values())] for name in names]
    more = {task: [_more(rates, count) for count in MORE_CORES] for task, rates in medians.items()}
    predicted = [
        [str(count), *(f"{x:,.0f}" for rates in more.values() for x in rates[i])] for i, count in enumerate(MORE_CORES)
    ]
    ((task, jobs),) = found["jobs"].items()
    side = [rates["a process for each core, pinned"] / rates["one process, all cores"] for rates in medians.values()]
    alone = [rates["one process, all cores"] / rates["one process, one core"] for rates in medians.values()]
    rows = [
        [WAYS[name], f"{one['seconds']:.0f}", f"{jobs['here']['seconds'] / one['seconds']:.2f}", str(one["programs"])]
        for name, one in jobs.items()
    ]
    ways = ("one process", "a process for each core")
    return {
        "side": f"{min(side):.2f} to {max(side):.2f}",
        "alone": f"{min(alone):.2f} to {max(alone):.2f}",
        "bound": f"{2.0 / max(alone):.2f} to {2.0 / min(alone):.2f}",
        "cores": markdown(["arrangement", *medians], cores),
        "predicted": markdown(["cores", *(f"{task}, {way}" for task in medians for way in ways)], predicted),
        "jobs_steps": f"{found['steps']:,}",
        "jobs": markdown([task, "s", "of the first one's rate", "programs compiled"], rows),
    }


def _more(rates: dict[str, float], count: int) -> tuple[float, float]:
    """Steps/s on so many cores of one process and of one for each, from `benchmarks/executors.py` on two cores.

    With more cores only a part of one process's time for a step is shared between them.
    """
    two, one, pinned = list(rates.values())[:3]
    shared = min(2 * (1 / one - 1 / two), 1 / one)
    return 1 / (1 / one - shared + shared / count), count * pinned / 2


def _waits(path: Path) -> str:
    """A table of how long one waits."""
    found = json.loads(path.read_text())["seconds"]
    waits = [["`import assistax`", f"{found.pop('import'):.2f}"], ["`assistax --help`", f"{found.pop('help'):.2f}"]]
    for task, wait in found.items():
        waits += [[f"`assistax train {task}`, to its first update{how[0]}", f"{wait[how[1]]:.0f}"] for how in STARTS]
    return markdown(["what", "s"], waits)


def _versions(path: Path) -> str:
    """A table of what version 1 has of version 0's rates, by task."""
    rows = []
    for task, found in json.loads(path.read_text())["tasks"].items():
        shares = [found["env_of_v0"]["v1"], found["env_of_v0"]["unbraked"], found["engine_of_v0"]["v1"]]
        rows.append([task, *(f"{share:.0%}" for share in (*shares, *found["env_over_engine"].values()))])
    head = ["task", "version 1", "without its brakes", "physics alone", "of its bare engine, version 0", "version 1"]
    return markdown([*head, "without brakes"], rows)


def _stages(path: Path) -> str:
    """A table of the shares of a physics step, by task."""
    rows = json.loads(path.read_text())["rows"]
    names = list(rows[0]["physics_step_us"])
    cells = []
    for row in rows:
        times = row["physics_step_us"]
        shares = [f"{times[name] / sum(times.values()):.0%}" for name in names]
        cells.append([row["task"], *shares, f"{row['contacts']:.1f}", f"{row['constraints']:.1f}"])
    return markdown(["task", *names, "contacts", "constraints"], cells)


def _machine(report) -> dict[str, str]:
    """Tables of one file of measurements: tasks at the first size, and open loop at all sizes."""
    opened, ours, papers = (_rows(report, preset) for preset in (None, "default", "paper"))
    tasks, sizes = [], sorted({row["num_envs"] for rows in opened.values() for row in rows})
    for task, (first, *_) in opened.items():
        cells = [f"{first[name]:,}" for name in ("env_steps_per_s", "physics_steps_per_s")]
        cells += [f"{first['simulated_seconds_per_s']:.0f}", f"{first['env_over_engine']:.0%}"]
        for trained in (ours, papers):
            row = trained[task][0] if task in trained else {}
            cells += [f"{row[name]:,}" if row else "" for name in ("training_steps_per_s", "rollout_steps_per_s")]
        tasks.append([task, *cells])
    mean = np.mean([rows[0]["env_steps_per_s"] for rows in opened.values()])
    tasks.append(["mean", f"{mean:,.0f}", *[""] * 7])
    head = ["task", f"env steps/s, {first['num_envs']} environments", "physics steps/s", "simulated s/s"]
    head += ["of the bare engine", "training, `default`", "its rollouts", "training, `paper`", "its rollouts"]
    by_size = []
    for task, rows in opened.items():
        rates = {row["num_envs"]: f"{row['env_steps_per_s']:,}" for row in rows}
        by_size.append([task, *(rates.get(size, "") for size in sizes)])
    return {"tasks": markdown(head, tasks), "sizes": markdown(["task", *(f"{n:,}" for n in sizes)], by_size)}


def _rows(report, preset: str | None) -> dict[str, list[dict]]:
    """By task, what was measured of trainings with a preset, of one seed, or open loop."""
    found: dict[str, list[dict]] = {}
    for row in report["rows"]:
        if row["of"]["preset"] == preset and row["of"]["num_seeds"] in (None, 1):
            found.setdefault(row["task"], []).append(row)
    return found
