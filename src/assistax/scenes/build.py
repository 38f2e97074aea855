"""Scenes: one MuJoCo model per task, composed from the MJCF parts in ``assets/``.

A scene has 16 hinges and nothing else that moves: nine of the person, seven of the robot. Everything a
task may read is a named sensor (see :func:`sensor_slices`); everything an agent drives is an actuator:
first the person's motors (ctrl 1 is full torque; twice that has room for tremor), then the robot's seven; brakes,
where there are any, come last and take no control.

Which geoms touch (contype / conaffinity; two geoms touch if either's type is in the other's affinity):

    class                                     contype  conaffinity   touches
    robot: tool, mount, hand, links 5-7          1          0        arms, trunk, furniture
    person's arm and hand, if driven             2          1        robot, trunk, furniture
    the same, if not driven                      0          1        robot
    person's head, trunk, pelvis, thighs         0          3        robot, driven arm
    seat, back rest, armrests, mattress          0          3        robot, driven arm
    chair's base and headrest, pillow            0          1        robot

So the robot never touches itself, one arm never the other, and nothing touches the floor. A body and its
parent never touch in MuJoCo (upper arm and torso overlap at the shoulder by construction). A driven arm and a mattress
are pairs by name in the end, see :func:`_pair`, and the mattress has conaffinity 1.

What the person does not drive rests on the furniture by springs and joint limits, on the side to which
gravity pulls: a limit costs one constraint row, a limb on two box contacts eight and the search for them.

Units: m, kg, s, rad, N, N m. World frame: z up.
"""

from dataclasses import dataclass, replace
from math import cos, sin
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from assistax.errors import UsageError
from assistax.scenes.person import (
    HUMAN_JOINTS,
    HUMAN_SPEED,
    HUMAN_TORQUE,
    LEFT_ARM,
    POSTURES,
    RIGHT_ARM,
    TOUCHED,
    WORKED_ON,
)
from assistax.scenes.robots import ASSETS, ROBOTS, RobotSpec

NET_FORCE = (1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1)  # data="force" reduce="netforce" num="1"
# Where the robot touches, skin gives way: the less, the deeper (2.4 mm at 3 N). On a hard contact a sliding
# tool chatters: it opens and closes every few steps, and a force cannot be held.
SKIN = (0.01, 0.9, 0.01, 0.5, 2.0)  # solimp
SKIN_FRICTION = 0.3
ARM = 2  # contype of a driven arm
SUPPORT = 0.005  # rad below rest: out of the way while nothing pushes
BRAKE_FROM = 0.85  # of a joint's speed limit, from where its brakes grip
# Gains of brakes, s/rad, times the motor's torque.
ROBOT_BRAKE = 14.0
HUMAN_BRAKE = 4.0  # limbs are light: stiffer, and they bounce


