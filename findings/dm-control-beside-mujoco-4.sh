#!/usr/bin/env bash
# dm-control 1.0.50 with MuJoCo 4.0.0.
# Expected: the newest dm-control accepts mujoco>=3.17.0 without an upper bound, so a fresh install, which brings
# MuJoCo 4.0.0, loads its tasks.
# Seen: it imports, but no Physics can be made, neither a suite task nor a string of MJCF: it looks for the field
# flex_vertedge, which MjModel no longer has. Beside MuJoCo 3.17.0 both load and step.
# Met by: who adds the control suite as a baseline to a project on MuJoCo 4; both cannot share an environment.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cd "$dir"
export MUJOCO_GL=disabled
cat >"$dir/load.py" <<'EOF'
import importlib.metadata as metadata
import mujoco
from dm_control import mujoco as bindings, suite

bound = next(line for line in metadata.requires("dm-control") if line.startswith("mujoco"))
print(f"dm-control {metadata.version('dm-control')} ({bound}) beside MuJoCo {mujoco.__version__}:", end=" ")
BALL = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
failures = 0
for load in (lambda: suite.load("cartpole", "swingup").physics, lambda: bindings.Physics.from_xml_string(BALL)):
    try:
        load().step()
    except AttributeError as error:
        failures += "flex_vertedge" in str(error)
print(f"{failures} of 2 ways fail to make a Physics")
raise SystemExit(failures)
EOF
load() { # MUJOCO: how many of two ways to make a Physics fail beside that version
    uv venv --quiet --python 3.12 --clear "$dir/venv"
    VIRTUAL_ENV="$dir/venv" uv pip install --quiet dm-control==1.0.50 "mujoco==$1"
    status=0
    "$dir/venv/bin/python" "$dir/load.py" || status=$?
}
load 3.17.0
[ "$status" = 0 ] || { echo "dm-control fails beside MuJoCo 3.17.0 too" >&2; exit 1; }
load 4.0.0
[ "$status" = 2 ] || { echo "dm-control works beside MuJoCo 4.0.0 now" >&2; exit 1; }
