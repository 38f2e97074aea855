"""What stands where: the MJCF parts, the postures, the scene of every task, and rotations."""

from assistax.scenes.build import BED_VIEW, MEAL_VIEW, SceneConfig, build, limited, qpos_ids, sensor_slices
from assistax.scenes.person import (
    HUMAN_JOINTS,
    HUMAN_SPEED,
    HUMAN_TORQUE,
    LEFT_ARM,
    NECK,
    POSTURES,
    RIGHT_ARM,
    TOUCHED,
    WORKED_ON,
    Posture,
)
from assistax.scenes.robots import PANDA, ROBOTS, RobotSpec, register_robot

__all__ = [
    "BED_VIEW",
    "HUMAN_JOINTS",
    "HUMAN_SPEED",
    "HUMAN_TORQUE",
    "LEFT_ARM",
    "MEAL_VIEW",
    "NECK",
    "PANDA",
    "POSTURES",
    "RIGHT_ARM",
    "ROBOTS",
    "TOUCHED",
    "WORKED_ON",
    "Posture",
    "RobotSpec",
    "SceneConfig",
    "build",
    "limited",
    "qpos_ids",
    "register_robot",
    "sensor_slices",
]
