"""N simulated worlds over one model: reset, step, observe; and the path of a target that nobody touches."""
