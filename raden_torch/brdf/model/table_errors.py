"""What the stated errors of a measurement do to a model's runtime table."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from raden_torch.errors import InputError

MOST_SHARED = 3
"""The zeros of incidence, receiving and tilt."""


class TableErrors(nn.Module):
    """Standard uncertainties (k = 1) of the nodes of a runtime table, in linear RGB.

    They are those of the measurement that the model was fitted to, and stay so when the model is
    changed afterwards.

    Attributes:
        own: `[U, V, W, 3]` in 1/sr, 0 or more: by the errors that each reading has by itself. Read
            linearly between the nodes, it is on average what the table has there.
        shared: `[Z, U, V, W, 3]` in 1/sr, Z ≤ 3: the change by one standard deviation of each error
            that all readings share, with its sign: the axes' zeros.
        scale_std: relative, of all values together.

    Raises:
        InputError: shapes that do not fit, a negative standard deviation, a scale's beyond 0…1.
    """

    own: Tensor
    shared: Tensor

    def __init__(self, own: Tensor, shared: Tensor, scale_std: float) -> None:
        super().__init__()
        if own.ndim != 4 or own.shape[-1] != 3 or shared.shape[1:] != own.shape:
            raise InputError(
                "errors: expected own [U, V, W, 3] and shared [Z, U, V, W, 3], got "
                f"{list(own.shape)} and {list(shared.shape)}"
            )
        if len(shared) > MOST_SHARED:
            raise InputError(f"errors: shared: expected at most {MOST_SHARED}, got {len(shared)}")
        if not bool((own >= 0).all()):
            raise InputError("errors: own: expected 0 or more, got some that are not")
        if not 0.0 <= scale_std < 1.0:
            raise InputError(f"errors: scale_std: expected 0…1, got {scale_std:g}")
        self.register_buffer("own", own)
        self.register_buffer("shared", shared)
        self.scale_std = scale_std

    @property
    def channels(self) -> Tensor:
        """`[U, V, W, 3 + 3 Z]`: own, then each of the shared errors."""
        return torch.cat([self.own, *self.shared], dim=-1)

    def extra_repr(self) -> str:
        return f"{len(self.shared)} shared errors, scale_std={self.scale_std:g}"
