"""What the scripted policies reach, as a page: `python -m assistax.reference > docs/experts.md`."""

from typing import Any

import jax

from assistax.env import make
from assistax.evaluation import evaluate, play, summarize
from assistax.experts import BOUNDS
from assistax.human import DISABILITIES
from assistax.policies import scripted_team

EPISODES = 64
PAGE = """# Scripted policies

Each task has a scripted robot, the expert, that knows the whole simulator state (`src/assistax/experts.py`).
All numbers are over {episodes} episodes on the evaluation seeds; the person is still unless said otherwise. This page
is written by `python -m assistax.reference > docs/experts.md` in some minutes.

## Expert

{experts}

## Nobody, and noise

Both agents still, and both random:

{nobody}

## Expert with people who differ

The person does nothing on purpose, so weakness and limited range hardly show; tremor moves the arm or head.
Success, and in brackets the mean force in contact in N:

{disabled}

## Considerate expert

The considerate expert knows what the person likes (drawn from the paper's sweep at every reset) and keeps pace and
force inside it; the plain one does not:

{considerate}
"""


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """A table."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))


def experts() -> str:
    head = ["task", "success", "return", "of the paper's bound", "force in contact, N", "95 % below, N", "peak, N"]
    rows = []
    for task, bound in BOUNDS.items():
        report = _play(task, "expert")
        force, value = report["force"], report["mean_return"]
        numbers = [f"{force[name]:.1f}" for name in ("mean_in_contact", "p95")] + [f"{force['peak']:.0f}"]
        rows.append([task, f"{report['success_rate']:.0%}", f"{value:.0f}", f"{value / bound:.0%}", *numbers])
    return markdown(head, rows)


def nobody() -> str:
    rows = []
    for task in BOUNDS:
        reports = [_play(task, policy) for policy in ("still", "random")]
        rows.append([task, *(f"{r['mean_return']:.0f}, success {r['success_rate']:.0%}" for r in reports)])
    return markdown(["task", "still: return", "random: return"], rows)


def disabled() -> str:
    rows = []
    for task in BOUNDS:
        env = make(task, human={"disability": "standard"})
        result = play(env, scripted_team("expert", env), len(DISABILITIES) * EPISODES)
        cells = []
        for index in range(len(DISABILITIES)):
            one = summarize(jax.tree.map(lambda x, who=result["person"] == index: x[who], _per_episode(result)))
            cells.append(f"{one['success_rate']:.0%} ({one['force']['mean_in_contact']:.1f})")
        rows.append([task, *cells])
    return markdown(["task", *DISABILITIES], rows)


def considerate() -> str:
    rows = []
    for task in BOUNDS:
        row = [task]
        for policy in ("expert", "considerate"):
            report = _play(task, policy, human={"preference": "sweep"})
            row += [f"{report[name]['mean']:.0f}" for name in ("task_return", "preference_return")]
            row += [f"{report['success_rate']:.0%}"]
        rows.append(row)
    head = [f"{who}: {what}" for who in ("plain", "considerate") for what in ("task return", "preference", "success")]
    return markdown(["task", *head], rows)


def _play(task: str, policy: str, **settings) -> dict[str, Any]:
    env = make(task, **settings)
    return evaluate(env, scripted_team(policy, env), EPISODES)


def _per_episode(result: dict[str, Any]) -> dict[str, Any]:
    return {name: result[name] for name in ("terms", "metrics", "force", "playing")}


if __name__ == "__main__":
    tables = {"experts": experts(), "nobody": nobody(), "disabled": disabled(), "considerate": considerate()}
    print(PAGE.format(episodes=EPISODES, **tables), end="")
