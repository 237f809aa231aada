"""A stand-in for a GPU: tensors that say they are on ``cuda`` and compute on the CPU, real numbers and all.

Mixing devices is refused where CUDA would refuse it. Unlike in ``FakeTensorMode`` there are values behind the tensors,
so whole rounds can be played: masks pick rows, and commands reach the simulator. Gradients alone are made up: PyTorch's
engine asks the driver for a context before it goes backward.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

COPIES = {"aten::copy_", "aten::_to_copy", "aten::index", "aten::index_put", "aten::index_put_"}
"""Operations that CUDA lets take tensors from the CPU: copies, and indices."""


class OnGpu(torch.Tensor):
    """A tensor that says it is on the GPU.

    Attributes:
        values: the tensor on the CPU.
    """

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> OnGpu:
        """Wrap a tensor of the CPU."""
        layout = {"strides": held.stride(), "storage_offset": held.storage_offset(), "dtype": held.dtype}
        return torch.Tensor._make_wrapper_subclass(cls, held.shape, device=torch.device("cuda", 0), **layout)

    def __init__(self, held: Tensor) -> None:
        self.held = held

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Compute on the CPU; what comes of tensors on the GPU, or is made there, is there."""
        kwargs = kwargs or {}
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        wrapped = [isinstance(tensor, OnGpu) for tensor in tensors]
        others = [tensor for tensor, gpu in zip(tensors, wrapped, strict=True) if not gpu and tensor.dim()]
        if any(wrapped) and others and func._schema.name not in COPIES:
            raise RuntimeError(f"{func} got tensors on cuda:0 and on cpu")
        if (device := kwargs.get("device")) is not None:
            kwargs = kwargs | {"device": torch.device("cpu")}
        out = func(*tree_map(_held, args), **tree_map(_held, kwargs))
        if func._schema.is_mutable:
            return args[0] if isinstance(out, Tensor) else out
        here = any(wrapped) if device is None else device.type == "cuda"
        return tree_map(lambda value: OnGpu(value) if here and type(value) is Tensor else value, out)


class _Factories(TorchDispatchMode):
    """Makes tensors on the stand-in where a factory or a copy names ``cuda``."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return OnGpu.__torch_dispatch__(func, types, args, kwargs)


def _held(value: Any) -> Any:
    return value.held if isinstance(value, OnGpu) else value


def _backward(loss: Tensor) -> None:
    """Give every weight that a loss depends on a gradient of ones."""
    nodes: list[Any] = [loss.grad_fn]
    seen: set[Any] = set()
    while nodes:
        node = nodes.pop()
        if node is None or node in seen:
            continue
        seen.add(node)
        nodes += [following for following, _ in node.next_functions]
        if hasattr(node, "variable"):
            node.variable.grad = torch.ones_like(node.variable)


@contextmanager
def stand_in_gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let ``cuda`` name the stand-in."""
    torch._C._ensureCUDADeviceGuardSet()
    lifting = torch._C._only_lift_cpu_tensors()
    torch._C._set_only_lift_cpu_tensors(True)  # so that `torch.tensor(..., device="cuda")` reaches the mode
    with monkeypatch.context() as patch, torch.autograd.set_multithreading_enabled(False), _Factories():
        patch.setattr(torch.cuda, "is_available", lambda: True)
        patch.setattr(torch.cuda, "_lazy_init", lambda: None)
        patch.setattr(torch.cuda, "is_current_stream_capturing", lambda: False)
        patch.setattr(torch.Tensor, "backward", _backward)
        patch.setattr(torch.__future__, "_overwrite_module_params_on_conversion", True)  # else `.data` is assigned
        try:
            yield
        finally:
            torch._C._set_only_lift_cpu_tensors(lifting)
