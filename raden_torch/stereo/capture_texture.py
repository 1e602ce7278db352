"""Photographs of an inlay → what `raden relight` and `render` read: `raden capture texture`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from raden_torch.brdf.files.image_file import read_normal_map
from raden_torch.brdf.files.lit_model import load_lit
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.materials.urushi import black_urushi
from raden_torch.capture.photo.capture_normals import LitSet, read_lit_set
from raden_torch.capture.photo.colour import read_colour
from raden_torch.capture.photo.matt_reference import angle_deg
from raden_torch.capture.photo.stored_photograph import Coding
from raden_torch.errors import InputError
from raden_torch.stereo.inlay import Inlay, find_inlay
from raden_torch.stereo.inlay_shells import InlayShells, find_shells
from raden_torch.stereo.lamp_assignment import agreement
from raden_torch.stereo.learnt_palette import LearntPalette
from raden_torch.stereo.observed_light import ObservedLight, thinned
from raden_torch.stereo.photographed import Photographed
from raden_torch.stereo.pieces import pieces_of, shells_of
from raden_torch.stereo.solve import SAMPLE, ModelNormals

_UNEVEN_DEG = 2.0
"""Layers that vary by more within a piece are seen as such."""


@dataclass(frozen=True)
class TextureOptions:
    """How an inlay is read.

    Attributes:
        models: one a shell; none where they are learnt from the photographs.
        shells: how many are learnt; with a map, as many as it tells apart.
        white: the photographs' linear value of a white diffuser that faces the lamp, which the
            scale of what is learnt rests on; see `learn_palette`.
        ground: of the lacquer between the pieces; black urushi where None.
        map: which shell each pixel shows, from 1 in the order of `models`, 0 for the ground;
            where None, pieces are looked for and each takes the shell that fits.
        normals: of the polished surface; it faces the camera where None.
        colour: of `raden capture colour`; without it the photographs have sRGB's primaries.
        per_pixel: each pixel keeps its own layer normal.
        gain: keep the factor on the palette's reflection, pixel by pixel.
        smallest_px: an area of fewer pixels is no piece, nor is one of fewer than 4.
        exponent, keep_order, coded: as for `capture_normals`.
    """

    models: tuple[Path, ...] = ()
    shells: int | None = None
    white: float | None = None
    ground: Path | None = None
    map: Path | None = None
    normals: Path | None = None
    colour: Path | None = None
    per_pixel: bool = False
    gain: bool = False
    smallest_px: int = 16
    exponent: float | None = None
    keep_order: bool = False
    coded: Coding = "auto"

    @property
    def files(self) -> tuple[Path | None, ...]:
        """What is read beside photographs, lamps and mask."""
        return (*self.models, self.ground, self.map, self.normals, self.colour)


@dataclass(frozen=True, eq=False)
class FoundInlay:
    """The inlay, and what it was found with.

    Attributes:
        palette: the ground and the shells.
        surface: `[3, H·W]`; `residual`: `[K]`, how far each photograph is from what was found, in
            the median over pixels, each relative to its mean light over all lamps.
        learnt: what the palette was learnt from; None where it was given.
    """

    inlay: Inlay
    palette: Palette
    given: LitSet
    surface: Tensor
    residual: Tensor
    notes: tuple[str, ...]
    learnt: LearntPalette | None = None

    @cached_property
    def tilt_deg(self) -> Tensor:
        """`[H·W]` between the film layers and the surface."""
        return angle_deg(self.inlay.layer_normal, self.surface)

    def __str__(self) -> str:
        """A line a shell: its pieces and how their layers lean."""
        tilt, lines = self.tilt_deg, []
        for place, name in enumerate(self.palette.names):
            there = self.inlay.material == place
            share = 100 * float(there.float().mean())
            line = f"{name}: {share:.1f} % of the picture"
            pieces = sum(piece.material == place for piece in self.inlay.pieces)
            if pieces:
                low, high = (float(x) for x in tilt[there].aminmax())
                line += f", {pieces} pieces, layers lean by {low:.1f} to {high:.1f} degrees"
            lines.append(line)
        return "\n".join(lines)


@torch.no_grad()
def capture_texture(
    photographs: Sequence[Path],
    lights: Path,
    mask: Path | None,
    options: TextureOptions,
    *,
    progress: Callable[[float], None] | None = None,
) -> FoundInlay:
    """Read photographs, lamps and models, and find the pieces' shells and layers.

    Raises:
        InputError: as for what it is made of; no piece; photographs in another order than the
            lamps.

    Warns:
        UserWarning: photographs that disagree with the others.
    """
    done = progress or (lambda share: None)
    count = _count(options)
    models = [_one(path) for path in options.models]
    ground = black_urushi() if options.ground is None else _one(options.ground)
    given = read_lit_set(
        photographs,
        lights,
        mask,
        exponent=options.exponent,
        coded=options.coded,
        progress=lambda share: done(0.1 * share),
    )
    areas = pieces_of(given, options.map, count, options.smallest_px)
    surface = _surface(given, options.normals)
    correction = None if options.colour is None else read_colour(options.colour)
    seen = Photographed.of(given, correction)
    names = [path.stem for path in options.models] or [f"shell{k + 1}" for k in range(count)]
    before = 0.1 if models else 0.7
    told = find_shells(
        InlayShells(models, *areas),
        seen,
        surface,
        names,
        photographs,
        white=options.white,
        split_px=options.smallest_px if options.map is None else None,
        progress=lambda share: done(0.1 + 0.6 * share),
    )
    shells, learnt = told.shells, told.learnt
    names = ["ground", *names]
    palette = Palette([ground, *shells], names if len(set(names)) == len(names) else ())
    inlay = find_inlay(
        seen,
        shells,
        told.pieces,
        surface,
        given=None if options.map is None else told.shell_of,
        per_pixel=options.per_pixel,
        progress=lambda share: done(before + (1 - before) * share),
    )
    light, fitted = _sample(seen, inlay, surface)
    residual, notes = agreement(shells, light, fitted, photographs, keep_order=options.keep_order)
    notes += () if learnt is None else learnt.notes
    uneven = sum(piece.varies_deg > _UNEVEN_DEG for piece in inlay.pieces)
    if uneven and not options.per_pixel:
        notes.append(
            f"in {uneven} of {len(inlay.pieces)} pieces the layers lean by more than "
            f"{_UNEVEN_DEG:g} degrees to and fro, which one normal a piece leaves out: `per_pixel` "
            "keeps it"
        )
    for note in notes:
        warnings.warn(note, stacklevel=2)
    return FoundInlay(inlay, palette, given, surface, residual, tuple(notes), learnt)


def _count(options: TextureOptions) -> int:
    """How many shells there are."""
    if options.models:
        if options.shells is not None or options.white is not None:
            which = "white" if options.shells is None else "shells"
            raise InputError(
                f"`{which}`: expected only without a model, as what is learnt needs it, got both"
            )
        return len(options.models)
    if options.shells is not None:
        return options.shells
    if options.map is not None:
        return shells_of(options.map)
    raise InputError(
        "`model`: expected one for each shell, got none; or say by `shells` how many there are, to "
        "learn them from these photographs"
    )


def _one(path: Path) -> Reflection:
    model = load_lit(path)
    if isinstance(model, Palette):
        if len(model) != 1:
            raise InputError(
                f"{path}: expected the model of one shell, got a palette of {len(model)}; give "
                "its members one by one"
            )
        return model[0]
    return model


def _surface(given: LitSet, path: Path | None) -> Tensor:
    """`[3, H·W]`"""
    height, width = given.photos.size
    up = torch.tensor([[0.0], [0.0], [1.0]]).repeat(1, height * width)
    if path is None:
        return up
    normal = read_normal_map(path)
    if normal.shape[2:] != (height, width):
        raise InputError(
            f"{path}: expected the photographs' {width} x {height} pixels, got "
            f"{normal.shape[3]} x {normal.shape[2]}"
        )
    flat = normal[0].flatten(1).float()
    return torch.where((flat != 0).any(0), flat, up)


def _sample(
    seen: Photographed, inlay: Inlay, surface: Tensor
) -> tuple[ObservedLight, ModelNormals]:
    """Pixels of the pieces, and what was found there."""
    there = (inlay.material > 0).nonzero()[:, 0]
    index = thinned(there, SAMPLE)
    light = replace(seen.at(index), surface=surface[:, index])
    gain = inlay.gain[:, index].mean(0) * inlay.exposure
    zero = torch.zeros(len(index))
    found = ModelNormals(inlay.layer_normal[:, index], gain, zero, zero, inlay.material[index] - 1)
    return light, found
