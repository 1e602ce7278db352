"""Pictures: render, relight, demo."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from raden_torch.cli.common import (
    ModelFile,
    app,
    bytes_of,
    light_of,
    pair,
    progress,
    stops_of,
    triple,
    without_other_inputs,
    working,
)
from raden_torch.errors import InputError
from raden_torch.files import check_output
from raden_torch.packages import require

Depth = Annotated[
    str | None,
    typer.Option(
        help="what the depth of the EXR is: planar (along the camera's axis), distance (along the "
        "pixel's ray), negative (z of a camera that looks along −z), or by renderer: blender, "
        "karma, mitsuba; planar unless stated"
    ),
]

NormalXyz = Annotated[
    str,
    typer.Option(
        help="the normals' channels that hold x,y,z (right, up, to the viewer), with a minus where "
        "one points the other way: b,g,r or =r,-g,-b"
    ),
]


class Green(str, Enum):
    """Which way green points in a normal map."""

    opengl = "opengl"
    directx = "directx"


@app.command(epilog="Example: raden render shell.safetensors --light 1,1,2 -o sphere.png")
def render(
    model: ModelFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="the .png, .jpg or (linear) .exr to write")
    ] = Path("render.png"),
    shape: Annotated[
        str, typer.Option(help="what to show: sphere, or plate (black urushi with a motif)")
    ] = "sphere",
    light: Annotated[
        list[str] | None,
        typer.Option(help="x,y,z towards a lamp at infinity, or point:x,y,z; may be repeated"),
    ] = None,
    camera: Annotated[str | None, typer.Option(help="the camera's position x,y,z; y is up")] = None,
    size: Annotated[int, typer.Option(help="width and height in pixels")] = 512,
    samples: Annotated[int, typer.Option(help="rays per pixel along each side")] = 2,
    exposure: Annotated[str, typer.Option(help="exposure in stops, or auto")] = "auto",
    gbuffer: Annotated[
        Path | None, typer.Option(help="an EXR with normals or depth to light, instead of a shape")
    ] = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(help="channels of the EXR, as normal=N or depth=Z; may be repeated"),
    ] = None,
    fov: Annotated[
        float | None, typer.Option(help="horizontal field of view of the EXR's camera, degrees")
    ] = None,
    smooth: Annotated[
        float, typer.Option(help="smooth the EXR's depth over this many pixels")
    ] = 0.0,
    depth: Depth = None,
    normal_xyz: NormalXyz = "r,g,b",
    tolerance: Annotated[
        float,
        typer.Option(
            help="for an EXR: the largest error of a pixel's radiance that is accepted to save time"
        ),
    ] = 0.0,
    memory: Annotated[
        str,
        typer.Option(help="for an EXR lit into an .exr: shade it in bands within this much memory"),
    ] = "4G",
) -> None:
    """Light a shape, or an EXR G-buffer, with a model."""
    from raden_torch.brdf.files.display import PICTURE_SUFFIXES, check_picture_path
    from raden_torch.brdf.files.gbuffer_reading import GBufferReading
    from raden_torch.pictures import (
        render_gbuffer,
        render_gbuffer_file,
        render_shape,
        save_picture,
    )

    check_picture_path(output, (*PICTURE_SUFFIXES, ".exr"))
    check_output(output, inputs=(model, gbuffer))
    lights = [light_of(text) for text in light or ()]
    eye = None if camera is None else triple("--camera", camera)
    stops, limit = stops_of(exposure), bytes_of(memory)
    reading = GBufferReading(
        channels=dict(pair("--channel", text) for text in channel or ()),
        fov_deg=fov,
        smooth_px=smooth,
        depth=depth,
        xyz=normal_xyz,
    )
    if gbuffer is not None and output.suffix.lower() == ".exr":
        from raden_torch.brdf.files.model_file import load_model

        with progress("rendering") as shown:
            used = render_gbuffer_file(
                load_model(model),
                gbuffer,
                output,
                lights,
                reading,
                exposure_ev=stops,
                tolerance=tolerance,
                memory=limit,
                shown=shown,
            )
        print(f"wrote {output} (exposure {used:+.2f} stops)")
        return
    with working("rendering"):
        from raden_torch.brdf.files.model_file import load_model

        loaded = load_model(model)
        if gbuffer is None:
            image = render_shape(loaded, shape, lights, camera=eye, size=size, samples=samples)
        else:
            image = render_gbuffer(loaded, gbuffer, lights, reading, tolerance=tolerance)
        used = save_picture(image, output, loaded, exposure_ev=stops)
    print(f"wrote {output} (exposure {used:+.2f} stops)")


@app.command(
    epilog="Example: raden relight box.png --normals n.png --mask m.png --model shell.safetensors "
    "--light 1,1,2 -o relit.png"
)
def relight(
    photos: Annotated[list[Path], typer.Argument(help="one or more photographs of one size")],
    normals: Annotated[
        Path, typer.Option(help="normal map: PNG (8 or 16 bits), TIFF; EXR, also with depth")
    ],
    model: Annotated[Path, typer.Option(help="a model that `raden fit` wrote")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="the image to write; a folder for several")
    ],
    mask: Annotated[
        Path | None,
        typer.Option(
            help="mask of what to relight, with a soft edge; by default wherever there are normals"
        ),
    ] = None,
    light: Annotated[
        list[str] | None, typer.Option(help="x,y,z towards a lamp at infinity; may be repeated")
    ] = None,
    strip: Annotated[
        int | None, typer.Option(help="instead of --light: this many lamps in a ring, side by side")
    ] = None,
    sheet: Annotated[
        int | None,
        typer.Option(help="instead of --light: this many lamps in a ring, as a contact sheet"),
    ] = None,
    original_light: Annotated[
        str | None,
        typer.Option(
            help="keep the photograph's texture: the lamp it was taken under, as x,y,z, or the "
            "normals.json of `raden capture normals`"
        ),
    ] = None,
    linear: Annotated[
        bool, typer.Option("--linear", help="read whole numbers in the photographs as linear light")
    ] = False,
    fov: Annotated[
        float | None,
        typer.Option(help="field of view of an EXR with depth instead of normals, degrees"),
    ] = None,
    depth: Depth = None,
    normal_xyz: NormalXyz = "r,g,b",
    elevation: Annotated[
        float, typer.Option(help="elevation of the ring of lamps above the image plane, degrees")
    ] = 40.0,
    green: Annotated[
        Green, typer.Option(help="which way green points in the normal map")
    ] = Green.opengl,
    exposure: Annotated[
        str,
        typer.Option(help="exposure in stops, or auto: the masked part keeps its mean luminance"),
    ] = "auto",
) -> None:
    """Relight the masked part of photographs; the rest of them is kept."""
    from raden_torch.brdf.files.gbuffer_reading import GBufferReading
    from raden_torch.brdf.shading.relight import lamp_ring
    from raden_torch.pictures import relight_files

    if sum((strip is not None, sheet is not None, bool(light))) > 1:
        raise InputError("--strip and --sheet bring their own lamps; give one of them or --light")
    original = None
    if original_light is not None:
        is_file = original_light.endswith(".json")
        original = Path(original_light) if is_file else triple("--original-light", original_light)
    photos = without_other_inputs(photos, normals, mask, model)
    count = strip or sheet
    lamps = [light_of(text) for text in light or ["1,1,2"]]
    with working("relighting"):
        written = relight_files(
            photos,
            normals,
            mask,
            model,
            output,
            lamps if count is None else lamp_ring(count, elevation),
            layout="strip" if strip else "sheet" if sheet else "picture",
            original=original,
            coded="linear" if linear else "srgb",
            reading=GBufferReading(fov_deg=fov, depth=depth, xyz=normal_xyz),
            green=green.value,
            exposure_ev=stops_of(exposure),
        )
    for path in written:
        print(f"wrote {path}")


@app.command(epilog="Example: raden demo --out demo")
def demo(
    out: Annotated[Path, typer.Option(help="the folder for the gallery")] = Path("demo"),
    size: Annotated[int, typer.Option(help="image size in pixels")] = 512,
) -> None:
    """Simulate a shell, fit a model to it, light it, and show all of it on a page."""
    require("the demo's pictures", "images", "plots", "export")
    from raden_torch.demo import run_demo

    page = run_demo(out, size=size)
    print(f"open {page}")
