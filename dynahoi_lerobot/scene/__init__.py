"""The compiled MuJoCo model of all episodes, the per-world fields that set up one, furniture and
screens.
"""
