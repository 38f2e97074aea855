"""The assistive tasks, one page each."""

from assistax.errors import choose
from assistax.tasks.scratch import Scratch

TASKS = {task.name: task for task in (Scratch,)}


def task_class(name: str):
    """The class of the task called `name`, or a UsageError that lists them."""
    return TASKS[choose("task", name, TASKS)]
