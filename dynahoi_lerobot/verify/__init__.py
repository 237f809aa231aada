"""Whether a dataset on disk is what it says: checks of files, tables and pictures, and re-simulation."""