@dataclass(frozen=True)
class SceneConfig:
    """What stands where, and who drives what."""

    furniture: str  # part in assets/
    posture: str  # key of POSTURES
    tool: str  # part in assets/
    robot_pos: tuple[float, float, float]
    robot_yaw: float
    human_driven: tuple[str, ...]  # joints with a motor, in the order of the human's action
    human_strength: float = 1.0  # fraction of HUMAN_TORQUE
    robot: str = "panda"  # of ROBOTS
    ready: tuple[float, ...] | None = None  # rad, where the arm starts; None: at the robot's own ready pose
    targets: tuple[str, ...] = ()  # target sites on the person that become visible and get sensors
    # Body parts, of WORKED_ON, that the tool works on: as seen from them its speed is measured, and on them its force.
    worked_on: tuple[str, ...] = ()
    regions: bool = False  # whether the robot's force is measured on every part of the person, TOUCHED
    throat: bool = False  # whether the robot touches it, or goes through it
    speed_limits: bool = False  # whether joints keep to the robot's speeds and, if driven, to HUMAN_SPEED
    supported: bool = False  # whether furniture holds an arm that is not driven against a push from above
    control: str = "torque"  # or "position": the robot's ctrl is a joint target in rad
    camera: tuple[float, ...] = (1.75, 1.65, 1.45, 0.33, 0.06, 0.62)  # eye and point looked at
    close: tuple[float, ...] = (1.05, 0.75, 1.30, 0.25, 0.02, 0.80)

    @property
    def arm(self) -> RobotSpec:
        """The robot."""
        return ROBOTS[self.robot]

    @property
    def start(self) -> tuple[float, ...]:
        """Where the arm starts, rad."""
        return self.arm.ready if self.ready is None else self.ready

    def __post_init__(self):
        if self.control not in ("torque", "position"):
            raise ValueError(f"control must be 'torque' or 'position', not {self.control!r}")
        if self.posture not in POSTURES:
            raise ValueError(f"posture must be one of {sorted(POSTURES)}, not {self.posture!r}")
        if unknown := set(self.human_driven) - set(HUMAN_JOINTS):
            raise ValueError(f"human_driven holds {sorted(unknown)}; the joints are {HUMAN_JOINTS}")
        if unknown := set(self.worked_on) - set(WORKED_ON):
            raise ValueError(f"worked_on holds {sorted(unknown)}; the body parts are {sorted(WORKED_ON)}")


MEAL_VIEW: dict[str, Any] = {
    "camera": (-1.25, 1.95, 1.55, 0.22, 0.06, 0.68),
    "close": (-0.55, 1.05, 1.35, 0.16, 0.03, 0.95),
}
BED_VIEW: dict[str, Any] = {
    "camera": (0.95, -1.95, 1.65, -0.12, -0.3, 0.66),
    "close": (0.45, -1.15, 1.4, -0.22, -0.32, 0.78),
}


def build(config: SceneConfig, visuals: bool = True) -> mujoco.MjSpec:
    """The scene as an editable spec; ``build(config).compile()`` gives the model.

    Without visuals, what is only seen is left out and fixed bodies are merged: the same states, sensors and
    dynamics, 1.5 times as fast.
    """
    spec = mujoco.MjSpec.from_file(str(ASSETS / "world.xml"))
    world = spec.worldbody
    _attach(spec, config.furniture, world)
    rests = [geom for geom in spec.geoms if geom.conaffinity & ARM]
    _attach(spec, "human", world)
    _attach(spec, config.arm.mjcf, world, config.robot_pos, _turn("z", config.robot_yaw))
    if config.robot_pos[2] > 0:
        _attach(spec, "table", world, (*config.robot_pos[:2], 0.0))
    _attach(spec, config.tool, spec.body("hand"), config.arm.mount, _turn("z", config.arm.mount_yaw))
    for name in config.targets:
        spec.site(name).group = 1
    if config.throat:
        spec.geom("throat").conaffinity = 3
    if not visuals:
        _strip(spec)
    if config.control == "torque":
        # Joint damping is mild enough to be explicit, which saves a factorisation per step; the servo's is not.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    posture = POSTURES[config.posture]
    _pose_human(spec, posture, config.human_driven)
    if len(rests) == 1:
        _pair(spec, *rests)
    if config.supported:
        _support(spec, posture, config.human_driven)
    for body in spec.body("robot").find_all("body"):
        body.gravcomp = not _fixed(body)  # the real arm's torque interface compensates gravity
    for geom in spec.body("robot").find_all("geom"):
        if geom.contype:
            geom.priority, geom.solimp, geom.friction[0] = 1, SKIN, SKIN_FRICTION
    _add_actuators(spec, config)
    if config.speed_limits:
        _limit_speeds(spec, config)
    _add_sensors(spec, config)
    for name, view in (("main", config.camera), ("close", config.close)) if visuals else ():
        world.add_camera(name=name, pos=view[:3], quat=_look(view[:3], view[3:]), fovy=45)
    angles = dict(zip(HUMAN_JOINTS + config.arm.joints, posture.rest + config.start, strict=True))
    spec.add_key(name="start", qpos=[angles[joint.name] for joint in spec.joints])
    return spec


