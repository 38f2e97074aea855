"""What stands where: the MJCF parts, the postures, the scene of every task, and rotations."""

from assistax.scenes.build import (
    BED_VIEW,
    HUMAN_JOINTS,
    HUMAN_TORQUE,
    LEFT_ARM,
    MEAL_VIEW,
    NECK,
    POSTURES,
    RIGHT_ARM,
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
    "RIGHT_ARM",
    "ROBOTS",
    "Posture",
    "RobotSpec",
    "SceneConfig",
    "build",
    "qpos_ids",
    "register_robot",
    "sensor_slices",
]
