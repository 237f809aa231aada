"""The benchmark inside other evaluation harnesses, one file each."""