def sensor_slices(model: mujoco.MjModel) -> dict[str, slice]:
    """Where each named sensor lies in ``sensordata``."""
    return {
        model.sensor(i).name: slice(int(adr), int(adr + dim))
        for i, (adr, dim) in enumerate(zip(model.sensor_adr, model.sensor_dim, strict=True))
    }


def limited(scene: SceneConfig, *worked_on: str) -> SceneConfig:
    """The scene with what versions from 1 on need: speeds kept within limits, arms supported, relative speeds and
    forces measured."""
    return replace(scene, worked_on=worked_on, regions=True, speed_limits=True, supported=True)


def qpos_ids(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray:
    """Addresses of the joints in ``qpos``; the same in ``qvel``, as all joints are hinges."""
    return np.array([model.joint(name).qposadr[0] for name in joints])


def _attach(spec, part, parent, pos=(0.0, 0.0, 0.0), quat=(1.0, 0.0, 0.0, 0.0)):
    """A part in assets/ by its name, or the path of an MJCF file."""
    path = part if isinstance(part, Path) else ASSETS / f"{part}.xml"
    if not path.exists():
        raise ValueError(f"no part {str(part)!r}; there are {sorted(p.stem for p in ASSETS.glob('*.xml'))}")
    frame = parent.add_frame(pos=pos, quat=quat)
    spec.attach(mujoco.MjSpec.from_file(str(path)), frame=frame, prefix=f"{path.stem}/")
    for element in (*spec.bodies, *spec.joints, *spec.geoms, *spec.sites):  # names are unique without it
        element.name = element.name.removeprefix(f"{path.stem}/")


def _strip(spec):
    """Leave out what neither touches nor moves a mass, merge bodies that have no joint."""
    for thing in (*spec.lights, spec.body("target")):
        spec.delete(thing)
    for geom in list(spec.geoms):
        if not (geom.contype or geom.conaffinity) and (geom.mass == 0 or _fixed(geom.parent)):
            spec.delete(geom)
    spec.compiler.fusestatic = True


def _fixed(body):
    """Whether no joint lies between a body and the world."""
    return body.name == "world" or (not body.joints and _fixed(body.parent))


def _pose_human(spec, posture, driven):
    """Place the pelvis, bend the fixed joints, set the springs, let rest what is not driven."""
    spec.body("human").pos = posture.pelvis_pos
    spec.body("human").quat = _turn("z", posture.yaw)
    spec.body("pelvis").quat = _turn("y", posture.pelvis_pitch)
    for side in ("right", "left"):
        spec.body(f"{side}_thigh").quat = _turn("y", posture.hip)
        spec.body(f"{side}_shin").quat = _turn("y", posture.knee)
    for name, angle in zip(HUMAN_JOINTS, posture.spring, strict=True):
        spec.joint(name).springref = angle
    for name in set(posture.held) - set(driven):
        joint = spec.joint(name)
        joint.range = (posture.rest[HUMAN_JOINTS.index(name)], joint.range[1])
    for arm, joints in (("right", RIGHT_ARM), ("left", LEFT_ARM)):
        if not set(joints) & set(driven):
            for geom in spec.body(f"{arm}_upper_arm").find_all("geom"):
                geom.contype = 0
    if not set(RIGHT_ARM) & set(driven):
        for right, left in zip(RIGHT_ARM[:2], LEFT_ARM[:2], strict=True):
            spec.joint(right).springref = -spec.joint(left).springref


def _pair(spec, rest):
    """Name the pairs of driven arms' geoms and the only thing that they can lie on.

    By types, MuJoCo compares bounding boxes of the arm and all furniture at every step, only to find the arm where it
    nearly always is; without, a step takes 3 to 5 % less, with the same contacts in the same order. Not so in a chair:
    it has four things to lie on, and most of their pairs are worth a comparison of boxes.
    """
    rest.name = rest.name or "rest"
    for side in ("right", "left"):
        for geom in spec.body(f"{side}_upper_arm").find_all("geom"):
            if geom.contype & ARM:
                spec.add_pair(geomname1=rest.name, geomname2=geom.name)
    rest.conaffinity &= ~ARM


def _support(spec, posture, driven):
    """Stop the shoulders of arms that are not driven a little below rest, as the furniture under them would."""
    for joints, sign in ((RIGHT_ARM, 1.0), (LEFT_ARM, -1.0)):
        if set(joints) & set(driven):
            continue
        for name, down in zip(joints[:2], (sign, -sign), strict=True):
            rest, (low, high) = posture.rest[HUMAN_JOINTS.index(name)], spec.joint(name).range
            stop = rest + down * SUPPORT
            spec.joint(name).range = (low, min(high, stop)) if down > 0 else (max(low, stop), high)


def _add_actuators(spec, config):
    """The person's motors, then the robot's; strength is ``actuator_gainprm[:, 0]``, never the gear."""
    joint = mujoco.mjtTrn.mjTRN_JOINT
    for name in config.human_driven:
        motor = spec.add_actuator(name=name, target=name, trntype=joint, ctrllimited=True, ctrlrange=(-2, 2))
        motor.gainprm[0] = HUMAN_TORQUE * config.human_strength
    robot = config.arm
    if config.control == "position" and not robot.servo_stiffness:
        raise UsageError(f"The robot {robot.name} has no servo: env.control=position is not possible.")
    for i, (name, limit) in enumerate(zip(robot.joints, robot.torque, strict=True)):
        motor = spec.add_actuator(name=name, target=name, trntype=joint, ctrllimited=True)
        if config.control == "torque":
            motor.ctrlrange = (-limit, limit)
            motor.gainprm[0] = 1.0
        else:
            motor.ctrlrange = spec.joint(name).range
            motor.forcelimited, motor.forcerange = True, (-limit, limit)
            motor.gainprm[0] = robot.servo_stiffness[i]
            motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            motor.biasprm[1:3] = -robot.servo_stiffness[i], -robot.servo_damping[i]


def _limit_speeds(spec, config):
    """A pair of brakes on every driven joint: actuators without control.

    A brake's torque grows from nothing a little below the limit: what is left of the motor's fades out, and what
    is above the limit is braked. It never pushes, as its range ends at zero. So steep, it must be integrated
    implicitly, and its range has no other end: an actuator at the end of its range is integrated explicitly, and such
    a brake throws the joint to and fro.
    """
    arm = config.arm
    if not arm.speed:
        raise UsageError(f"The robot {arm.name} has no speeds to keep to; give its RobotSpec some.")
    limits = zip(arm.joints, arm.torque, arm.speed, strict=True)
    robot = [(name, torque, speed, ROBOT_BRAKE) for name, torque, speed in limits]
    human = [(name, HUMAN_TORQUE, HUMAN_SPEED[name], HUMAN_BRAKE) for name in config.human_driven]
    for name, torque, speed, gain in robot + human:
        for end, sign in (("up", 1.0), ("down", -1.0)):
            brake = spec.add_actuator(name=f"brake_{end}_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            brake.gainprm[0], brake.biastype = 0.0, mujoco.mjtBias.mjBIAS_AFFINE
            brake.biasprm[:3] = sign * BRAKE_FROM * speed * gain * torque, 0.0, -gain * torque
            brake.forcelimited = True
            brake.forcerange = (-mujoco.mjMAXVAL, 0.0) if sign > 0 else (0.0, mujoco.mjMAXVAL)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def _add_sensors(spec, config):
    """Motors, tool, arm, mouth, targets, relative velocities; the contact forces last. Joints are read from the state.

    ``tool_force``: net force of the tool's working surface on the person; ``robot_force``: of the whole
    robot on the person; ``tool_force_forearm``: of the working surface on that body alone;
    ``robot_force_head``: of the whole robot on that geom alone (N, world frame).
    """
    kind, obj = mujoco.mjtSensor, mujoco.mjtObj

    def sense(name, type_, objtype, objname, **kwargs):
        spec.add_sensor(name=name, type=type_, objtype=objtype, objname=objname, **kwargs)

    for joint in (*config.human_driven, *config.arm.joints):  # N m, as the actuator exerts it
        sense(f"torque_{joint}", kind.mjSENS_ACTUATORFRC, obj.mjOBJ_ACTUATOR, joint)
    pos, quat = kind.mjSENS_FRAMEPOS, kind.mjSENS_FRAMEQUAT
    sense("tool_pos", pos, obj.mjOBJ_SITE, "tool_tip")
    sense("tool_quat", quat, obj.mjOBJ_SITE, "tool_tip")
    sense("tool_vel", kind.mjSENS_FRAMELINVEL, obj.mjOBJ_SITE, "tool_tip")
    sense("tool_angvel", kind.mjSENS_FRAMEANGVEL, obj.mjOBJ_SITE, "tool_tip")
    for segment in ("upper_arm", "forearm"):  # xbody: the body's own frame, not its centre of mass
        sense(f"{segment}_pos", pos, obj.mjOBJ_XBODY, f"right_{segment}")
        sense(f"{segment}_quat", quat, obj.mjOBJ_XBODY, f"right_{segment}")
    sense("mouth_pos", pos, obj.mjOBJ_SITE, "mouth")
    sense("mouth_quat", quat, obj.mjOBJ_SITE, "mouth")
    for target in config.targets:
        sense(f"{target}_pos", pos, obj.mjOBJ_SITE, target)
        sense(f"{target}_quat", quat, obj.mjOBJ_SITE, target)
        if config.worked_on:
            sense(f"{target}_vel", kind.mjSENS_FRAMELINVEL, obj.mjOBJ_SITE, target)
    for part in config.worked_on:
        # In the part's axes, its own motion and turning taken out: the tool's velocity as the part sees it.
        sense(f"tool_vel_{part}", kind.mjSENS_FRAMELINVEL, obj.mjOBJ_SITE, "tool_tip",
              reftype=obj.mjOBJ_XBODY, refname=WORKED_ON[part])  # fmt: skip
    for name, objtype, objname in (
        ("tool_force", obj.mjOBJ_BODY, "tool"),
        ("robot_force", obj.mjOBJ_XBODY, "robot"),  # in contact sensors, xbody means the whole subtree
    ):
        sense(name, kind.mjSENS_CONTACT, objtype, objname, reftype=obj.mjOBJ_XBODY, refname="human",
              intprm=NET_FORCE)  # fmt: skip
    for geom in _touched(config):
        sense(f"robot_force_{geom}", kind.mjSENS_CONTACT, obj.mjOBJ_XBODY, "robot", reftype=obj.mjOBJ_GEOM,
              refname=geom, intprm=NET_FORCE)  # fmt: skip
    for part in config.worked_on:
        sense(f"tool_force_{part}", kind.mjSENS_CONTACT, obj.mjOBJ_BODY, "tool", reftype=obj.mjOBJ_BODY,
              refname=WORKED_ON[part], intprm=NET_FORCE)  # fmt: skip


def _touched(config):
    """The parts of the person on which the robot's force is measured."""
    return [part for part in TOUCHED if config.regions and (config.throat or part != "throat")]


def _turn(axis, angle):
    """Quaternion of a rotation about a coordinate axis."""
    return [cos(angle / 2)] + [sin(angle / 2) * (axis == name) for name in "xyz"]


def _look(eye, point):
    """Quaternion of a camera at eye, looking at point, upright."""
    back = np.subtract(eye, point) / np.linalg.norm(np.subtract(eye, point))
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.stack([right, np.cross(back, right), back], axis=1).ravel())
    return quat
