"""From a recipe and a seed to an EpisodeSpec: the benchmark, its splits, and every random draw of an episode."""
