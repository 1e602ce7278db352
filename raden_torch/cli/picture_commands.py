"""Pictures: render, relight, demo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

from cyclopts import Parameter

from raden_torch.cli.option_types import (
    LampOption,
    LampOrFile,
    Lamps,
    ModelFile,
    RenderedModel,
    Triple,
    files,
    output,
)
from raden_torch.cli.picture_options import (
    DisplayOptions,
    EnvironmentOptions,
    ExrOptions,
    GBufferOptions,
    RelitDisplayOptions,
    SceneOptions,
    SpectrumOptions,
)
from raden_torch.cli.status import console, progress, without_other_inputs, working
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
    scene: SceneOptions = SceneOptions(),
    std: Annotated[
        Path | None,
        Parameter(
            help="also write the picture's standard deviations, of a model of `raden fit --std`: "
            "a map in percent (.png, .svg or .pdf), or linear layers own and systematic (.exr)"
        ),
    ] = None,
) -> None:
    if model.suffix.lower() == ".toml":
        own = (light, around, spectrum, gbuffer, exr, shape.shape, shape.camera, std)
        _render_scene(model, output, display, shape, scene, is_plain=own == _NO_SCENE_OF_ITS_OWN)
        return
    if scene != SceneOptions():
        raise InputError(f"{model}: `frames` and `resume` go with a scene file (.toml)")
    from raden_torch.pictures import load_material, save_picture

    shown_by = display.display
    shown_by.check_path(output)
    read = (model, gbuffer, around.environment, exr.material, exr.camera_file, *spectrum.files)
    check_output(output, inputs=read)
    lights = [*_lights(light), *around.lights()]
    if gbuffer is None:
        exr.check_without_gbuffer()
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
            size, samples = shape.size or 512, shape.samples or 2
            image, std = sphere_with_std(
                model, lights, camera=shape.camera, size=size, samples=samples
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


def _render_scene(
    path: Path,
    output: Path,
    display: DisplayOptions,
    shape: ShapeOptions,
    asked: SceneOptions,
    *,
    is_plain: bool,
) -> None:
    if not is_plain:
        raise InputError(
            f"{path}: a scene has its own lights, camera and surfaces; beside it come "
            "`output`, `size`, `samples`, `frames`, `resume` and the options of the picture"
        )
    from raden_torch.scene.animation import render_frames
    from raden_torch.scene.scene import Scene

    scene = Scene.read(path, width=shape.size, samples=shape.samples)
    shown_by = display.over(scene.display)
    if asked.frames is not None:
        with progress("rendering") as shown:
            count = render_frames(
                scene, asked.frames, output, shown_by, resume=asked.resume, shown=shown
            )
        print(f"wrote {output} ({count} of {len(asked.frames)} frames rendered)")
        return
    if asked.resume:
        raise InputError("`resume` goes with `frames`")
    shown_by.check_path(output)
    check_output(output, inputs=(path, *scene.files))
    with working("rendering"):
        stops = shown_by.write(scene.frame(), output, scene.caption)
    print(f"wrote {output} (exposure {stops:+.2f} stops)")


def _lights(lamps: Sequence[LampOption]) -> list[Light]:
    return [lamp.light for lamp in lamps]


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
    green: Literal["opengl", "directx"] = "opengl"
    """which way green points in the normal map"""

    def __post_init__(self) -> None:
        if sum((self.strip is not None, self.sheet is not None, bool(self.light))) > 1:
            raise InputError(
                "--strip and --sheet bring their own lamps; give one of them or --light"
            )

    def lamps(self) -> Sequence[Light]:
        """The lamps of one picture, or of the ring."""
        from raden_torch.brdf.shading.relight import lamp_ring

        count = self.strip if self.strip is not None else self.sheet
        if count is None:
            return _lights(self.light or [LampOption((1.0, 1.0, 2.0))])
        return lamp_ring(count, self.elevation_deg)


def relight(
    *photos: Annotated[Path, files("one or more photographs of one size")],
    output: Annotated[Path, output("the image to write; a folder for several")],
    how: RelightOptions,
    around: EnvironmentOptions = EnvironmentOptions(),
    display: RelitDisplayOptions = RelitDisplayOptions(),
    exr: ExrOptions = ExrOptions(),
) -> None:
    from raden_torch.relighting import relight_files

    surrounded = around.environment is not None or around.light_setup is not None
    if surrounded and (how.strip or how.sheet):
        raise InputError(
            "--strip and --sheet show one lamp each; leave out --environment and --light-setup"
        )
    used = without_other_inputs(
        photos, how.normals, how.mask, how.model, around.environment, exr.material
    )
    surroundings = around.lights()
    lights = [*(_lights(how.light) if surroundings else how.lamps()), *surroundings]
    with working("relighting"):
        written = relight_files(
            used,
            how.normals,
            how.mask,
            how.model,
            output,
            lights,
            layout="strip" if how.strip else "sheet" if how.sheet else "picture",
            original=how.original_light,
            coded="linear" if how.linear else "srgb",
            green=how.green,
            reading=exr.reading,
            display=display.display,
        )
    for path in written:
        print(f"wrote {path}")


def demo(
    *,
    out: Annotated[Path, Parameter(help="the folder for the gallery")] = Path("demo"),
    size: Annotated[int, Parameter(help="image size in pixels")] = 512,
) -> None:
    require("the demo's pictures", "images", "plots", "export")
    from raden_torch.demo import run_demo

    page = run_demo(out, size=size, console=console())
    print(f"open {page}")
