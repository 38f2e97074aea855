"""What stands where: the MJCF parts, the postures, the scene of every task, and rotations."""

from assistax.scenes.build import (
    HUMAN_JOINTS,
    HUMAN_TORQUE,
    LEFT_ARM,
    NECK,
    POSTURES,
    RIGHT_ARM,
    ROBOT_JOINTS,
    ROBOT_TORQUE,
    SCENES,
    Posture,
    SceneConfig,
    build,
    qpos_ids,
    sensor_slices,
)

__all__ = [
    "HUMAN_JOINTS",
    "HUMAN_TORQUE",
    "LEFT_ARM",
    "NECK",
    "POSTURES",
    "RIGHT_ARM",
    "ROBOT_JOINTS",
    "ROBOT_TORQUE",
    "SCENES",
    "Posture",
    "SceneConfig",
    "build",
    "qpos_ids",
    "sensor_slices",
]
