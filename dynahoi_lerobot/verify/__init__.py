"""Verification of a dataset on disk: checks of files, tables and pictures, replay of actions, outliers."""
