"""Hyperparameters by name, algorithm and task, as data.

`paper` holds the tables of the paper's appendix "Hyperparameters"; where they are silent, the
defaults of PPOConfig stand. `default` holds what has been shown to work better here; so far nothing has.
"""

from typing import Any

from assistax.errors import UsageError, choose

_COLUMNS = ("learning_rate", "update_epochs", "num_minibatches", "clip_eps", "entropy_coef", "num_steps")


def _rows(rows: dict[str, tuple]) -> dict[str, dict[str, Any]]:
    return {task: dict(zip(_COLUMNS, row, strict=True)) for task, row in rows.items()}


_PAPER_IPPO = _rows(
    {
        "scratch": (3.34e-4, 8, 16, 0.169, 1.61e-3, 64),
        "bed_bath": (8.93e-4, 16, 8, 0.042, 6.38e-5, 64),
        "arm_assist": (2.45e-4, 16, 8, 0.021, 1.08e-4, 64),
        "feeding": (3.34e-4, 16, 16, 0.169, 1.61e-3, 64),
        "tooth_brushing": (3.34e-4, 4, 16, 0.169, 1.61e-3, 64),
    }
)
PRESETS: dict[str, dict[str, dict[str, dict[str, Any]]]] = {
    "paper": {"ippo": _PAPER_IPPO},
    "default": {"ippo": _PAPER_IPPO},
}
ALGORITHMS = ("ippo",)


def preset(name: str, algorithm: str, task: str) -> dict[str, Any]:
    """The settings of a preset, by field of the algorithm's configuration."""
    choose("preset", name, PRESETS)
    choose("algorithm", algorithm, ALGORITHMS)
    tasks = PRESETS[name][algorithm]
    if task not in tasks:
        raise UsageError(f"The preset {name!r} has no {algorithm} settings for {task!r}; it has {', '.join(tasks)}.")
    return dict(tasks[task])
