"""Pages of the documentation that are made from the code and from what was measured, not typed:

python tools/pages.py measure   # results/experts.json, some minutes
python tools/pages.py experts   # docs/experts.md, from it
python tools/pages.py speed     # docs/speed.md, from results/bench
python tools/pages.py results   # docs/results.md and its curves, from results/
python tools/pages.py populations  # docs/partners.md and its pictures, from populations/ and results/teamwork
python tools/pages.py strangers # docs/strangers.md and its pictures, from results/teamwork
python tools/pages.py tasks     # docs/tasks/ and its pictures, from the tasks
python tools/pages.py notebook  # docs/first_steps.ipynb, from the page
"""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import notebook
import population_page
import speed_page
import strangers_page
import task_pages

from assistax.env import make
from assistax.errors import choose
from assistax.evaluation import evaluate
from assistax.experiments import NEED_TWO
from assistax.files import read_json, write_atomically
from assistax.human import DISABILITIES
from assistax.policies import scripted_team
from assistax.policies.habits import HABITS
from assistax.policies.player import Team
from assistax.policies.scripted import scripted_player
from assistax.results.comparison import REFERENCES, markdown, read_references, report, tables
from assistax.results.figures import learning_curves, save
from assistax.results.stored import experiments, find_runs
from assistax.stamp import commit
from assistax.tasks import TASKS, task_spec
from assistax.teamwork import crossplay

EPISODES = 64
BESIDE = " beside "  # in the name of a scripted robot and a person with a habit
BOUNDS = {spec.name: spec.bound for spec in TASKS.values() if spec.version == 0}
NEWEST, PAPER = ({name: task_spec(f"{name}{which}").id for name in BOUNDS} for which in ("", "-v0"))
EXPERTS_PAGE = """# Scripted policies

Each task has a scripted robot, the expert, that knows the whole simulator state (`src/assistax/policies/experts/`), and
scripted people (`src/assistax/policies/people.py`). All numbers are over {episodes} episodes on the evaluation seeds.
This page is written by `python tools/pages.py experts` from `results/experts.json`.

# The newest versions

## The expert, and a person who works with it or does not

Success, its 95 % interval, and safe success. A person who is *still* does nothing on purpose; one who *offers* moves
into a posture in which the robot can reach what it is to work on (the face turned, the arm turned or lifted; postures
by inverse kinematics over both bodies, `tools/offers.py`), at 1.5 rad/s, or *slowly* at 0.3 rad/s; one who *draws back*
moves away from the tool. What lies between still and offers is what the person's help is worth to this robot: much in
scratch and bed bath, nothing in the other three tasks. Robots that learn need it less in scratch
([findings](findings.md#what-the-persons-help-is-worth)).

{pairs}

What the pair of expert and offering person earns and does to the body:

{offered}

## The expert beside people with habits

Where the person's help is worth much, it matters how and when they help ([who they
are](populations.md#people-with-habits)). Bed bath has three ways of offering, so that the fourth is the usual one
there. Success, its 95 % interval, and safe success:

{habits}

## Nobody, and noise

Both agents still, and both random:

{nobody}

## An offering person with a disability

Success, and in brackets the mean force in contact in N:

{disabled}

## With preferences

Drawn from the paper's sweep at every reset. The considerate expert knows them and keeps speed and force inside; the
plain one does not. The person is still, but in the columns that begin with "offer": there the plain expert works with a
person who offers.

{considerate}

# Version 0

The person is still.

{experts_v0}

{nobody_v0}

With preferences:

{considerate_v0}
"""


def measure(path: Path = REFERENCES) -> str:
    """What scripted policies reach with whom: adds to the records in results/experts.json those that it lacks.

    Remove some of its records to measure anew; those of former versions were made when these were the newest.
    """
    records = read_references(path)
    known = {json.dumps([r["task"], r["policy"], r["human"]]) for r in records}
    for task in NEWEST.values():
        plain = ("still", "random", "expert", "offer", "offer_slowly", "withdraw")
        wanted = [(policy, {}) for policy in plain]
        wanted += [(policy, {"preference": "sweep"}) for policy in ("expert", "considerate", "offer")]
        wanted += [("offer", {"disability": disability}) for disability in DISABILITIES]
        if task_spec(task).name in NEED_TWO:
            wanted += [(f"expert{BESIDE}{habit}", {}) for habit in HABITS]
        for policy, human in wanted:
            person = {"disability": "none", "preference": "none", "people": "none"} | human
            if json.dumps([task, policy, person]) in known:
                continue
            env = make(task, human=human)
            report = evaluate(env, team_of(policy, env), EPISODES)
            records.append({"task": task, "policy": policy, "human": person, **report, "commit": commit()})
            write_atomically(path, (json.dumps(records, indent=1) + "\n").encode())
            print(task, policy, human, f"success {report['success_rate']:.0%}", flush=True)
    return json.dumps(records, indent=1) + "\n"


