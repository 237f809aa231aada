"""Ray casting by tiles, as warp kernels for CPU and CUDA."""
