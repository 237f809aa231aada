# The core: list, doctor, generate, verify, view, evaluate a baseline, report, and the Gymnasium environment.
dynahoi --version
dynahoi list motions --json
dynahoi doctor
dynahoi generate --root data --episodes 2 --image-size 32 --motions constant
dynahoi verify data
dynahoi view --motion lob --image-size 32 --out lob.mp4
dynahoi evaluate --policy expert --episodes 2 --out results
dynahoi evaluate --replay results
dynahoi report results --out page.html
test -s page.html -a -s lob.mp4
python - <<'PYTHON'
import importlib.util

import gymnasium as gym

env = gym.make_vec("dynahoi_lerobot.env:dynahoi/planar-v0", num_envs=2, image_size=32)
observation, _ = env.reset(seed=0)
assert env.step(observation["agent_pos"])[0]["pixels"]["ego"].shape == (2, 32, 32, 3)
assert importlib.util.find_spec("torch") is None, "the core must not bring torch"
PYTHON
