"""Learning while simulating: pictures and labelled episodes that never touch the disk."""
