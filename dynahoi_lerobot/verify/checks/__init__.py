"""What is verified about a dataset on disk: one file per promise."""
