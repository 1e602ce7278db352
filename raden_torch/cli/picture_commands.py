"""Pictures: render, demo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

from cyclopts import Parameter

from raden_torch.cli.option_types import (
    Lamps,
    RenderedModel,
    Triple,
    lights_of,
    output,
)
from raden_torch.cli.picture_options import (
    DisplayOptions,
    EnvironmentOptions,
    GBufferOptions,
    SpectrumOptions,
)
from raden_torch.cli.sequence_options import SequenceOptions
from raden_torch.cli.status import console, progress, working
from raden_torch.errors import InputError
from raden_torch.files import check_output, check_outputs
from raden_torch.packages import require

if TYPE_CHECKING:
    from torch import Tensor

    from raden_torch.brdf.files.gbuffer_reading import GBufferReading
    from raden_torch.brdf.materials.surface import Reflection
    from raden_torch.brdf.model.model import RadenBrdf
    from raden_torch.brdf.shading.lights import Light


@Parameter(name="*")
@dataclass(frozen=True)
class ShapeOptions:
    """A shape to light, and how it is seen."""

    shape: str = "sphere"
    """what to show: sphere; plate (black urushi with a motif); board (the motif, once for each
    material of a palette)"""
    camera: Triple | None = None
    """the camera's position x,y,z; y is up. Of a --gbuffer with positions, in their frame"""
    size: int | None = None
    """width and height in pixels, 512 unless stated; of a scene its width"""
    samples: int | None = None
    """rays per pixel along each side, 2 unless stated; of a scene those at edges"""

    def image(
        self, model: Reflection, lights: Sequence[Light], tangent: Triple | None = None
    ) -> Tensor:
        """`[1, 3, size, size]` scene-linear RGB."""
        from raden_torch.pictures import render_shape

        return render_shape(
            model,
            self.shape,
            lights,
            camera=self.camera,
            tangent=tangent,
            size=self.pixels,
            samples=self.rays,
        )

    @property
    def pixels(self) -> int:
        return 512 if self.size is None else self.size

    @property
    def rays(self) -> int:
        return 2 if self.samples is None else self.samples


@dataclass(frozen=True)
class _Asked:
    """What `render` was asked for, beside frames and standard deviations."""

    model: Path
    output: Path
    light: Lamps
    around: EnvironmentOptions
    spectrum: SpectrumOptions
    display: DisplayOptions
    shape: ShapeOptions
    gbuffer: Path | None
    exr: GBufferOptions

    @property
    def reading(self) -> GBufferReading:
        """Of the G-buffer, with the camera that is given beside it."""
        camera = self.shape.camera
        return self.exr.reading if camera is None else replace(self.exr.reading, camera=camera)

    @property
    def is_plain(self) -> bool:
        """Whether nothing was said that a scene file says itself."""
        own = (self.light, self.around, self.spectrum, self.gbuffer, self.exr)
        usual = ((), EnvironmentOptions(), SpectrumOptions(), None, GBufferOptions())
        return own == usual and (self.shape.shape, self.shape.camera) == ("sphere", None)

    @property
    def files(self) -> tuple[Path | None, ...]:
        """What is read."""
        said = (self.around.environment, self.exr.material, self.exr.camera_file)
        return (self.model, self.gbuffer, *said, *self.spectrum.files)


def render(
    model: RenderedModel,
    /,
    *,
    output: Annotated[Path, output("the .png, .jpg or (linear) .exr to write")] = Path(
        "render.png"
    ),
    light: Annotated[
        Lamps,
        Parameter(help="x,y,z towards a lamp at infinity, or point:x,y,z; may be repeated"),
    ] = (),
    around: EnvironmentOptions = EnvironmentOptions(),
    spectrum: SpectrumOptions = SpectrumOptions(),
    display: DisplayOptions = DisplayOptions(),
    shape: ShapeOptions = ShapeOptions(),
    gbuffer: Annotated[
        Path | None, Parameter(help="an EXR with normals or depth to light, instead of a shape")
    ] = None,
    exr: GBufferOptions = GBufferOptions(),
    sequence: SequenceOptions = SequenceOptions(),
    std: Annotated[
        Path | None,
        Parameter(
            help="also write the picture's standard deviations, of a model of `raden fit --std`: "
            "a map in percent (.png, .svg or .pdf), or linear layers own and systematic (.exr)"
        ),
    ] = None,
) -> None:
    asked = _Asked(model, output, light, around, spectrum, display, shape, gbuffer, exr)
    if model.suffix.lower() == ".toml":
        from raden_torch.cli.scene_command import render_scene

        is_plain = asked.is_plain and std is None
        render_scene(model, output, display, shape.size, shape.samples, sequence, is_plain=is_plain)
    elif sequence.frames is None:
        _render_picture(asked, std)
    elif std is None:
        _render_frames(asked, sequence)
    else:
        raise InputError("--std: expected one picture, got --frames")


