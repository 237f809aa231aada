"""What several parts of the network and its losses are built from."""

from itertools import pairwise

from torch import Tensor, nn


def perceptron(*widths: int) -> nn.Sequential:
    """Return linear layers of these widths with SiLU between them."""
    layers: list[nn.Module] = []
    for n_in, n_out in pairwise(widths):
        layers += [nn.Linear(n_in, n_out), nn.SiLU()]
    return nn.Sequential(*layers[:-1])


def conv(n_in: int, n_out: int, stride: int = 1) -> nn.Sequential:
    """Return a 3 x 3 convolution with normalization by groups of eight channels, and its
    activation.
    """
    return nn.Sequential(
        nn.Conv2d(n_in, n_out, kernel_size=3, stride=stride, padding=1, bias=False),
        nn.GroupNorm(n_out // 8, n_out),
        nn.SiLU(inplace=True),
    )


def smooth_norm(x: Tensor, least_square: float = 1e-10) -> Tensor:
    """Return the length of vectors ``(..., D)``, ``(...)``, with a gradient also at 0, where it is
    the root of ``least_square``.
    """
    return (x.square().sum(-1) + least_square).sqrt()
