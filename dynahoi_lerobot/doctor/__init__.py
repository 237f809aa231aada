"""``dynahoi doctor``: check a machine, and whether it reproduces published episodes."""