def _render_picture(asked: _Asked, std: Path | None) -> None:
    """One picture, and what its standard deviations are, where they are asked for."""
    from raden_torch.pictures import load_material, save_picture
    from raden_torch.sequences.plan import check_no_pattern

    output, shown_by = asked.output, asked.display.display
    shown_by.check_path(output)
    check_output(output, inputs=asked.files)
    lights = [*lights_of(asked.light), *asked.around.lights()]
    if asked.gbuffer is None:
        asked.exr.check_without_gbuffer()
    else:
        check_no_pattern(asked.gbuffer)
    if std is not None:
        _check_std(std, asked)
    loaded = load_material(asked.model, asked.spectrum.illuminant, asked.spectrum.white)
    if std is not None:
        used = _render_with_std(loaded, asked, std, lights)
        print(f"wrote {output} (exposure {used:+.2f} stops)\nwrote {std}")
        return
    if asked.gbuffer is None:
        with working("rendering"):
            image = asked.shape.image(loaded, lights, asked.exr.tangent)
            used = save_picture(image, output, loaded, display=shown_by)
    else:
        used = _render_gbuffer(loaded, asked, asked.gbuffer, lights)
    print(f"wrote {output} (exposure {used:+.2f} stops)")


def _render_gbuffer(
    model: Reflection, asked: _Asked, gbuffer: Path, lights: Sequence[Light]
) -> float:
    """The stops that it was exposed by."""
    from raden_torch.pictures import render_gbuffer, render_gbuffer_file, save_picture

    exr, output, shown_by = asked.exr, asked.output, asked.display.display
    reading = asked.reading
    lights = [reading.light(light) for light in lights]
    if output.suffix.lower() == ".exr":
        with progress("rendering") as shown:
            return render_gbuffer_file(
                model,
                gbuffer,
                output,
                lights,
                reading,
                display=shown_by,
                tolerance=exr.tolerance,
                memory=exr.memory,
                shadowed=exr.shadowed,
                shown=shown,
            )
    with working("rendering"):
        image = render_gbuffer(
            model, gbuffer, lights, reading, tolerance=exr.tolerance, shadowed=exr.shadowed
        )
        return save_picture(image, output, model, display=shown_by)


def _check_std(std: Path, asked: _Asked) -> None:
    check_outputs(asked.output, std, inputs=asked.files)
    if std.suffix.lower() != ".exr":
        from raden_torch.plots import PLOT_SUFFIXES

        check_output(std, (*PLOT_SUFFIXES, ".exr"))
    if asked.shape.shape != "sphere":
        raise InputError(f"--std: expected the shape sphere, or --gbuffer, got {asked.shape.shape}")
    if asked.exr.memory != GBufferOptions().memory or asked.exr.tolerance:
        raise InputError("--std: expected without --memory and --tolerance, got one of them")


def _render_with_std(
    model: Reflection, asked: _Asked, std_path: Path, lights: Sequence[Light]
) -> float:
    """The stops that the picture was exposed by."""
    from raden_torch.pictures import gbuffer_with_std, save_picture, sphere_with_std

    shape, gbuffer = asked.shape, asked.gbuffer
    with working("rendering"):
        if gbuffer is None:
            image, std = sphere_with_std(
                model, lights, camera=shape.camera, size=shape.pixels, samples=shape.rays
            )
        else:
            reading, shadowed = asked.reading, asked.exr.shadowed
            lights = [reading.light(light) for light in lights]
            image, std = gbuffer_with_std(model, gbuffer, lights, reading, shadowed=shadowed)
        used = save_picture(image, asked.output, model, display=asked.display.display)
        if std_path.suffix.lower() == ".exr":
            from raden_torch.brdf.files.exr_tensors import write_std

            write_std(std, std_path)
        else:
            from raden_torch.plots import draw_std, save_plot

            save_plot(draw_std(image, std, cast("RadenBrdf", model).provenance), std_path)
    return used


def _render_frames(asked: _Asked, sequence: SequenceOptions) -> None:
    from raden_torch.cli.sequence_run import run_frames
    from raden_torch.sequences.plan import target_pattern
    from raden_torch.sequences.render_job import RenderJob, plan_render

    model, gbuffer, exr = asked.model, asked.gbuffer, asked.exr
    if gbuffer is None or sequence.frames is None:
        raise InputError(f"{model}: `frames`: expected with --gbuffer or a scene file, got neither")
    job = RenderJob(
        target=target_pattern(asked.output, gbuffer.name),
        force=sequence.force,
        model=model,
        gbuffer=gbuffer,
        reading=asked.reading,
        lighting=replace(asked.around.lighting, lamps=tuple(lights_of(asked.light))),
        display=asked.display.display,
        tolerance=exr.tolerance,
        shadowed=exr.shadowed,
        illuminant=asked.spectrum.illuminant,
        white=asked.spectrum.white,
    )
    with working("looking at the frames"):
        job, frames = plan_render(job, sequence.frames, skip_missing=sequence.skip_missing)
    run_frames(job, frames, sequence, exr.memory)


def demo(
    *,
    out: Annotated[Path, Parameter(help="the folder for the gallery")] = Path("demo"),
    size: Annotated[int, Parameter(help="image size in pixels")] = 512,
) -> None:
    require("the demo's pictures", "images", "plots", "export")
    from raden_torch.demo import run_demo

    page = run_demo(out, size=size, console=console())
    print(f"open {page}")
