"""The precision in which a network learns."""

from __future__ import annotations

import pytest
import torch

from monoloc.depth.training.precision import learns_in_bfloat16


@pytest.mark.parametrize("capability", ["AVX2", "AVX512", "DEFAULT", "NO AVX", "SVE256"])
def test_bfloat16_is_for_processors_that_multiply_it_and_for_gpus(
    capability: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    assert learns_in_bfloat16("cpu") == (capability == "AVX512")
    assert learns_in_bfloat16("cuda")
