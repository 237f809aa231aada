"""Stand-ins for the robot hands of MuJoCo Menagerie: the same names, joints and signs, round
sizes.
"""

from pathlib import Path

import mujoco_menagerie

from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.hands.robot import RobotHand

DAMPING = 0.05
ARMATURE = 0.0002
TORQUE_NM = 1.0
SHARPA_FINGERS = {"index": -0.03, "middle": -0.01, "ring": 0.01, "pinky": 0.03}
SHADOW_FINGERS = {
    "FF": (-0.033, 0.095),
    "MF": (-0.011, 0.099),
    "RF": (0.011, 0.095),
    "LF": (0.033, 0.087),
}


def gather_menagerie(root: Path) -> Path:
    """Fill ``root`` with each table's model, the real one where this machine has it, and return
    ``root``.
    """
    cache = mujoco_menagerie.Cache()
    stand_ins = {"sharpa_wave": sharpa, "shadow_hand": shadow}
    entries = {hand.model: hand.entry for _, hand in HANDS.items() if isinstance(hand, RobotHand)}
    for name, entry in entries.items():
        robot = mujoco_menagerie.get(name)
        real = cache.root / name if cache.root else cache.model_path(robot)
        if (real / f"{entry}.xml").is_file():
            (root / name).symlink_to(real.resolve())
        elif name in stand_ins:
            (root / name).mkdir()
            (root / name / f"{entry}.xml").write_text(stand_ins[name]())
    return root


def model(meshes: str, bodies: str, rest: str = "") -> str:
    limit = f'forcerange="-{TORQUE_NM} {TORQUE_NM}"'
    return f"""<mujoco><compiler angle="radian"/>
  <default><joint damping="{DAMPING}" armature="{ARMATURE}"/><position kp="1" {limit}/></default>
  <asset>{meshes}</asset><worldbody>{bodies}</worldbody>{rest}</mujoco>"""


def mesh(name: str, x: float, y: float, low: float, high: float) -> str:
    """A box of these half-widths, from ``low`` to ``high`` along z."""
    corners = " ".join(f"{a} {b} {c}" for a in (-x, x) for b in (-y, y) for c in (low, high))
    return f'<mesh name="{name}" vertex="{corners}"/>'


def body(name: str, joint: str, inside: str, place: str = "", *, heavy: bool = True) -> str:
    """A body with a joint, if ``joint`` has its attributes, and what is inside it."""
    inertial = (
        f'<inertial pos="0 0 0.01" mass="{0.02 if heavy else 0.002}" diaginertia="2e-6 2e-6 1e-6"/>'
    )
    return (
        f'<body name="{name}" '
        f"{place}>{inertial}{f'<joint {joint}/>' if joint else ''}{inside}</body>"
    )


def capsule(radius: float, along: str) -> str:
    return f'<geom type="capsule" size="{radius}" fromto="0 0 0 {along}"/>'


def sharpa() -> str:
    """It has no motors' limits, but joints'; what its joints are called follows from the kind of
    finger.
    """
    bodies = sharpa_thumb() + "".join(sharpa_finger(name, y) for name, y in SHARPA_FINGERS.items())
    visual = '<geom type="sphere" size="0.05" contype="0" conaffinity="0" mass="0.7"/>'
    palm = f'<body name="left_hand_C_MC">{visual}<geom type="mesh" mesh="palm"/>{bodies}</body>'
    return model(mesh("palm", 0.01, 0.04, 0.01, 0.09), palm)


def sharpa_link(joint: str, span: str, length: float, inside: str, place: str) -> str:
    """A body that turns about its own z, with a capsule along its x if it has a length."""
    limits = f'range="{span}" actuatorfrcrange="-{TORQUE_NM} {TORQUE_NM}"'
    geom = capsule(0.009, f"{length} 0 0") if length else ""
    return body(
        f"left_{joint}_body",
        f'name="left_{joint}" axis="0 0 1" {limits}',
        geom + inside,
        place,
        heavy=length > 0,
    )


def sharpa_tip(name: str, x: float) -> str:
    return f'<site name="left_{name}_fingertip" pos="{x} 0 0" quat="0.5 0.5 0.5 0.5"/>'


def sharpa_finger(name: str, y: float) -> str:
    """Knuckle, abduction, and two further flexions; the little finger hangs on one joint more."""
    end = sharpa_link(f"{name}_DIP", "0 1.4", 0.024, sharpa_tip(name, 0.026), 'pos="0.03 0 0"')
    middle = sharpa_link(
        f"{name}_PIP", "0 1.75", 0.028, end, 'pos="0.047 0 0" quat="0.7071 -0.7071 0 0"'
    )
    spread = sharpa_link(f"{name}_MCP_AA", "-0.35 0.35", 0.045, middle, 'quat="0.7071 0.7071 0 0"')
    at = f'pos="0 {y} 0.096"'
    turn = 'quat="0.5 -0.5 -0.5 -0.5"'
    if name != "pinky":
        return sharpa_link(f"{name}_MCP_FE", "-0.17 1.57", 0.0, spread, f"{at} {turn}")
    knuckle = sharpa_link(f"{name}_MCP_FE", "-0.17 1.57", 0.0, spread, turn)
    return sharpa_link(f"{name}_CMC", "0 0.26", 0.0, knuckle, at)


