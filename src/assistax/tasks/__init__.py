"""The assistive tasks, one page each."""

from assistax.errors import choose
from assistax.tasks.arm_assist import ArmAssist
from assistax.tasks.bed_bath import BedBath
from assistax.tasks.feeding import Feeding
from assistax.tasks.scratch import Scratch
from assistax.tasks.tooth_brushing import ToothBrushing

TASKS = {task.name: task for task in (Scratch, BedBath, ArmAssist, Feeding, ToothBrushing)}


def task_class(name: str):
    """The class of the task called `name`, or a UsageError that lists them."""
    return TASKS[choose("task", name, TASKS)]
