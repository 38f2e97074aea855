"""What stands where: the MJCF parts, the postures, the scene of every task, and rotations."""

from assistax.scenes.build import (
    BED_VIEW,
    HUMAN_JOINTS,
    HUMAN_TORQUE,
    LEFT_ARM,
    MEAL_VIEW,
    NECK,
    POSTURES,
    REGIONS,
    RIGHT_ARM,
    WORKED_ON,
    Posture,
    SceneConfig,
    build,
    qpos_ids,
    sensor_slices,
)
from assistax.scenes.robots import PANDA, ROBOTS, RobotSpec, register_robot

__all__ = [
    "BED_VIEW",
    "HUMAN_JOINTS",
    "HUMAN_TORQUE",
    "LEFT_ARM",
    "MEAL_VIEW",
    "NECK",
    "PANDA",
    "POSTURES",
    "REGIONS",
    "RIGHT_ARM",
    "ROBOTS",
    "WORKED_ON",
    "Posture",
    "RobotSpec",
    "SceneConfig",
    "build",
    "qpos_ids",
    "register_robot",
    "sensor_slices",
]