def team_of(policy: str, env) -> Team:
    """A scripted team, or a scripted robot BESIDE a person with a habit."""
    if BESIDE not in policy:
        return scripted_team(policy, env)
    return {
        agent: scripted_player(name, env, agent) for agent, name in zip(env.agents, policy.split(BESIDE), strict=True)
    }


def experts(records: list[dict[str, Any]]) -> str:
    """The page of the scripted policies."""

    def find(task, policy, **human):
        person = {"disability": "none", "preference": "none", "people": "none"} | human
        return next(r for r in records if (r["task"], r["policy"], r["human"]) == (task, policy, person))

    def percent(report, safe=False):
        low, high = report["success_ci"]
        both = f" [{low:.0%}, {high:.0%}]"
        return f"{report['success_rate']:.0%}{both}" + (f"; {report['safe_success_rate']:.0%}" if safe else "")

    def disabled():
        rows = []
        for task in NEWEST.values():
            reports = [find(task, "offer", disability=name) for name in DISABILITIES]
            told = (f"{r['success_rate']:.0%} ({r['force']['mean_in_contact']:.1f})" for r in reports)
            rows.append([task, *told])
        return markdown(["task", *DISABILITIES], rows)

    def habits():
        tasks = [NEWEST[task] for task in NEED_TWO]
        rows = []
        for habit in HABITS:
            reports = [find(task, f"expert{BESIDE}{habit}") for task in tasks]
            rows.append([f"`{habit}`", *(percent(report, safe=True) for report in reports)])
        return markdown(["person", *tasks], rows)

    def nobody(versions):
        rows = []
        for task in versions.values():
            reports = [find(task, policy) for policy in ("still", "random")]
            told = (f"{r['mean_return']:.0f}, success {r['success_rate']:.0%}" for r in reports)
            rows.append([task, *told])
        return markdown(["task", "still: return", "random: return"], rows)

    def considerate(versions, policies):
        rows = []
        for task in versions.values():
            row = [task]
            for policy in policies:
                report = find(task, policy, preference="sweep")
                row += [f"{report[name]['mean']:.0f}" for name in ("task_return", "preference_return")]
                row += [f"{report['success_rate']:.0%}"]
            rows.append(row)
        told = ("task return", "preference", "success")
        return markdown(["task", *(f"{who}: {what}" for who in policies for what in told)], rows)

    def forces(report):
        force = report["force"]
        return [f"{force[name]:.1f}" for name in ("mean_in_contact", "p95")] + [f"{force['peak']:.0f}"]

    pairs, offered, plain = [], [], []
    for task, bound in BOUNDS.items():
        newest = NEWEST[task]
        met = [find(newest, policy) for policy in ("expert", "offer", "offer_slowly", "withdraw")]
        pairs.append([newest, *(percent(report, safe=True) for report in met)])
        report, full = met[1], task_spec(newest).bound
        harmed = [f"{report['harm'][name]['mean']:.2f}" for name in ("seconds_above_comfort", "clamping", "impact")]
        earned = [f"{report['mean_return']:.0f}", f"{report['mean_return'] / full:.0%}"]
        offered.append([newest, *earned, *forces(report), *harmed])
        report = find(PAPER[task], "expert")
        earned = [f"{report['mean_return']:.0f}", f"{report['mean_return'] / bound:.0%}"]
        plain.append([PAPER[task], f"{report['success_rate']:.0%}", *earned, *forces(report)])
    force = ["force in contact, N", "95 % below, N", "peak, N"]
    harm = ["seconds above comfort", "episodes with clamping", "with impact"]
    return EXPERTS_PAGE.format(
        episodes=EPISODES,
        pairs=markdown(["task", "still", "offers", "offers slowly", "draws back"], pairs),
        offered=markdown(["task", "return", "of the bound", *force, *harm], offered),
        nobody=nobody(NEWEST),
        disabled=disabled(),
        habits=habits(),
        considerate=considerate(NEWEST, ("expert", "considerate", "offer")),
        experts_v0=markdown(["task", "success", "return", "of the paper's bound", *force], plain),
        nobody_v0=nobody(PAPER),
        considerate_v0=considerate(PAPER, ("expert", "considerate")),
    )