def sharpa_thumb() -> str:
    """It points away from the fingers and swings before the palm; its knuckle is counted the other
    way round.
    """
    end = sharpa_link(
        "thumb_IP",
        "0 1.75",
        0.026,
        sharpa_tip("thumb", 0.0276),
        'pos="0.039 0 0" quat="0.7071 -0.7071 0 0"',
    )
    spread = sharpa_link("thumb_MCP_AA", "-0.35 0.35", 0.037, end, 'quat="0.7071 0.7071 0 0"')
    flexed = sharpa_link("thumb_MCP_FE", "-1.4 0.52", 0.0, spread, 'pos="0.06 0 0" quat="0 1 0 0"')
    across = sharpa_link("thumb_CMC_AA", "-0.35 0.35", 0.055, flexed, 'quat="0.924 0 -0.383 0"')
    place = 'pos="0.01 -0.026 0.021" quat="0.7071 0 0 -0.7071"'
    return sharpa_link("thumb_CMC_FE", "-0.17 1.92", 0.0, across, place)


def shadow() -> str:
    """A wrist that moves, a palm, and fingers whose last two joints one tendon pulls."""
    bodies = shadow_thumb() + "".join(
        shadow_finger(name, x, z) for name, (x, z) in SHADOW_FINGERS.items()
    )
    palm = body(
        "lh_palm",
        'name="lh_WRJ1"',
        f'<geom type="box" size="0.035 0.011 0.049" pos="0 0 0.04"/>{bodies}',
    )
    arm = body(
        "lh_forearm", 'type="free"', f'<geom type="sphere" size="0.04" pos="0 0 -0.1"/>{palm}'
    )
    pulled = [(f"lh_{name}J2", f"lh_{name}J1") for name in SHADOW_FINGERS]
    tendons = "".join(
        f'<fixed name="{a}"><joint joint="{a}" coef="1"/><joint joint="{b}" coef="1"/></fixed>'
        for a, b in pulled
    )
    motors = "".join(f'<position tendon="{a}"/>' for a, _ in pulled)
    motors += "".join(f'<position joint="lh_{name}J3"/>' for name in SHADOW_FINGERS)
    motors += "".join(f'<position joint="lh_THJ{number}"/>' for number in range(1, 6))
    meshes = mesh("tip", 0.0085, 0.0075, 0.005, 0.032) + mesh(
        "thumb_tip", 0.0105, 0.009, 0.003, 0.035
    )
    return model(meshes, arm, f"<tendon>{tendons}</tendon><actuator>{motors}</actuator>")


def shadow_finger(name: str, x: float, z: float) -> str:
    end = body(
        f"lh_{name}1",
        f'name="lh_{name}J1" axis="1 0 0" range="0 1.57"',
        '<geom type="mesh" mesh="tip"/>',
        'pos="0 0 0.025"',
    )
    inside = capsule(0.009, "0 0 0.025") + end
    middle = body(
        f"lh_{name}2", f'name="lh_{name}J2" axis="1 0 0" range="0 1.57"', inside, 'pos="0 0 0.045"'
    )
    first = body(
        f"lh_{name}3",
        f'name="lh_{name}J3" axis="1 0 0" range="-0.26 1.57"',
        capsule(0.009, "0 0 0.045") + middle,
    )
    return body(
        f"lh_{name}4",
        f'name="lh_{name}J4" axis="0 1 0" range="-0.35 0.35"',
        first,
        f'pos="{x} 0 {z}"',
    )


def shadow_thumb() -> str:
    end = body(
        "lh_TH1",
        'name="lh_THJ1" axis="1 0 0" range="-0.26 1.57"',
        '<geom type="mesh" mesh="thumb_tip"/>',
        'pos="0 0 0.032" quat="1 0 0 -1"',
    )
    middle = body(
        "lh_TH2", 'name="lh_THJ2" axis="0 -1 0" range="-0.7 0.7"', capsule(0.01, "0 0 0.03") + end
    )
    hub = body(
        "lh_TH3", 'name="lh_THJ3" axis="-1 0 0" range="-0.21 0.21"', middle, 'pos="0 0 0.038"'
    )
    swung = body(
        "lh_TH4", 'name="lh_THJ4" axis="-1 0 0" range="0 1.22"', capsule(0.0105, "0 0 0.035") + hub
    )
    turned = 'pos="-0.034 -0.0086 0.029" quat="0 -0.382683 0 0.92388"'
    return body("lh_TH5", 'name="lh_THJ5" axis="0 0 1" range="-1.05 1.05"', swung, turned)
