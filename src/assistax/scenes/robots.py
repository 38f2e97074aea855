"""Which robot arms there are. Another one is one MJCF file and one row:

    register_robot(RobotSpec("ur5e", Path("ur5e.xml"), joints=(...), torque=(...), ready=(...)))

The file has a body "robot" that holds the whole arm, with its base at the origin, and in it a body "hand", on which the
tool is mounted. Its joints are hinges; neither actuators nor sensors are in it. Its names are none of those of the
person and the furniture. What is to touch the person has contype 1 and conaffinity 0, what is only seen has neither.
"""

from dataclasses import dataclass
from pathlib import Path

from assistax.errors import UsageError
from assistax.registry import Registry

ASSETS = Path(__file__).parent / "assets"


@dataclass(frozen=True)
class RobotSpec:
    """One arm; all tuples by joint, from the base to the hand."""

    name: str
    mjcf: Path
    joints: tuple[str, ...]
    torque: tuple[float, ...]  # N m, limits of the motors
    ready: tuple[float, ...]  # rad, where it starts unless a scene says otherwise
    speed: tuple[float, ...] = ()  # rad/s, that joints keep to in scenes with speed limits; none: not possible there
    servo_stiffness: tuple[float, ...] = ()  # N m/rad, for control="position"; none: that is not possible
    servo_damping: tuple[float, ...] = ()  # N m s/rad
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, of the tool on the hand
    mount_yaw: float = 0.0  # rad, of the tool about the hand's z axis

    def __post_init__(self):
        optional = ("speed", "servo_stiffness", "servo_damping")
        for name in ("torque", "ready", *optional):
            values = getattr(self, name)
            if len(values) != len(self.joints) and (values or name not in optional):
                raise UsageError(
                    f"{name} of the robot {self.name} has {len(values)} values for {len(self.joints)} joints."
                )


ROBOTS: Registry[RobotSpec] = Registry("robot", lambda robot: robot.name, "assistax.robots")


def register_robot(robot: RobotSpec) -> RobotSpec:
    """Add an arm; raises UsageError if its name is taken."""
    return ROBOTS.register(robot)


PANDA = register_robot(
    RobotSpec(
        "panda",
        ASSETS / "panda.xml",
        joints=tuple(f"joint{i}" for i in range(1, 8)),
        torque=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
        ready=(0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
        speed=(2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
        servo_stiffness=(1433.0, 1433.0, 1115.0, 1115.0, 637.0, 637.0, 637.0),
        servo_damping=(450.0, 450.0, 350.0, 350.0, 200.0, 200.0, 200.0),
        mount=(0.0, 0.0, 0.1),
        mount_yaw=3.141592653589793,
    )
)
