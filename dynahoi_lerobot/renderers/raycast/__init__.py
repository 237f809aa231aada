"""Tile-based ray casting as warp kernels, for CPU and CUDA."""
