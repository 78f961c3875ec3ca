# SPDX-License-Identifier: Apache-2.0
"""PyTorch settings: threads and precision."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import torch

Precision = AbstractContextManager[object]


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Set PyTorch's number of threads within the context; 0 leaves it unchanged."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def mlp_precision(device: torch.device) -> Precision:
    """Half precision for the small networks where the hardware supports it natively; full precision elsewhere."""
    if device.type == "cuda":
        return torch.autocast("cuda", torch.bfloat16) if torch.cuda.is_bf16_supported() else nullcontext()
    supported = any(
        bool(getattr(torch.cpu, name, lambda: False)())
        for name in ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
    )
    return torch.autocast("cpu", torch.bfloat16) if supported else nullcontext()
