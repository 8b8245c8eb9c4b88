"""Max-pooling over 5 x 5, alone and in chains: the kernels against PyTorch's, values and gradients."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn import functional as F

from monoloc.depth.training.network import DepthNetwork, NetworkConfig
from monoloc.depth.training.pooling import chained_pools, max_pool5

SHAPES = st.tuples(st.integers(1, 3), st.integers(1, 19), st.integers(1, 9), st.integers(1, 9))
TYPES = st.sampled_from([torch.float32, torch.bfloat16])


def image(shape: tuple[int, ...], seed: int, whole: bool, dtype: torch.dtype = torch.bfloat16) -> Tensor:
    """Random, with a gradient; integers tie often, and bfloat16 holds their sums exactly."""
    values = 4.0 * torch.randn(shape, generator=torch.Generator().manual_seed(seed))
    values = values.round() if whole else values
    return values.to(dtype).contiguous(memory_format=torch.channels_last).requires_grad_(True)


@given(shape=SHAPES, seed=st.integers(0, 2**31), whole=st.booleans(), dtype=TYPES)
@settings(max_examples=40)
def test_pooling_is_pytorch_s(shape: tuple[int, ...], seed: int, whole: bool, dtype: torch.dtype) -> None:
    x = image(shape, seed, whole, dtype)
    gradient = image(shape, seed + 1, whole=True, dtype=dtype).detach()
    pooled = max_pool5(x)
    pooled.backward(gradient)
    ours, x.grad = x.grad, None
    # In float32, where PyTorch adds gradients up exactly too.
    wide = x.detach().float().requires_grad_(True)
    expected = F.max_pool2d(wide, 5, stride=1, padding=2)
    expected.backward(gradient.float())
    assert torch.equal(pooled.float(), expected)
    assert ours is not None and wide.grad is not None
    assert torch.equal(ours, wide.grad.to(dtype))


def layers(x: Tensor, weights: list[Tensor]) -> Tensor:
    total = path = x
    for weight in weights[:-1]:
        path = weight * F.max_pool2d(path, 5, stride=1, padding=2)
        total = total + path
    return F.relu6(weights[-1] * total)


@given(shape=SHAPES, seed=st.integers(0, 2**31), stages=st.integers(0, 4), dtype=TYPES)
@settings(max_examples=40)
def test_a_chain_is_its_layers(shape: tuple[int, ...], seed: int, stages: int, dtype: torch.dtype) -> None:
    """Those layers in float64."""
    x, gradient = image(shape, seed, False, dtype), image(shape, seed + 1, False, dtype).detach()
    drawn = torch.randn((stages + 1, shape[1]), generator=torch.Generator().manual_seed(seed))
    weights = [each.reshape(-1, 1, 1).to(dtype).requires_grad_(True) for each in drawn]
    exact, *exact_weights = (each.detach().double().requires_grad_(True) for each in (x, *weights))
    chained, expected = chained_pools(x, weights), layers(exact, exact_weights)
    ours = torch.autograd.grad(chained, [x, *weights], gradient)
    theirs = torch.autograd.grad(expected, [exact, *exact_weights], gradient.double())
    # Gradients of weights are sums of products, of a few hundred values here.
    rounding = 2.0**-8 if dtype == torch.bfloat16 else 1e-5
    for one, other in zip([chained, *ours], [expected, *theirs], strict=True):
        largest = float(other.detach().abs().max())
        assert torch.allclose(one.double(), other, rtol=rounding, atol=rounding * (largest + 1e-9))


def test_network_in_training_is_that_in_flight() -> None:
    """Only in training do kernels pool."""
    network = DepthNetwork(NetworkConfig(pooling_stages=(0, 4, 0, 2))).eval()
    images = torch.rand((2, 3, 64, 96), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        in_flight = network(images)
    assert torch.allclose(network(images), in_flight, atol=1e-5)


@pytest.mark.parametrize("pool", [max_pool5, lambda x: chained_pools(x, [torch.ones(5), torch.ones(5)])])
def test_memory_format_does_not_matter(pool: Callable[[Tensor], Tensor]) -> None:
    x = image((2, 5, 6, 7), 0, whole=False)
    packed = x.detach().contiguous().requires_grad_(True)
    for each in (x, packed):
        pool(each).sum().backward()  # type: ignore[no-untyped-call]
    assert torch.equal(pool(x), pool(packed))
    assert x.grad is not None and packed.grad is not None
    assert torch.equal(x.grad, packed.grad)


def test_a_network_without_a_number_stays_without() -> None:
    """Else nobody would notice that training diverged."""
    x = image((1, 8, 6, 7), 0, whole=False, dtype=torch.float32)
    chained = chained_pools(
        x + torch.where(torch.arange(8) == 3, torch.nan, 0.0).reshape(1, 8, 1, 1), [torch.ones(8)]
    )
    assert torch.isnan(chained[:, 3]).all() and torch.isfinite(chained[:, :3]).all()


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_pytorch_handles_what_the_kernel_cannot(dtype: torch.dtype) -> None:
    """Images with more pixels than the kernel's numbers count, and other types."""
    x = image((1, 1, 257, 256) if dtype == torch.bfloat16 else (1, 2, 6, 7), 0, whole=False, dtype=dtype)
    pooled = max_pool5(x)
    assert torch.equal(pooled, F.max_pool2d(x, 5, stride=1, padding=2))
    assert "MaxPool5" not in type(pooled.grad_fn).__name__


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_forked_process_has_threads_of_its_own() -> None:
    """The parent's do not exist after a fork: waiting for them would never end."""
    script = """
import os, sys
import numpy as np
import monoloc._core as core
values = np.random.default_rng(0).normal(size=(4, 9, 9, 8)).astype(np.float32)
def pooled():
    largest, came_from = np.empty_like(values), np.empty(values.shape, np.uint16)
    core.max_pool(values, 2, largest, came_from)
    return largest
before = pooled()
child = os.fork()
if child == 0:
    os._exit(0 if np.array_equal(pooled(), before) else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", script], timeout=60, check=False)
    assert done.returncode == 0
