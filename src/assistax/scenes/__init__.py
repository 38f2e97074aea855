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
    ROBOT_JOINTS,
    ROBOT_TORQUE,
    Posture,
    SceneConfig,
    build,
    qpos_ids,
    sensor_slices,
)

__all__ = [
    "BED_VIEW",
    "HUMAN_JOINTS",
    "HUMAN_TORQUE",
    "LEFT_ARM",
    "MEAL_VIEW",
    "NECK",
    "POSTURES",
    "RIGHT_ARM",
    "ROBOT_JOINTS",
    "ROBOT_TORQUE",
    "Posture",
    "SceneConfig",
    "build",
    "qpos_ids",
    "sensor_slices",
]
