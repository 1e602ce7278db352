"""What is made of a map of light, kept from frame to frame for as long as the map is unchanged."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from raden_torch.brdf.model.model import version_of

T = TypeVar("T")


class KeptByMap(Generic[T]):
    """Values by map and key; a map that is written to, or goes, takes its own with it.

    Args:
        most: values of one map, beyond which all of them are made anew.
    """

    def __init__(self, most: int = 1) -> None:
        self._most = most
        self._kept: WeakTensorKeyDictionary = WeakTensorKeyDictionary()

    def get(self, radiance: Tensor, key: Hashable, make: Callable[[], T]) -> T:
        """The value of this map and key, made where it is not known.

        It is not kept where nobody counts what is written to the map: in inference mode.
        """
        version = version_of(radiance)
        if version is None:
            return make()
        known = self._kept.get(radiance)
        if known is None or known[0] != version:
            known = self._kept[radiance] = (version, {})
        values: dict[Hashable, T] = known[1]
        if key not in values:
            if len(values) >= self._most:
                values.clear()
            values[key] = make()
        return values[key]
