"""Pretraining an eye on images of random configurations that never touch the disk."""
