"""Stand-ins for the robot hands of MuJoCo Menagerie: the bundled hand in the names, frames and
angles of a table.
"""

from collections.abc import Iterable
from pathlib import Path

import mujoco_menagerie
import numpy as np

from dynahoi_lerobot.core.conventions import FINGERS
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.hands.robot import RobotHand

SHAPES = HANDS["opposed"].fingers
PALM_HALF_M = np.array([0.0115, 0.045, 0.041])
TIP_HALF_M = np.array([0.008, 0.008, 0.016])
CORNERS = np.array(list(np.ndindex(2, 2, 2))) * 2 - 1
SPAN_RAD = np.array([-0.1, 1.7])
"""How far joints turn from rest."""


def gather_menagerie(root: Path) -> Path:
    """Fill ``root`` with each table's model, the real one where this machine has it, and return
    ``root``.
    """
    cache = mujoco_menagerie.Cache()
    for hand in (hand for _, hand in HANDS.items() if isinstance(hand, RobotHand)):
        robot = mujoco_menagerie.get(hand.model)
        real = cache.root / hand.model if cache.root else cache.model_path(robot)
        if (real / f"{hand.entry}.xml").is_file():
            (root / hand.model).symlink_to(real.resolve())
        else:
            (root / hand.model).mkdir()
            (root / hand.model / f"{hand.entry}.xml").write_text(stand_in(hand))
    return root


def stand_in(hand: RobotHand) -> str:
    """A hand on a wrist that moves, with a part that is only seen, and meshes for palm and tips.

    The middle joint of its thumb counts the other way round. One motor of the Shadow Hand pulls the
    last two joints of a finger.
    """
    inside = '<geom type="mesh" mesh="palm" pos="-0.0475 -0.03 0.003"/>'
    inside += "".join(finger(hand, name) for name in FINGERS)
    flexing = {joint for name in FINGERS for joint in hand.fingers[name].joints}
    for joint in hand.rest_rad.keys() - flexing:
        inside = hinge(joint, 1, hand.rest_rad[joint], inside)
    w, x, y, z = hand.palm_quat
    return f"""<mujoco><compiler angle="radian"/>
  <default><joint damping="0.05" armature="0.0002"/></default>
  <asset>{mesh("palm", PALM_HALF_M)}{mesh("tip", TIP_HALF_M)}</asset>
  <worldbody><body><joint type="free"/><geom size="0.04" pos="0 0 -0.2"/>
    <body name="{hand.palm}"><joint name="wrist"/>
      <geom size="0.05" contype="0" conaffinity="0" mass="0.7"/>
      <body quat="{w} {-x} {-y} {-z}">
        <body pos="{words(-np.array(hand.palm_pos_m))}">{inside}</body>
      </body>
    </body>
  </body></worldbody>{motors(hand) if hand.model == "shadow_hand" else ""}</mujoco>"""


def finger(hand: RobotHand, name: str) -> str:
    """Three links, which turn about x and lie along z."""
    shape = SHAPES[name]
    tip = hand.fingers[name].tip
    inside = f'<site name="{tip}" pos="0 0 {shape.lengths[-1]}"/>' if isinstance(tip, str) else ""
    inside = f'<geom type="mesh" mesh="tip" pos="0 0 0.013"/>{inside}'
    for i in (2, 1, 0):
        joint = hand.fingers[name].joints[i]
        sign = -1 if (name, i) == ("thumb", 1) else 1
        inside = hinge(joint, sign, hand.rest_rad.get(joint, 0.0), inside)
        if i:
            length = shape.lengths[i - 1]
            link = f'<geom type="capsule" size="{shape.radius}" fromto="0 0 0 0 0 {length}"/>'
            inside = f'{link}<body pos="0 0 {length}">{inside}</body>'
    axes = words([*shape.axis, *np.cross(shape.along, shape.axis)])
    return f'<body pos="{words(shape.base)}" xyaxes="{axes}">{inside}</body>'


def hinge(joint: str, sign: int, rest_rad: float, inside: str) -> str:
    """What is inside a body, on a joint that turns it about x, and that is at rest where it is."""
    span = words(np.sort(sign * SPAN_RAD) + rest_rad)
    limits = f'range="{span}" actuatorfrcrange="-1.2 1.2"'
    # as models orient bodies: a hinge that turns backwards by an axis and an angle
    turned = f'quat="{np.cos(rest_rad / 2)} {-sign * np.sin(rest_rad / 2)} 0 0"'
    if sign < 0:
        turned = f'axisangle="1 0 0 {rest_rad}"'
    return f"""<body {turned}>
        <joint name="{joint}" axis="{sign} 0 0" {limits}/>{inside}</body>"""


def motors(hand: RobotHand) -> str:
    tendons = ""
    pulling = ""
    for name in FINGERS[1:]:
        *_, middle, tip = hand.fingers[name].joints
        wrapped = "".join(f'<joint joint="{joint}" coef="1"/>' for joint in (middle, tip))
        tendons += f'<fixed name="{name}">{wrapped}</fixed>'
        pulling += f'<position tendon="{name}" forcerange="-1 1"/>'
    return f"<tendon>{tendons}</tendon><actuator>{pulling}</actuator>"


def mesh(name: str, half: np.ndarray) -> str:
    """A box."""
    return f'<mesh name="{name}" vertex="{words((CORNERS * half).ravel())}"/>'


def words(values: Iterable[float]) -> str:
    return " ".join(map(str, values))
