"""Catching moving things with a dexterous hand: generator, environment and metrics, native to LeRobot."""
