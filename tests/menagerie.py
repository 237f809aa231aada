"""A stand-in for MuJoCo Menagerie's Sharpa Wave: the same names, joints and signs, round numbers for its sizes."""

from pathlib import Path

import mujoco

ARMATURE, TORQUE_NM = 0.002, 1.0
BOX = " ".join(f"{x} {y} {z}" for x in (-0.01, 0.01) for y in (-0.04, 0.04) for z in (0.01, 0.09))
FINGERS = {"index": -0.03, "middle": -0.01, "ring": 0.01, "pinky": 0.03}


def write_menagerie(root: Path) -> Path:
    """Write the model below ``root`` and return ``root``."""
    fingers = "".join(finger(name, y) for name, y in FINGERS.items())
    text = f"""<mujoco model="left_sharpa_wave">
  <compiler angle="radian"/>
  <asset><mesh name="palm" vertex="{BOX}"/></asset>
  <worldbody><body name="left_hand_C_MC">
    <geom name="visual" type="sphere" size="0.05" contype="0" conaffinity="0" mass="0.7"/>
    <geom type="mesh" mesh="palm"/>{thumb()}{fingers}
  </body></worldbody>
</mujoco>"""
    path = root / "sharpa_wave" / "left_hand.xml"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    mujoco.MjModel.from_xml_path(str(path))
    return root


def link(joint: str, span: str, length: float, inside: str, place: str) -> str:
    """A body with one joint about its own z, a capsule along its x if it has a length, and what is inside it."""
    limits = f'limited="true" range="{span}" armature="{ARMATURE}" actuatorfrcrange="-{TORQUE_NM} {TORQUE_NM}"'
    capsule = f'<geom type="capsule" size="0.009" fromto="0 0 0 {length} 0 0" mass="0.02"/>' if length else ""
    inertial = "" if length else '<inertial pos="0 0 0" mass="0.002" diaginertia="2e-7 2e-7 1e-7"/>'
    hinge = f'<joint name="left_{joint}" axis="0 0 1" {limits}/>'
    return f'<body name="left_{joint}_body" {place}>{hinge}{inertial}{capsule}{inside}</body>'


def tip(name: str, x: float) -> str:
    return f'<site name="left_{name}_fingertip" pos="{x} 0 0"/>'


def finger(name: str, y: float) -> str:
    """Knuckle, abduction, and two further flexions; the little finger hangs on one joint more."""
    end = link(f"{name}_DIP", "0 1.4", 0.024, tip(name, 0.026), 'pos="0.03 0 0"')
    middle = link(f"{name}_PIP", "0 1.75", 0.028, end, 'pos="0.047 0 0" quat="0.7071 -0.7071 0 0"')
    spread = link(f"{name}_MCP_AA", "-0.35 0.35", 0.045, middle, 'quat="0.7071 0.7071 0 0"')
    at, turn = f'pos="0 {y} 0.096"', 'quat="0.5 -0.5 -0.5 -0.5"'
    if name != "pinky":
        return link(f"{name}_MCP_FE", "-0.17 1.57", 0.0, spread, f"{at} {turn}")
    knuckle = link(f"{name}_MCP_FE", "-0.17 1.57", 0.0, spread, turn)
    return link(f"{name}_CMC", "0 0.26", 0.0, knuckle, at)


def thumb() -> str:
    """It points away from the fingers and swings before the palm; the model counts its knuckle the other way round."""
    end = link("thumb_IP", "0 1.75", 0.026, tip("thumb", 0.0276), 'pos="0.039 0 0" quat="0.7071 -0.7071 0 0"')
    spread = link("thumb_MCP_AA", "-0.35 0.35", 0.037, end, 'quat="0.7071 0.7071 0 0"')
    flexed = link("thumb_MCP_FE", "-1.4 0.52", 0.0, spread, 'pos="0.06 0 0" quat="0 1 0 0"')
    across = link("thumb_CMC_AA", "-0.35 0.35", 0.055, flexed, 'quat="0.924 0 -0.383 0"')
    return link("thumb_CMC_FE", "-0.17 1.92", 0.0, across, 'pos="0.01 -0.026 0.021" quat="0.7071 0 0 -0.7071"')
