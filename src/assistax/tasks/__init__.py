"""The assistive tasks, one page each, and the registry to which others may add theirs."""

from assistax.tasks import arm_assist, bed_bath, feeding, scratch, tooth_brushing
from assistax.tasks.arm_assist import ArmAssist
from assistax.tasks.bed_bath import BedBath
from assistax.tasks.feeding import Feeding
from assistax.tasks.registry import TASKS, TaskSpec, is_task, register_task, stored_task, task_spec
from assistax.tasks.scratch import Scratch
from assistax.tasks.tooth_brushing import ToothBrushing

__all__ = [
    "TASKS",
    "ArmAssist",
    "BedBath",
    "Feeding",
    "Scratch",
    "TaskSpec",
    "ToothBrushing",
    "is_task",
    "register_task",
    "stored_task",
    "task_spec",
]

for _page in (scratch, bed_bath, arm_assist, feeding, tooth_brushing):
    for _spec in _page.SPECS:
        register_task(_spec)
