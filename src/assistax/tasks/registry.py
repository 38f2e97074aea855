"""Which tasks there are, and in which versions.

A version is a row of settings of one class. `scratch-v0` is the paper's; any change to scene, observations, reward or
outcome makes a new one, and a bare name means the newest. Another task is a class with the interface of
`tasks.base.Task`, and a row:

    register_task(TaskSpec("pouring", 0, Pouring, SceneConfig(...)))
"""

import re
from dataclasses import dataclass
from typing import Any

from assistax.errors import UsageError, choose
from assistax.registry import Registry
from assistax.scenes import SceneConfig


@dataclass(frozen=True, eq=False)
class TaskSpec:
    """One version of one task."""

    name: str
    version: int
    task: Any  # class, see `tasks.base.Task`
    scene: SceneConfig
    config: Any = None  # of the class's config_type; its defaults where there is none
    expert: str | None = None  # "module:function" that makes the scripted robot of (env, considerate), if there is one
    bound: float | None = None  # upper bound of the task's return in 1000 steps, if one is known
    preference_budget: float = 1.0  # what preferences pay per step at most
    preferences_need_help: bool = False  # whether they pay only while the robot helps, see Task.helping
    clock: float = 0.0  # Hz, of the clock that the robot sees, for work that goes to and fro; 0: it sees none
    tremor_weakens: bool = False  # whether a weak person trembles less, too
    rest_pays: str | None = None  # the reward term that an episode which the task ends pays for the steps left, too

    def __post_init__(self):
        if not re.fullmatch(r"[a-z][a-z0-9_]*", self.name):
            raise UsageError(f"A task is named in small letters, digits and _, not {self.name!r}.")
        if self.config is None:
            object.__setattr__(self, "config", self.task.config_type())

    @property
    def id(self) -> str:
        return f"{self.name}-v{self.version}"

    @property
    def title(self) -> str:
        return self.task.title


TASKS: Registry[TaskSpec] = Registry("task", lambda spec: spec.id, "assistax.tasks")


def register_task(spec: TaskSpec) -> TaskSpec:
    """Add a task, or a version of one; raises UsageError if its id is taken."""
    return TASKS.register(spec)


def is_task(name: str) -> bool:
    """Whether there is a task of this id or bare name."""
    return name in TASKS or any(spec.name == name for spec in TASKS.values())


def task_spec(name: str) -> TaskSpec:
    """The task with this id, or the newest version of this bare name; raises UsageError if there is none."""
    if name in TASKS:
        return TASKS[name]
    versions = [spec for spec in TASKS.values() if spec.name == name]
    if not versions:
        choose("task", name, [*dict.fromkeys(spec.name for spec in TASKS.values()), *TASKS])
    return max(versions, key=lambda spec: spec.version)


def stored_task(name: str) -> str:
    """The id of a task named in a file: files that name no version are older than versions, and of the paper's."""
    return name if re.search(r"-v\d+$", name) else f"{name}-v0"
