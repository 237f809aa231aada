"""One world that moves by the clock: what LeRobot's robot interface and the page for people play
in.
"""
