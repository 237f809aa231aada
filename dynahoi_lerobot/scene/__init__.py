"""The compiled MuJoCo model of all episodes, and the per-world fields that set up one."""
