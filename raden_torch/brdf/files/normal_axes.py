"""Which channels of a normal map hold x, y and z, and which way round."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

from torch import Tensor

from raden_torch.errors import InputError

Green = Literal["opengl", "directx"]


@dataclass(frozen=True)
class NormalAxes:
    """Where x, y and z are.

    Attributes:
        channels: 0, 1, 2 for red, green, blue (the first, second, third channel), of x, y, z.
        signs: 1, or −1 where the channel points the other way.
    """

    channels: tuple[int, int, int] = (0, 1, 2)
    signs: tuple[int, int, int] = (1, 1, 1)

    @classmethod
    def of(cls, text: str = "r,g,b", green: Green = "opengl") -> NormalAxes:
        """From x,y,z as in "r,-g,b"; "directx" turns y around.

        Raises:
            InputError: anything but each of r, g and b once.
        """
        if green not in ("opengl", "directx"):
            raise InputError(f"green: expected opengl or directx, got {green!r}")
        parts = text.replace(" ", "").lower().split(",")
        names = [part.lstrip("+-") for part in parts]
        if sorted(names) != ["b", "g", "r"] or any(len(part) > 2 for part in parts):
            raise InputError(
                f"normal xyz: expected the channels of x,y,z, as in r,-g,b or b,g,r, got {text!r}"
            )
        x, y, z = ("rgb".index(name) for name in names)
        sx, sy, sz = (-1 if part.startswith("-") else 1 for part in parts)
        return cls((x, y, z), (sx, -sy if green == "directx" else sy, sz))

    def of_map(self, stored: Tensor) -> Tensor:
        """`[B, 3, H, W]` as stored, −1…1 → x right, y up, z to the viewer."""
        if self == NormalAxes():
            return stored
        signs = stored.new_tensor(self.signs).view(3, 1, 1)
        return stored[:, list(self.channels)] * signs

    def __str__(self) -> str:
        return ",".join(
            f"{'-' if sign < 0 else ''}{'rgb'[channel]}"
            for channel, sign in zip(self.channels, self.signs, strict=True)
        )

    def option(self) -> str:
        """How to ask for it, in Python and on the command line."""
        green = next((g for g in get_args(Green) if self == NormalAxes.of(green=g)), None)
        also = f"green {green} (--green {green}) or " if green else ""
        return f"{also}xyz {self} (--normal-xyz={self})"

    def turned(self, x: int, y: int, z: int = 1) -> NormalAxes:
        """With these signs on top."""
        sx, sy, sz = self.signs
        return replace(self, signs=(sx * x, sy * y, sz * z))
