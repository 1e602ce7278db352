"""`raden relight`: photographs under new lamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from raden_torch.cli.option_types import (
    Bytes,
    LampOption,
    LampOrFile,
    Lamps,
    ModelFile,
    files,
    lights_of,
    output,
)
from raden_torch.cli.picture_options import EnvironmentOptions, ExrOptions, RelitDisplayOptions
from raden_torch.cli.sequence_options import SequenceOptions
from raden_torch.cli.status import without_other_inputs, working
from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.brdf.shading.lights import Light
    from raden_torch.relighting import Coded


@Parameter(name="*")
@dataclass(frozen=True)
class RelightOptions:
    """What is relit, and under which lamps."""

    normals: Path
    """normal map: PNG (8 or 16 bits), TIFF; EXR, also with depth"""
    model: ModelFile
    mask: Path | None = None
    """mask of what to relight, with a soft edge; by default wherever there are normals"""
    light: Lamps = ()
    """x,y,z towards a lamp at infinity; may be repeated"""
    strip: int | None = None
    """instead of --light: this many lamps in a ring, side by side"""
    sheet: int | None = None
    """instead of --light: this many lamps in a ring, as a contact sheet"""
    elevation_deg: float = 40.0
    """elevation of the ring of lamps above the image plane, degrees"""
    original_light: LampOrFile | None = None
    """keep the photograph's texture: the lamp it was taken under, as x,y,z, or the normals.json of
    `raden capture normals`"""
    linear: bool = False
    """read whole numbers in the photographs as linear light"""
    colour: Path | None = None
    """colour file of `raden capture colour`, for photographs in the camera's own RGB, as raw files
    are; by default raw files have the colours that they say themselves"""
    green: Literal["opengl", "directx"] = "opengl"
    """which way green points in the normal map"""
    memory: Bytes = 4 * 1024**3
    """for --frames: that of all frames under way"""

    def __post_init__(self) -> None:
        if sum((self.strip is not None, self.sheet is not None, bool(self.light))) > 1:
            raise InputError(
                "--strip and --sheet bring their own lamps; give one of them or --light"
            )

    @property
    def layout(self) -> Literal["picture", "strip", "sheet"]:
        return "strip" if self.strip else "sheet" if self.sheet else "picture"

    @property
    def coded(self) -> Coded:
        from raden_torch.relighting import CameraRgb

        if self.colour is not None:
            return CameraRgb(self.colour, self.linear)
        return "linear" if self.linear else "srgb"

    def lamps(self) -> Sequence[Light]:
        """The lamps of one picture, or of the ring."""
        from raden_torch.brdf.shading.relight import lamp_ring

        count = self.strip if self.strip is not None else self.sheet
        if count is None:
            return lights_of(self.light or [LampOption((1.0, 1.0, 2.0))])
        return lamp_ring(count, self.elevation_deg)


def relight(
    *photos: Annotated[Path, files("one or more photographs of one size")],
    output: Annotated[Path, output("the image to write; a folder for several")],
    how: RelightOptions,
    around: EnvironmentOptions = EnvironmentOptions(),
    display: RelitDisplayOptions = RelitDisplayOptions(),
    exr: ExrOptions = ExrOptions(),
    sequence: SequenceOptions = SequenceOptions(),
) -> None:
    from raden_torch.relighting import relight_files
    from raden_torch.sequences.plan import check_no_pattern

    surrounded = around.environment is not None or around.light_setup is not None
    if surrounded and (how.strip or how.sheet):
        raise InputError(
            "--strip and --sheet show one lamp each; leave out --environment and --light-setup"
        )
    if sequence.frames is not None:
        _relight_frames(photos, output, how, around, display, exr, sequence)
        return
    for photo in photos:
        check_no_pattern(photo)
    used = without_other_inputs(
        photos, how.normals, how.mask, how.model, how.colour, around.environment, exr.material
    )
    surroundings = around.lights()
    lights = [*(lights_of(how.light) if surroundings else how.lamps()), *surroundings]
    with working("relighting"):
        written = relight_files(
            used,
            how.normals,
            how.mask,
            how.model,
            output,
            lights,
            layout=how.layout,
            original=how.original_light,
            coded=how.coded,
            green=how.green,
            reading=exr.reading,
            display=display.display,
        )
    for path in written:
        print(f"wrote {path}")


def _relight_frames(
    photos: Sequence[Path],
    output: Path,
    how: RelightOptions,
    around: EnvironmentOptions,
    display: RelitDisplayOptions,
    exr: ExrOptions,
    sequence: SequenceOptions,
) -> None:
    from raden_torch.cli.sequence_run import run_frames
    from raden_torch.sequences.plan import target_pattern
    from raden_torch.sequences.relight_job import RelightJob, plan_relight
    from raden_torch.sequences.report import one_warning_of_a_kind

    if len(photos) != 1 or sequence.frames is None:
        raise InputError(
            f"photos: expected one name as shot.####.png with --frames, got {len(photos)}"
        )
    surrounded = around.environment is not None or around.light_setup is not None
    lamps = lights_of(how.light) if surrounded else how.lamps()
    job = RelightJob(
        target=target_pattern(output, photos[0].name),
        force=sequence.force,
        photo=photos[0],
        normals=how.normals,
        mask=how.mask,
        model=how.model,
        lighting=replace(around.lighting, lamps=tuple(lamps)),
        layout=how.layout,
        green=how.green,
        reading=exr.reading,
        display=display.display,
        original=how.original_light,
        coded=how.coded,
    )
    with one_warning_of_a_kind():
        with working("looking at the frames"):
            job, frames = plan_relight(job, sequence.frames, skip_missing=sequence.skip_missing)
        run_frames(job, frames, sequence, how.memory)
