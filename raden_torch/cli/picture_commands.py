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

    from raden_torch.brdf.files.display import Display
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
            size=512 if self.size is None else self.size,
            samples=2 if self.samples is None else self.samples,
        )


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
    if model.suffix.lower() == ".toml":
        from raden_torch.cli.scene_command import render_scene

        own = (light, around, spectrum, gbuffer, exr, shape.shape, shape.camera, std)
        is_plain = own == _NO_SCENE_OF_ITS_OWN
        render_scene(model, output, display, shape.size, shape.samples, sequence, is_plain=is_plain)
        return
    if sequence.frames is not None:
        if std is not None:
            raise InputError("--std: expected one picture, got --frames")
        _render_frames(
            model, output, light, around, spectrum, display, gbuffer, exr, shape.camera, sequence
        )
        return
    _render_picture(model, output, light, around, spectrum, display, shape, gbuffer, exr, std)


def _render_picture(
    model: Path,
    output: Path,
    light: Lamps,
    around: EnvironmentOptions,
    spectrum: SpectrumOptions,
    display: DisplayOptions,
    shape: ShapeOptions,
    gbuffer: Path | None,
    exr: GBufferOptions,
    std: Path | None,
) -> None:
    """One picture, and what its standard deviations are, where they are asked for."""
    from raden_torch.pictures import load_material, save_picture
    from raden_torch.sequences.plan import check_no_pattern

    shown_by = display.display
    shown_by.check_path(output)
    read = (model, gbuffer, around.environment, exr.material, exr.camera_file, *spectrum.files)
    check_output(output, inputs=read)
    lights = [*lights_of(light), *around.lights()]
    if gbuffer is None:
        exr.check_without_gbuffer()
    else:
        check_no_pattern(gbuffer)
    if std is not None:
        _check_std(std, output, read, shape, exr)
    loaded = load_material(model, spectrum.illuminant, spectrum.white)
    if std is not None:
        used = _render_with_std(loaded, gbuffer, (output, std), lights, exr, shape, shown_by)
        print(f"wrote {output} (exposure {used:+.2f} stops)\nwrote {std}")
        return
    if gbuffer is None:
        with working("rendering"):
            image = shape.image(loaded, lights, exr.tangent)
            used = save_picture(image, output, loaded, display=shown_by)
    else:
        used = _render_gbuffer(loaded, gbuffer, output, lights, exr, shape.camera, shown_by)
    print(f"wrote {output} (exposure {used:+.2f} stops)")


def _render_gbuffer(
    model: Reflection,
    gbuffer: Path,
    output: Path,
    lights: Sequence[Light],
    exr: GBufferOptions,
    camera: Triple | None,
    shown_by: Display,
) -> float:
    """The stops that it was exposed by."""
    from raden_torch.pictures import render_gbuffer, render_gbuffer_file, save_picture

    reading = exr.reading if camera is None else replace(exr.reading, camera=camera)
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


def _check_std(
    std: Path,
    output: Path,
    read: Sequence[Path | None],
    shape: ShapeOptions,
    exr: GBufferOptions,
) -> None:
    check_outputs(output, std, inputs=read)
    if std.suffix.lower() != ".exr":
        from raden_torch.plots import PLOT_SUFFIXES

        check_output(std, (*PLOT_SUFFIXES, ".exr"))
    if shape.shape != "sphere":
        raise InputError(f"--std: expected the shape sphere, or --gbuffer, got {shape.shape}")
    if exr.memory != GBufferOptions().memory or exr.tolerance:
        raise InputError("--std: expected without --memory and --tolerance, got one of them")


def _render_with_std(
    model: Reflection,
    gbuffer: Path | None,
    outputs: tuple[Path, Path],
    lights: Sequence[Light],
    exr: GBufferOptions,
    shape: ShapeOptions,
    shown_by: Display,
) -> float:
    """The stops that the picture was exposed by."""
    from raden_torch.pictures import gbuffer_with_std, save_picture, sphere_with_std

    output, std_path = outputs
    with working("rendering"):
        if gbuffer is None:
            image, std = sphere_with_std(
                model,
                lights,
                camera=shape.camera,
                size=512 if shape.size is None else shape.size,
                samples=2 if shape.samples is None else shape.samples,
            )
        else:
            reading = exr.reading
            if shape.camera is not None:
                reading = replace(reading, camera=shape.camera)
            lights = [reading.light(light) for light in lights]
            image, std = gbuffer_with_std(model, gbuffer, lights, reading, shadowed=exr.shadowed)
        used = save_picture(image, output, model, display=shown_by)
        if std_path.suffix.lower() == ".exr":
            from raden_torch.brdf.files.exr_tensors import write_std

            write_std(std, std_path)
        else:
            from raden_torch.plots import draw_std, save_plot

            save_plot(draw_std(image, std, cast("RadenBrdf", model).provenance), std_path)
    return used


_NO_SCENE_OF_ITS_OWN = (
    *((), EnvironmentOptions(), SpectrumOptions(), None),
    *(GBufferOptions(), "sphere", None, None),
)
"""`render`'s options that a scene file says itself, as they are where none is given."""


def _render_frames(
    model: Path,
    output: Path,
    light: Lamps,
    around: EnvironmentOptions,
    spectrum: SpectrumOptions,
    display: DisplayOptions,
    gbuffer: Path | None,
    exr: GBufferOptions,
    camera: Triple | None,
    sequence: SequenceOptions,
) -> None:
    from raden_torch.cli.sequence_run import run_frames
    from raden_torch.sequences.plan import target_pattern
    from raden_torch.sequences.render_job import RenderJob, plan_render

    if gbuffer is None or sequence.frames is None:
        raise InputError(f"{model}: `frames`: expected with --gbuffer or a scene file, got neither")
    job = RenderJob(
        target=target_pattern(output, gbuffer.name),
        force=sequence.force,
        model=model,
        gbuffer=gbuffer,
        reading=exr.reading if camera is None else replace(exr.reading, camera=camera),
        lighting=replace(around.lighting, lamps=tuple(lights_of(light))),
        display=display.display,
        tolerance=exr.tolerance,
        shadowed=exr.shadowed,
        illuminant=spectrum.illuminant,
        white=spectrum.white,
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