RESULTS_PAGE = """# Trained teams

Returns and success over the evaluation seeds at the end of training, deterministic, with 95 % intervals over training
seeds; a row with one seed has none. The last columns say when 90 % of the episodes of an evaluation were first a
success, from version 1 on a safe one. Written from `results/` by `python tools/pages.py results`;
[findings.md](findings.md) tells what these teams do.

## Versions from 1 on

{newest}

{remarks_newest}

![Learning curves of the versions from 1 on](images/learning_curves_helping.png)

## Version 0, the paper's

{tables}

{remarks}

![Learning curves](images/learning_curves.png)

Longer runs by themselves:

![Learning curves of longer runs](images/learning_curves_long.png)

A training that was evaluated only at its end has no curve.

### Cross-play

Return, and success in brackets, when the robot of one team (row) meets the person of another (column);
[findings.md](findings.md#who-can-work-with-whom) tells what that says. Self-play are the pairs that belong together.
"trained" is the team that comes with the package, "expert" the scripted robot and a still person.

{crossplay}
"""
SHORT = 10_000_000  # steps; beside longer runs one could not see how these learn


def results(folder: Path, pictures: Path) -> str:
    """The page of the trained teams; their learning curves go to the folder `pictures`."""
    every, references = experiments(find_runs((folder,))), read_references()
    found = [e for e in every if e.version == 0]
    results = report(found, references, compare=False)
    evaluated = [e for e in found if all(run.rows("evaluations") for run in e.runs)]
    for name, long in {"learning_curves": False, "learning_curves_long": True}.items():
        shown = [e for e in evaluated if (e.method.steps > SHORT) == long]
        save(learning_curves(shown, references, source="evaluation"), pictures / f"{name}.png")
    ours = experiments(find_runs(sorted(folder.glob("version[0-9]*"))))
    newest = report(ours, references, compare=False)
    shown = [e for e in ours if all(run.rows("evaluations") for run in e.runs)]
    save(learning_curves(shown, references, source="evaluation"), pictures / "learning_curves_helping.png")
    files = [folder / "crossplay" / f"{task}.json" for task in BOUNDS]
    meetings = [read_json(path, {str: object}) for path in files if path.exists()]
    return RESULTS_PAGE.format(
        newest="\n\n".join(markdown(*each) for each in tables(newest)),
        remarks_newest="\n".join(f"- {remark}" for remark in newest["remarks"]),
        tables="\n\n".join(markdown(*each) for each in tables(results)),
        remarks="\n".join(f"- {remark}" for remark in results["remarks"]),
        crossplay="\n\n".join(f"#### {one['task']}\n\n{markdown(*crossplay.table(one))}" for one in meetings),
    )


def one(place: Path, make_page: Callable[[], str]) -> Callable[[], dict[Path, str | bytes]]:
    return lambda: {place: make_page()}


# By name what makes the files [path, content].
PAGES: dict[str, Callable[[], Mapping[Path, str | bytes]]] = {
    "measure": one(REFERENCES, measure),
    "experts": one(Path("docs/experts.md"), lambda: experts(read_references())),
    "speed": one(Path("docs/speed.md"), lambda: speed_page.page(Path("results/bench"), Path("docs/images"))),
    "results": one(Path("docs/results.md"), lambda: results(Path("results"), Path("docs/images"))),
    "populations": one(
        Path("docs/partners.md"),
        lambda: population_page.page(Path("populations"), Path("results/teamwork"), Path("docs/images")),
    ),
    "strangers": one(
        Path("docs/strangers.md"), lambda: strangers_page.page(Path("results/teamwork"), Path("docs/images"))
    ),
    "notebook": one(notebook.NOTEBOOK, lambda: notebook.notebook(notebook.PAGE.read_text())),
    "tasks": lambda: {**task_pages.pages(), **task_pages.pictures()},
}

if __name__ == "__main__":
    for path, content in PAGES[choose("page", sys.argv[-1], PAGES)]().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content if isinstance(content, bytes) else content.encode())
        print(f"wrote {path}")
