"""`raden capture texture`: a photographed inlay as a palette and a G-buffer to relight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from raden_torch.cli.capture_options import Coded, LightsFile
from raden_torch.cli.option_types import files, output, switch
from raden_torch.cli.status import progress, without_other_inputs
from raden_torch.errors import InputError
from raden_torch.files import check_outputs

if TYPE_CHECKING:
    from raden_torch.stereo.capture_texture import TextureOptions


@Parameter(name="*")
@dataclass(frozen=True)
class InlayOptions:
    """What the inlay is made of, and how it is read."""

    model: tuple[Path, ...] = ()
    """model (.safetensors) of a shell in it; once for each shell; without one the shells are learnt
    from the photographs"""
    shells: int | None = None
    """how many shells there are, to be learnt from 5 photographs or more; with --map, as many as
    it tells apart"""
    white: float | None = None
    """linear value, 0…1, of a white diffuser that faces the lamp in the photographs: the scale of
    the shells that are learnt; by default the brightest reflects 40 %"""
    ground: Path | None = None
    """model of the lacquer around the pieces; black urushi unless given"""
    map: Path | None = None
    """which shell each pixel shows: indices from 1 in the models' order, 0 for the lacquer; by
    default pieces are looked for, and each takes the shell that fits"""
    normals: Path | None = None
    """normal map of the polished surface; it faces the camera unless given"""
    colour: Path | None = None
    """colour file of `raden capture colour`; by default the photographs are sRGB's colours"""
    per_pixel: Annotated[bool, switch("film layers lean pixel by pixel, not piece by piece")] = (
        False
    )
    gain: Annotated[bool, switch("keep how much brighter each pixel is than its model")] = False
    smallest_px: int = 16
    """an area of fewer pixels is no piece, nor is one of fewer than 4"""
    exponent: float | None = None
    """exponent of the response; by default the one in the lights file"""
    keep_order: Annotated[bool, switch("do not stop if another order of the lamps fits better")] = (
        False
    )
    coded: Coded = "auto"

    def __post_init__(self) -> None:
        if self.smallest_px < 1:
            raise InputError(f"smallest_px: expected at least 1, got {self.smallest_px}")
        if self.shells is not None and not 1 <= self.shells <= 254:
            raise InputError(f"shells: expected 1…254, got {self.shells}")
        if self.white is not None and not self.white > 0:
            raise InputError(f"white: expected more than 0, got {self.white}")

    @property
    def options(self) -> TextureOptions:
        """The same for the library."""
        from raden_torch.stereo.capture_texture import TextureOptions

        own = dict(vars(self))
        return TextureOptions(models=own.pop("model"), **own)


def texture(
    *photos: Annotated[Path, files("photographs of the inlay, one under each lamp, in order")],
    lights: LightsFile,
    output: Annotated[Path, output("the folder for palette, G-buffer and maps")],
    mask: Annotated[
        Path | None, Parameter(help="mask, white on the inlay; by default everything")
    ] = None,
    how: InlayOptions = InlayOptions(),
) -> None:
    from raden_torch.plots.capture_figures import draw_inlay
    from raden_torch.plots.sheet import save_plot
    from raden_torch.stereo.capture_texture import capture_texture
    from raden_torch.stereo.inlay_file import paths_in, write_inlay

    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: expected a folder, got a file")
    options = how.options
    used = without_other_inputs(photos, mask, how.map, how.normals)
    picture = output / "found.png"
    if output.is_dir():
        inputs = (*used, lights, mask, *options.files)
        check_outputs(*paths_in(output), picture, inputs=inputs)
    with progress("looking at the pieces") as share_done:
        found = capture_texture(used, lights, mask, options, progress=share_done)
    output.mkdir(parents=True, exist_ok=True)
    written = write_inlay(found, output, used, options)
    height, width = found.given.photos.size
    maps = (found.inlay.material, found.tilt_deg, found.inlay.error_deg)
    save_plot(
        draw_inlay(
            found.given.photos.images.mean(0).movedim(0, -1).numpy(),
            *(m.reshape(height, width).numpy() for m in maps),
            names=found.palette.names,
            residual=found.residual.numpy(),
            photographs=used,
        ),
        picture,
    )
    print(found)
    for path in written:
        print(f"wrote {path}")
    print(f"wrote {picture} (look at it)")
