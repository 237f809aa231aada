"""Hands of real robots: one class, which mounts a hand of MuJoCo Menagerie on the gantry, and a
table for each hand.

Fifteen joints flex, the others stay where the table has them. The collision geoms are also drawn:
the model's primitives, and boxes and capsules around its meshes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from dynahoi_lerobot.core.conventions import FINGERS, JOINT_NAMES
from dynahoi_lerobot.core.registry import known
from dynahoi_lerobot.hands import base
from dynahoi_lerobot.hands.base import HAND_GEOM_PREFIX, HANDS, Hand


@dataclass(frozen=True)
class RobotFinger:
    """One finger, in the model's names.

    Attributes:
        joints: the three that flex, from the palm outwards.
        full_closure_rad: (3,) how far they turn until the hand is fully closed [rad].
        tip: a site whose z points along the finger, or (3,) the end of its middle line in the last
            joint's body [m].
    """

    joints: tuple[str, str, str]
    full_closure_rad: tuple[float, float, float]
    tip: str | tuple[float, float, float]


@dataclass(frozen=True)
class RobotHand(Hand):
    """A hand of MuJoCo Menagerie; the attributes are its table. Couplings and torque limits are the
    model's own.

    Angles count from the open hand, and positive ones close it: a joint that reaches farther in the
    model's negative direction is turned round. Joints that one tendon of the model pulls follow the
    mean of their commands: the motor has one torque for both, and contact decides how
    they share it.

    Attributes:
        summary: one sentence, for ``dynahoi list hands``.
        model, entry: the model in Menagerie, and its entry point with a left hand alone.
        palm: the body that the fingers grow from.
        palm_pos_m, palm_quat: (3,) and (4,) wxyz, its frame in the palm's, which has its origin in
            the middle of the grasp volume, x out of the palm, y along the straight fingers and z
            towards the index finger.
        fingers: by name, as in ``conventions.FINGERS``.
        rest_rad: joint angles of the open hand [rad], zero where nothing is said; joints that do
            not flex stay there.
    """

    summary: str
    model: str
    entry: str
    palm: str
    palm_pos_m: tuple[float, float, float]
    palm_quat: tuple[float, float, float, float]
    fingers: Mapping[str, RobotFinger]
    rest_rad: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise a ValueError if the table lacks a finger, or a finger does not have three joints of
        its own.
        """
        missing = [finger for finger in FINGERS if finger not in self.fingers]
        if missing:
            raise ValueError(
                f"the hand {self.model!r} has the fingers {', '.join(self.fingers)} and no "
                f"{' or '.join(missing)}, but "
                f"observations and actions have three joints for each of {', '.join(FINGERS)}"
            )
        joints = {name: self.fingers[name].joints for name in FINGERS}
        for name, three in joints.items():
            others = {joint for other in FINGERS if other != name for joint in joints[other]}
            if len(set(three) - others) != 3 or len(three) != 3:
                raise ValueError(
                    f"the {name} of the hand {self.model!r} has the joints {', '.join(three)}, "
                    f"but every finger needs "
                    "three joints that no other finger has"
                )

    @property
    def full_closure_rad(self) -> Mapping[str, tuple[float, float, float]]:
        """(3,) joint angles of each finger when the hand is fully closed [rad]."""
        return {name: finger.full_closure_rad for name, finger in self.fingers.items()}

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add palm, fingers, servos, sites and the ego camera to ``spec``.

        Raises:
            ValueError: if the model cannot be had, or lacks a joint, the palm or a tip of the
                table; the message says what to do.
        """
        robot = _load(self.model, self.entry)
        names = dict(
            zip(
                (joint for name in FINGERS for joint in self.fingers[name].joints),
                JOINT_NAMES,
                strict=True,
            )
        )
        joints = {joint.name: joint for joint in robot.joints}
        for name in dict.fromkeys((*names, *self.rest_rad)):
            joint = known(f"joint of {self.model}", name, joints)
            _turn(robot, joint, self.rest_rad.get(name, 0.0))
        self._check_parts(robot)
        motors = {joint: _motor(robot, joint) for joint in names}
        frame = _reduce(robot, self.palm, names)
        frame.pos = self.palm_pos_m
        frame.quat = self.palm_quat
        model = _fit_meshes(robot)
        palm = base.add_palm(spec, float(model.body_mass.sum()))
        for option in ("integrator", "cone", "impratio"):
            setattr(robot.option, option, getattr(spec.option, option))
        palm.attach_frame(frame, HAND_GEOM_PREFIX)
        for geom in palm.find_all("geom"):
            geom.rgba = (1.0, 1.0, 1.0, 1.0)
            geom.group = base.SHOWN_GROUP
            geom.material = ""
        for body in palm.find_all("body"):
            body.gravcomp = 1.0
        for source, name in names.items():
            joint, (shares, torque_nm) = spec.joint(HAND_GEOM_PREFIX + source), motors[source]
            low, high = joint.range - self.rest_rad.get(source, 0.0)
            if -low > high:
                low, high, joint.axis = -high, -low, -joint.axis
            joint.name = name
            joint.range = (min(low, base.IDLE_RANGE_RAD), high)
            inertia = max(float(model.joint(other).M0[0]) for other in shares)
            servo = base.add_servo(spec, name, inertia, base.FINGER_BANDWIDTH_RAD_S, torque_nm)
            if len(shares) > 1:
                servo.target = f"{name}_motor"
                servo.trntype = mujoco.mjtTrn.mjTRN_TENDON
                tendon = spec.add_tendon(name=servo.target)
                for other, share in shares.items():
                    tendon.wrap_joint(names[other], share)
        for name in FINGERS:
            spec.joint(f"{name}_base").parent.name = f"{name}_base"
            last = spec.joint(f"{name}_tip").parent
            tip = self.fingers[name].tip
            if isinstance(tip, str):
                spec.site(HAND_GEOM_PREFIX + tip).name = f"{name}_tip"
            else:
                last.add_site(name=f"{name}_tip", pos=tip, quat=base.quat_z_to(np.array(tip)))

    def _check_parts(self, robot: mujoco.MjSpec) -> None:
        """Raise a ValueError if the model lacks the palm or a tip."""
        known(f"body of {self.model}", self.palm, {body.name: body for body in robot.bodies})
        for tip in (self.fingers[name].tip for name in FINGERS):
            if isinstance(tip, str):
                known(f"site of {self.model}", tip, {site.name: site for site in robot.sites})


def _load(model: str, entry: str) -> mujoco.MjSpec:
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise ValueError(
            f"the hand {model!r} needs MuJoCo Menagerie, which the extra `hands` installs: "
            "pip install '.[hands]', in a checkout"
        ) from error
    try:
        return mujoco_menagerie.get(model).spec(entry)
    except mujoco_menagerie.UnknownRobotError as error:
        raise ValueError(
            f"cannot get the hand {model!r}: {error} RobotHand mounts models that "
            f"`mujoco-menagerie names` lists; any "
            "other is a Hand"
        ) from error
    except mujoco_menagerie.MenagerieError as error:
        raise ValueError(
            f"cannot get the hand {model!r}: {error}; connect to the network once to download "
            f"it, or let "
            "MENAGERIE_ROOT name a folder with a copy of MuJoCo Menagerie"
        ) from error


def _turn(robot: mujoco.MjSpec, joint: mujoco.MjsJoint, angle: float) -> None:
    """Turn the body of a joint by an angle [rad], from which the joint then counts."""
    body = joint.parent
    quat = body.quat
    if body.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:  # Euler angles, axes or the like
        compiler = robot.compiler
        resolved = robot.resolve_orientation(compiler.degree, compiler.eulerseq, body.alt)
        quat = np.array(resolved)
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    turn = np.zeros(4)
    turned = np.zeros(4)
    shift = np.zeros(3)
    mujoco.mju_axisAngle2Quat(turn, joint.axis, angle)
    mujoco.mju_mulQuat(turned, quat, turn)
    mujoco.mju_rotVecQuat(shift, joint.pos, turn)
    mujoco.mju_rotVecQuat(shift, joint.pos - shift, quat)
    body.pos, body.quat = body.pos + shift, turned


def _motor(robot: mujoco.MjSpec, joint: str) -> tuple[dict[str, float], float]:
    """Return the share of each joint that moves with this one in what its motor pulls, and the
    motor's limit [N m].
    """
    shares = {joint: 1.0}
    limits = [robot.joint(joint).actfrcrange[1]]
    for actuator in robot.actuators:
        pulled = {actuator.target: 1.0}
        if actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON:
            pulled = {wrap.target.name: wrap.coef for wrap in robot.tendon(actuator.target).path}
        if joint in pulled:
            whole = sum(pulled.values())
            shares = {name: part / whole for name, part in pulled.items()}
            limits.append(
                actuator.forcerange[1] * whole / len(pulled)
            )  # each of its joints gets a servo
    return shares, float(min(filter(None, limits)))


def _reduce(robot: mujoco.MjSpec, palm: str, flexing: Mapping[str, str]) -> mujoco.MjsFrame:
    """Leave what collides, with its mass, and the joints that flex; fuse what cannot move; return
    the palm's frame.
    """
    for body in robot.bodies[1:]:
        if not body.explicitinertial:
            robot.adopt_inertial(body)
    fixed = [joint for joint in robot.joints if joint.name not in flexing]
    for part in [
        *robot.actuators,
        *robot.tendons,
        *robot.excludes,
        *robot.sensors,
        *robot.keys,
        *fixed,
    ]:
        robot.delete(part)
    robot.discard_visual()
    robot.body(palm).fuse = False
    robot.fuse_static()
    return robot.body(palm).to_frame()


def _fit_meshes(robot: mujoco.MjSpec) -> mujoco.MjModel:
    """Put boxes around meshes of the palm and capsules around meshes of fingers; return the
    compiled model.
    """
    robot.compiler.fitaabb = True
    meshes = [geom for geom in robot.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]
    for number, geom in enumerate(robot.geoms):
        geom.name = str(number)
    for geom in meshes:
        of_palm = geom.parent == robot.worldbody
        geom.type = mujoco.mjtGeom.mjGEOM_BOX if of_palm else mujoco.mjtGeom.mjGEOM_CAPSULE
    model = robot.compile()
    for geom in meshes:
        fitted = model.geom(geom.name)
        geom.meshname = ""
        geom.size = fitted.size
        geom.pos = fitted.pos
        geom.quat = fitted.quat
    for mesh in list(robot.meshes):
        robot.delete(mesh)
    return model


SHARPA_THUMB = ("left_thumb_CMC_FE", "left_thumb_MCP_FE", "left_thumb_IP")


def _sharpa_finger(name: str) -> RobotFinger:
    joints = (f"left_{name}_MCP_FE", f"left_{name}_PIP", f"left_{name}_DIP")
    return RobotFinger(joints, (1.15, 1.35, 1.0), f"left_{name}_fingertip")


HANDS.register("sharpa")(
    RobotHand(
        summary="The Sharpa Wave of MuJoCo Menagerie.",
        model="sharpa_wave",
        entry="left_hand",
        palm="left_hand_C_MC",
        palm_pos_m=(-0.046, -0.0835, 0.0),
        palm_quat=(0.5**0.5, -(0.5**0.5), 0.0, 0.0),
        fingers={
            "thumb": RobotFinger(SHARPA_THUMB, (1.0, 0.9, 0.8), "left_thumb_fingertip"),
            **dict(
                zip(
                    FINGERS[1:],
                    map(_sharpa_finger, ("index", "middle", "ring", "pinky")),
                    strict=True,
                )
            ),
        },
    )
)


def _shadow_finger(name: str) -> RobotFinger:
    """Return a finger, whose middle and last joint share a motor and close alike."""
    return RobotFinger(
        (f"lh_{name}J3", f"lh_{name}J2", f"lh_{name}J1"), (1.27, 0.92, 0.92), (0.0, 0.0, 0.026)
    )


HANDS.register("shadow")(
    RobotHand(
        summary="The Shadow Hand of MuJoCo Menagerie; one motor closes the last two joints of a "
        "finger.",
        model="shadow_hand",
        entry="left_hand",
        palm="lh_palm",
        palm_pos_m=(-0.046, -0.084, -0.018),
        palm_quat=(0.5, -0.5, 0.5, 0.5),
        fingers={
            "thumb": RobotFinger(
                ("lh_THJ5", "lh_THJ2", "lh_THJ1"), (0.8, 1.2, 1.0), (0.0, 0.0, 0.029)
            ),
            **dict(zip(FINGERS[1:], map(_shadow_finger, ("FF", "MF", "RF", "LF")), strict=True)),
        },
        rest_rad={"lh_THJ5": -1.0, "lh_THJ4": 1.0, "lh_THJ2": -0.65, "lh_THJ1": -0.2},
    )
)
