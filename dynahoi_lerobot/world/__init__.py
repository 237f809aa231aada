"""N simulated worlds over one model: reset, step, observe."""
