"""The person's joints and body parts, and how they can sit or lie."""

from dataclasses import dataclass
from math import pi

HUMAN_JOINTS = (
    "neck_yaw", "neck_pitch", "trunk_pitch",
    "right_shoulder1", "right_shoulder2", "right_elbow",
    "left_shoulder1", "left_shoulder2", "left_elbow",
)  # fmt: skip
RIGHT_ARM = ("right_shoulder1", "right_shoulder2", "right_elbow")
LEFT_ARM = ("left_shoulder1", "left_shoulder2", "left_elbow")
NECK = ("neck_yaw", "neck_pitch")
WORKED_ON = {"upper_arm": "right_upper_arm", "forearm": "right_forearm", "head": "head"}  # body parts and their bodies
TOUCHED = (
    "head", "throat", "chest", "belly", "pelvis", "right_thigh", "left_thigh",
    "right_upper_arm", "right_forearm", "right_hand", "left_upper_arm", "left_forearm", "left_hand",
)  # fmt: skip
HUMAN_TORQUE = 10.0  # N m at action 1
HUMAN_SPEED = {**dict.fromkeys(RIGHT_ARM, 4.0), **dict.fromkeys(NECK, 3.0)}  # rad/s


@dataclass(frozen=True)
class Posture:
    """How the person sits or lies. Angles in rad, positive pitch = nodding forward."""

    pelvis_pos: tuple[float, float, float]
    yaw: float  # heading; 0 = facing world x
    pelvis_pitch: float
    hip: float  # thigh relative to the pelvis; negative = thigh raised
    knee: float  # positive = bent
    rest: tuple[float, ...]  # the nine HUMAN_JOINTS in equilibrium on the furniture
    # Their spring references. Right arm: with the support's contact, nothing slides even without friction.
    # Left arm, and mirrored a right arm that is not driven: with the limits of `held`, and no contact.
    spring: tuple[float, ...]
    held: tuple[str, ...]  # joints that rest at their lower limit, if not driven


POSTURES = {
    "seated": Posture(
        pelvis_pos=(0.0, 0.098, 0.6066), yaw=pi / 2, pelvis_pitch=-0.8695, hip=-0.527, knee=1.993,
        rest=(0.0, 0.2, 0.6262, 0.4469, -0.4611, -0.5034, -0.4469, 0.4611, -0.5034),
        spring=(0.0, 0.2, 0.0, -0.5261, 0.3762, 0.0, 2.4926, -2.9741, 0.0),
        held=("trunk_pitch", "right_elbow", "left_elbow"),
    ),
    "lying": Posture(
        pelvis_pos=(0.0, 0.0, 0.765), yaw=0.0, pelvis_pitch=-1.558, hip=0.025, knee=0.02,
        rest=(0.0, 0.0134, 0.1898, 0.6546, -0.7616, -1.4123, -0.6546, 0.7616, -1.4123),
        spring=(0.0, 0.0134, 0.1898, 0.6546, -0.7616, 0.0, -0.6546, -6.3117, 0.0),
        held=("trunk_pitch", "left_shoulder1", "left_elbow"),
    ),
    "lying_arm_out": Posture(
        pelvis_pos=(0.0, 0.0, 0.765), yaw=0.0, pelvis_pitch=-1.558, hip=0.025, knee=0.02,
        rest=(0.0, 0.0134, 0.1898, 0.0074, -0.8984, -1.4854, -0.6546, 0.7616, -1.4123),
        spring=(0.0, 0.0134, 0.1898, 0.0226, -0.8968, 0.0, -0.6546, -6.3117, 0.0),
        held=("trunk_pitch", "left_shoulder1", "left_elbow"),
    ),
}  # fmt: skip
