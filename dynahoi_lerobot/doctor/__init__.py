"""``dynahoi doctor``: what this machine has, what follows from it, and whether it reproduces published episodes."""
