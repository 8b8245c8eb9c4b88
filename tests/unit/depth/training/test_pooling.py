"""Max-pooling over 5 x 5: the kernel against PyTorch's, values and gradients."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from monoloc.depth.training.pooling import max_pool5


def image(shape: tuple[int, ...], seed: int, whole: bool) -> torch.Tensor:
    """Random bfloat16 with a gradient; integers tie often, and bfloat16 holds their sums exactly."""
    values = 4.0 * torch.randn(shape, generator=torch.Generator().manual_seed(seed))
    values = values.round() if whole else values
    return values.to(torch.bfloat16).contiguous(memory_format=torch.channels_last).requires_grad_(True)


@given(
    shape=st.tuples(st.integers(1, 3), st.integers(1, 9), st.integers(1, 9), st.integers(1, 9)),
    seed=st.integers(0, 2**31),
    whole=st.booleans(),
)
@settings(max_examples=30)
def test_pooling_is_pytorch_s(shape: tuple[int, ...], seed: int, whole: bool) -> None:
    x = image(shape, seed, whole)
    gradient = image(shape, seed + 1, whole=True).detach()
    pooled = max_pool5(x)
    pooled.backward(gradient)
    ours, x.grad = x.grad, None
    # In float32, where PyTorch adds gradients up exactly too.
    wide = x.detach().float().requires_grad_(True)
    expected = F.max_pool2d(wide, 5, stride=1, padding=2)
    expected.backward(gradient.float())
    assert torch.equal(pooled.float(), expected)
    assert ours is not None and wide.grad is not None
    assert torch.equal(ours, wide.grad.to(torch.bfloat16))


def test_memory_format_does_not_matter() -> None:
    x = image((2, 5, 6, 7), 0, whole=False)
    packed = x.detach().contiguous().requires_grad_(True)
    for each in (x, packed):
        max_pool5(each).sum().backward()  # type: ignore[no-untyped-call]
    assert torch.equal(max_pool5(x), max_pool5(packed))
    assert x.grad is not None and packed.grad is not None
    assert torch.equal(x.grad, packed.grad)


@pytest.mark.parametrize("shape", [(1, 1, 257, 256), (1, 2, 6, 7)])
def test_pytorch_handles_what_the_kernel_cannot(shape: tuple[int, ...]) -> None:
    """Images with more pixels than the kernel's indices count, and other types."""
    x = image(shape, 0, whole=False) if shape[2] > 100 else torch.randn(shape, requires_grad=True)
    pooled = max_pool5(x)
    assert torch.equal(pooled, F.max_pool2d(x, 5, stride=1, padding=2))
    assert "MaxPool5" not in type(pooled.grad_fn).__name__
