"""Materials by the names that a scene gives them, or that everybody knows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from raden_torch.artwork.box_decoration import GOLD, SEAM
from raden_torch.brdf.files.lit_model import load_lit
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil
from raden_torch.brdf.materials.simulated_shell import SimulatedShell
from raden_torch.brdf.materials.urushi import (
    URUSHI_INDEX,
    Lambertian,
    black_urushi,
    vermilion_urushi,
)
from raden_torch.errors import InputError
from raden_torch.optics.specimens import SPECIMENS
from raden_torch.scene.dressing import FLAKES, LAYERS, SURFACE, Covering
from raden_torch.scene.scene_file import MaterialTable
from raden_torch.schema import nearest

POLISH = 0.012
"""GGX α of mirror-polished urushi (*roiro*): an assumption."""
_POWDER, _POWDER_COAT = 0.3, 0.2
_TABLETS = {
    "yakogai": (0.95, 1.05), "mexican": (0.92, 1.12), "awabi": (1.0,), "akoya": (1.0,),
    "abalone": (1.0,),
}  # fmt: skip
"""Over a shell's own: what its pieces are blended of."""
_KINDS = ("model", "shell", "urushi", "metal", "albedo")

_BUILT_IN = {
    **{name: MaterialTable(name=name, shell=name) for name in SPECIMENS},
    "black": MaterialTable(name="black", urushi="black"),
    "vermilion": MaterialTable(name="vermilion", urushi="vermilion"),
    GOLD: MaterialTable(name=GOLD, metal="gold"),
    "silver": MaterialTable(name="silver", metal="silver"),
    SEAM: MaterialTable(name=SEAM, albedo=(0.003, 0.003, 0.003)),
}


@dataclass(frozen=True)
class Named:
    """A material by its name.

    Attributes:
        scales: tablet scales, one for each covering; 1 alone where it has but one.
    """

    coverings: tuple[Covering, ...]
    scales: tuple[float, ...]
    simulated: str | None
    polish: Coated | None


class MaterialNames:
    """Materials of a scene file, each made when it is first asked for."""

    def __init__(self, tables: Sequence[MaterialTable], folder: Path, where: str) -> None:
        self._folder, self._where = folder, where
        self._tables = dict(_BUILT_IN)
        self._made: dict[str, Named] = {}
        seen: set[str] = set()
        for place, table in enumerate(tables):
            here = f"{where}: materials[{place}]"
            if table.name in seen:
                raise InputError(f"{here}: expected another name, got {table.name!r} twice")
            seen.add(table.name)
            given = [kind for kind in _KINDS if getattr(table, kind) is not None]
            if len(given) != 1:
                raise InputError(
                    f"{here}: expected one of {', '.join(_KINDS)}, got "
                    f"{' and '.join(given) or 'none'}"
                )
            if table.shell is not None and table.shell not in SPECIMENS:
                raise InputError(
                    f"{here}: shell: expected one of {', '.join(SPECIMENS)}, got {table.shell!r}"
                )
            if table.tablets is not None and (
                table.shell is None
                or not table.tablets
                or sorted(set(table.tablets)) != table.tablets
            ):
                raise InputError(
                    f"{here}: tablets: expected rising numbers beside a shell, got {table.tablets}"
                )
            self._tables[table.name] = table

    def check(self, names: Iterable[str], where: str) -> None:
        for name in names:
            if name not in self._tables:
                raise InputError(
                    f"{self._where}: {where}: expected a material, one of "
                    f"{', '.join(sorted(self._tables))}, got {name!r}"
                    f"{nearest(name, self._tables)}"
                )

    def of(self, name: str) -> Named:
        if name not in self._made:
            self._made[name] = self._make(self._tables[name])
        return self._made[name]

    def _make(self, table: MaterialTable) -> Named:
        if table.shell is not None:
            scales = tuple(table.tablets or _TABLETS[table.shell])
            shells = (SimulatedShell(table.shell, scale) for scale in scales)
            coverings = tuple(Covering(table.name, shell, LAYERS, True) for shell in shells)
            return Named(coverings, scales, table.shell, None)
        if table.model is not None:
            model: Any = load_lit(self._folder / table.model)
            source = model.provenance
            covering = Covering(table.name, model, LAYERS, source.simulated)
            return Named((covering,), (1.0,), source.sample if source.simulated else None, None)
        if table.metal is not None:
            foil = Foil(table.metal, table.roughness or _POWDER, URUSHI_INDEX)
            powder = Covering(
                table.name, Coated(foil, URUSHI_INDEX, roughness=_POWDER_COAT), FLAKES
            )
            return Named((powder,), (1.0,), None, None)
        if table.albedo is not None:
            matt = Covering(table.name, Lambertian(table.albedo), SURFACE)
            return Named((matt,), (1.0,), None, None)
        urushi = black_urushi if table.urushi == "black" else vermilion_urushi
        coat = urushi(table.roughness or POLISH)
        return Named(
            (Covering(table.name, coat.without_gloss(), SURFACE, True),), (1.0,), None, coat
        )
