"""ObAct as a LeRobot policy plugin: ``lerobot-train --policy.type=obact``."""
