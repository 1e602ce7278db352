"""A palette: several materials, of which each pixel has its own (`GBuffer.material`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor, nn

from raden_torch.brdf.materials.surface import Reflection
from raden_torch.errors import InputError, check_type

_LARGEST_SUM_ERROR = 1e-3
"""Of a pixel's weights: what 8 and 16 bits a weight leave."""


class Palette(nn.Module):
    """Materials in an order; `shade` takes the one, or the mixture, that `GBuffer.material` says.

    An index chooses one material for a pixel; weights mix the radiance of several, pixel by pixel.
    The cost grows with the pixels that each material covers, not with the number of materials.

    Args:
        models: `RadenBrdf`s or other materials that `shade` takes, but no palettes.
        names: one each; by default the samples' names, else "1", "2", ….

    Raises:
        InputError: no model, something that is no material, or names that are not as many.

    Examples:
        Two shells, left and right:

        >>> import torch
        >>> import raden_torch as rt
        >>> from raden_torch.brdf.materials.palette import Palette
        >>> shells = [
        ...     rt.fit(rt.simulate_specimen(name, step_deg=35)).model
        ...     for name in ("akoya", "yakogai")
        ... ]
        >>> palette = Palette(shells)
        >>> palette.names
        ('akoya', 'yakogai')
        >>> up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, 1, 2)
        >>> gbuffer = rt.GBuffer(up, view=(0, 0, 1), material=torch.tensor([0, 1]).view(1, 1, 1, 2))
        >>> lamp = rt.DirectionalLight((0, 0, 1))
        >>> image = rt.shade(palette, gbuffer, lamp)
        >>> alone = rt.shade(shells[1], rt.GBuffer(up, view=(0, 0, 1)), lamp)
        >>> torch.equal(image[..., 1], alone[..., 1])
        True
    """

    def __init__(self, models: Sequence[Reflection], names: Sequence[str] = ()) -> None:
        super().__init__()
        check_type("models", models, Sequence, "give a list of models")
        if not models:
            raise InputError("palette: expected at least one model, got none")
        for place, model in enumerate(models):
            if isinstance(model, Palette) or not hasattr(model, "of_unit_vectors"):
                raise InputError(
                    f"palette: models[{place}]: expected a material, got {type(model).__name__}"
                )
        if names and len(names) != len(models):
            raise InputError(f"palette: expected {len(models)} names, got {len(names)}")
        self.names = tuple(names) or tuple(
            getattr(getattr(model, "provenance", None), "sample", "") or str(place + 1)
            for place, model in enumerate(models)
        )
        self._models = tuple(models)
        # those with parameters move and train with the palette
        self.parts = nn.ModuleList(m for m in models if isinstance(m, nn.Module))

    def __len__(self) -> int:
        return len(self._models)

    def __iter__(self) -> Iterator[Reflection]:
        return iter(self._models)

    def __getitem__(self, place: int) -> Reflection:
        return self._models[place]

    def extra_repr(self) -> str:
        return ", ".join(self.names)

    def working_dtype(self, *maps: Tensor) -> torch.dtype:
        """float64 where a map or a material is, else float32."""
        wide = any(m.working_dtype(*maps) == torch.float64 for m in self._models)
        return torch.float64 if wide else torch.float32

    def of_unit_vectors(self, n: Tensor, l: Tensor, v: Tensor) -> Tensor:  # noqa: E741
        """The one material's f_r; a palette of several needs a G-buffer.

        Raises:
            InputError: there are several.
        """
        if len(self) != 1:
            raise InputError(
                f"palette: expected a G-buffer with material to choose of {len(self)}, got none; "
                "shade(palette, GBuffer(…, material=…), lights) takes it"
            )
        return self._models[0].of_unit_vectors(n, l, v)

    @staticmethod
    def _range_of(index: Tensor) -> tuple[int, int]:
        low, high = (int(x) for x in index.aminmax()) if index.numel() else (0, 0)
        return low, high

    def check_material(
        self,
        material: Tensor,
        mask: Tensor | None = None,
        *,
        where: str = "GBuffer material",
        first_row: int = 0,
    ) -> tuple[int, int]:
        """The first and the last member that a G-buffer's `material` may show.

        Args:
            material: `[B, 1, H, W]` integers, or `[B, K, H, W]` weights, which sum to 1 within
                0.001.
            mask: `[B, 1, H, W]`; where it is 0, the material does not matter.
            where: of what the messages speak.
            first_row: the number of the first row, for messages.

        Raises:
            InputError: it does not fit this palette, in one line.
        """
        if not material.is_floating_point():
            low, high = self._range_of(material)
            if mask is not None and not 0 <= low <= high < len(self):
                low, high = self._range_of(torch.where(mask > 0, material, 0))
            if low < 0 or high >= len(self):
                raise InputError(
                    f"{where}: expected indices 0…{len(self) - 1} of the palette "
                    f"({', '.join(self.names)}), got {low if low < 0 else high}"
                )
            return low, high
        if material.shape[1] != len(self):
            raise InputError(
                f"{where}: expected {len(self)} weights a pixel, one for each of "
                f"{', '.join(self.names)}, got {material.shape[1]}"
            )
        detached = material.detach().float()
        error = (detached.sum(1, keepdim=True) - 1).abs()
        bad = (error > _LARGEST_SUM_ERROR) | (detached < 0).any(1, keepdim=True) | error.isnan()
        if mask is not None:
            bad = bad & (mask > 0)
        if bool(bad.any()):
            b, _, y, x = torch.broadcast_tensors(bad, bad)[0].nonzero()[0].tolist()
            found = ", ".join(f"{w:.4g}" for w in detached[b, :, y, x].tolist())
            raise InputError(
                f"{where}: expected weights of 0 or more that sum to 1, got {found} in image {b}, "
                f"row {first_row + y}, column {x}"
            )
        return 0, len(self) - 1
