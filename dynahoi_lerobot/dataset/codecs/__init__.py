"""How pictures are stored: one file per codec, found by its decorator."""
