"""From a recipe and a seed to an EpisodeSpec: the benchmark and its splits, and what is drawn
before a hand moves.
"""
