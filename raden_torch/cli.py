"""The `raden` command: one thin function a subcommand; the work is done in the library."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raden_torch.errors import InputError
from raden_torch.files import check_writable

if TYPE_CHECKING:
    from raden_torch.brdf.lights import Light
    from raden_torch.brdf.model import RadenBrdf
    from raden_torch.measurement import BrdfMeasurement

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Measure how mother-of-pearl reflects, keep it as a small model, light images with it.",
)


class Green(str, Enum):
    """Which way green points in a normal map."""

    opengl = "opengl"
    directx = "directx"


ModelFile = Annotated[Path, typer.Argument(help="a model that `raden fit` wrote")]


def main() -> None:
    """Run the command; anything wrong with the input is one line on stderr and exit code 2."""
    warnings.showwarning = _print_warning
    try:
        app()
    except InputError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}")
    except MemoryError:
        _fail("not enough memory; use a smaller --size")


@app.command(epilog="Example: raden fit shell.csv -o shell.safetensors")
def fit(
    measurement: Annotated[Path, typer.Argument(help="a measurement file; its format is found")],
    output: Annotated[Path, typer.Option("--output", "-o", help="the model file to write")],
    diffuse_scale: Annotated[
        str | None, typer.Option(help="S per channel in 1/sr, by hand, as 0.1,0.1,0.1")
    ] = None,
    diffuse_exponent: Annotated[
        str | None, typer.Option(help="n per channel, by hand, as 1,1,1")
    ] = None,
    interpolation: Annotated[
        str,
        typer.Option(help="between nodes: auto, trilinear (the paper), log, ridge, cubic, lobes"),
    ] = "auto",
    validation: Annotated[
        Path | None, typer.Option(help="readings off the grid to choose the interpolation by")
    ] = None,
) -> None:
    """Fit a model to a measurement and report how well."""
    from raden_torch.capture.importers import load_measurement

    check_writable(output)
    if (diffuse_scale is None) != (diffuse_exponent is None):
        raise InputError("--diffuse-scale and --diffuse-exponent go together; give both or neither")
    with _working(f"reading {measurement.name}"):
        loaded = load_measurement(measurement)
        off_grid = None if validation is None else load_measurement(validation)
    with _working("fitting"):
        from raden_torch.brdf.diffuse_fit import DiffuseParameters
        from raden_torch.brdf.fit import fit as fit_model
        from raden_torch.brdf.model_file import save_model

        by_hand = None
        if diffuse_scale is not None and diffuse_exponent is not None:
            by_hand = DiffuseParameters(
                _triple("--diffuse-scale", diffuse_scale),
                _triple("--diffuse-exponent", diffuse_exponent),
            )
        result = fit_model(
            loaded, diffuse=by_hand, interpolation=interpolation, validation=off_grid
        )
        save_model(result.model, output)
    print(f"{loaded!r}\n{result.report}\nwrote {output}")


@app.command(epilog="Example: raden info shell.safetensors --against offgrid.csv")
def info(
    file: Annotated[Path | None, typer.Argument(help="a measurement or a model")] = None,
    against: Annotated[
        Path | None, typer.Option(help="readings to score a model on, e.g. off its grid")
    ] = None,
    system: Annotated[
        bool, typer.Option("--system", help="instead: which form of the model runs here")
    ] = False,
) -> None:
    """Say what a file holds; score a model on readings that it was not fitted to."""
    if system == (file is not None):
        raise InputError("info: give a FILE, or --system")
    if file is None:
        from raden_torch.brdf.kernel import system_report

        print(system_report())
        return

    from raden_torch.describe import describe_measurement, describe_model
    from raden_torch.measurement import BrdfMeasurement

    with _working(f"reading {file.name}"):
        loaded = _load(file)
        if isinstance(loaded, BrdfMeasurement):
            if against is not None:
                raise InputError(f"{file}: is a measurement; --against scores a model")
            text = describe_measurement(loaded)
        else:
            text = describe_model(loaded)
            if against is not None:
                from raden_torch.brdf.score import score
                from raden_torch.capture.importers import load_measurement

                text += f"\nagainst {against.name}: {score(loaded, load_measurement(against))}"
    print(text)


@app.command(epilog="Example: raden plot shell.csv -o graphs.png --figure 5 --figure 9")
def plot(
    file: Annotated[Path, typer.Argument(help="a measurement or a model")],
    output: Annotated[Path, typer.Option("--output", "-o", help=".png, .svg or .pdf")],
    figure: Annotated[
        list[str] | None, typer.Option(help="5, 6, 7, 8, 9 or path; may be repeated; else all")
    ] = None,
    incidence: Annotated[float, typer.Option(help="held in figs 5, 6 and 9, degrees")] = 20.0,
    tilt: Annotated[float, typer.Option(help="held in fig. 5, degrees")] = 10.0,
    surface_tilt: Annotated[float, typer.Option(help="held in figs 7 and 8, degrees")] = 55.0,
) -> None:
    """Draw the paper's graphs of a measurement or a model."""
    from raden_torch.plots import FIGURES, check_plot_path, draw, save_plot

    check_plot_path(output)
    with _working(f"drawing {file.name}"):
        sheet = draw(
            _load(file),
            figure or FIGURES,
            incidence_deg=incidence,
            tilt_deg=tilt,
            surface_tilt_deg=surface_tilt,
        )
        save_plot(sheet, output)
    print(f"wrote {output}")


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
    exposure: Annotated[str, typer.Option(help="stops, or auto")] = "auto",
    gbuffer: Annotated[
        Path | None, typer.Option(help="an EXR with normals or depth to light, instead of a shape")
    ] = None,
    channel: Annotated[
        list[str] | None, typer.Option(help="of the EXR, as normal=N or depth=Z; may be repeated")
    ] = None,
    fov: Annotated[
        float | None, typer.Option(help="horizontal field of view of the EXR's camera, degrees")
    ] = None,
    smooth: Annotated[float, typer.Option(help="smooth the EXR's depth by so many pixels")] = 0.0,
) -> None:
    """Light a shape, or an EXR G-buffer, with a model."""
    from raden_torch.brdf.display import PICTURE_SUFFIXES, check_picture_path
    from raden_torch.pictures import render_gbuffer, render_shape, save_picture

    check_picture_path(output, (*PICTURE_SUFFIXES, ".exr"))
    lights = [_light(text) for text in light or ()]
    eye = None if camera is None else _triple("--camera", camera)
    stops = _stops(exposure)
    with _working("rendering"):
        from raden_torch.brdf.model_file import load_model

        loaded = load_model(model)
        if gbuffer is None:
            image = render_shape(loaded, shape, lights, camera=eye, size=size, samples=samples)
        else:
            named = dict(_pair("--channel", text) for text in channel or ())
            image = render_gbuffer(
                loaded, gbuffer, lights, channels=named, fov_deg=fov, smooth_px=smooth
            )
        used = save_picture(image, output, loaded, exposure_ev=stops)
    print(f"wrote {output} (exposure {used:+.2f} stops)")


@app.command(
    epilog="Example: raden relight box.png --normals n.png --mask m.png --model shell.safetensors "
    "--light 1,1,2 -o relit.png"
)
def relight(
    photos: Annotated[list[Path], typer.Argument(help="photographs of one size, or one")],
    normals: Annotated[
        Path, typer.Option(help="normal map: PNG (8 or 16 bits), TIFF; EXR, also with depth")
    ],
    model: Annotated[Path, typer.Option(help="a model that `raden fit` wrote")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="the image to write; a folder for several")
    ],
    mask: Annotated[
        Path | None, typer.Option(help="what to relight, with a soft edge; else all normals")
    ] = None,
    light: Annotated[
        list[str] | None, typer.Option(help="x,y,z towards a lamp at infinity; may be repeated")
    ] = None,
    strip: Annotated[
        int | None, typer.Option(help="instead: this many lamps in a ring, side by side")
    ] = None,
    fov: Annotated[
        float | None, typer.Option(help="of an EXR with depth instead of normals, degrees")
    ] = None,
    elevation: Annotated[
        float, typer.Option(help="of the ring of lamps above the picture, degrees")
    ] = 40.0,
    green: Annotated[
        Green, typer.Option(help="which way green points in the normal map")
    ] = Green.opengl,
    exposure: Annotated[
        str, typer.Option(help="stops, or auto: the masked part keeps its mean luminance")
    ] = "auto",
) -> None:
    """Relight the masked part of photographs; the rest of them is kept."""
    from raden_torch.pictures import relight_files

    if strip is not None and light:
        raise InputError("--strip brings its own lamps; give --light or --strip")
    with _working("relighting"):
        written = relight_files(
            photos,
            normals,
            mask,
            model,
            output,
            lights=[_light(text) for text in light or ["1,1,2"]],
            strip=strip,
            elevation_deg=elevation,
            fov_deg=fov,
            green=green.value,
            exposure_ev=_stops(exposure),
        )
    for path in written:
        print(f"wrote {path}")


@app.command(epilog="Example: raden bench --out bench")
def bench(
    out: Annotated[Path, typer.Option(help="the folder for bench.json and the plot")] = Path(
        "bench"
    ),
    measurement: Annotated[
        Path | None, typer.Option(help="a grid; else the simulated shell; with --readings")
    ] = None,
    readings: Annotated[Path | None, typer.Option(help="readings off that grid")] = None,
    height: Annotated[int, typer.Option(help="of the timed frame, which is 16:9")] = 720,
) -> None:
    """Run time against error, of every interpolator and backend."""
    from raden_torch.bench import run_bench
    from raden_torch.capture.importers import load_measurement

    if (measurement is None) != (readings is None):
        raise InputError("--measurement and --readings go together; give both or neither")
    if not 16 <= height <= 8192:
        raise InputError(f"--height {height}: 16…8192 was wanted")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; name a folder")
    grid = None if measurement is None else load_measurement(measurement)
    off_grid = None if readings is None else load_measurement(readings)
    plot_path = run_bench(out, grid, off_grid, frame=(height, height * 16 // 9))
    print(f"wrote {plot_path.with_name('bench.json')}\nwrote {plot_path}")


@app.command(epilog="Example: raden export shell.safetensors -o shell.onnx --profile scene")
def export(
    model: ModelFile,
    output: Annotated[Path, typer.Option("--output", "-o", help="the .onnx file to write")],
    profile: Annotated[
        str, typer.Option(help="gbuffer (normal, light, view) or scene (with camera and lights)")
    ] = "gbuffer",
    quantity: Annotated[
        str, typer.Option("--quantity", help="radiance, or brdf (f_r in 1/sr, gbuffer only)")
    ] = "radiance",
    opset: Annotated[int, typer.Option(help="of the ONNX operators")] = 18,
) -> None:
    """Write a model as an ONNX shader for other programs, checked in ONNX Runtime."""
    from raden_torch.brdf.model_file import load_model
    from raden_torch.export.export import export_onnx

    with _working("exporting"):
        report = export_onnx(
            load_model(model), output, profile=profile, output=quantity, opset=opset
        )
    print(f"{report}\nwrote {output}")


@app.command(epilog="Example: raden verify shell.onnx")
def verify(
    file: Annotated[Path, typer.Argument(help="a file that `raden export` wrote")],
) -> None:
    """Check an exported shader in every runtime on this machine."""
    from raden_torch.export.export import verify_onnx

    with _working(f"verifying {file.name}"):
        report = verify_onnx(file)
    print(report)


@app.command(epilog="Example: raden demo --out demo")
def demo(
    out: Annotated[Path, typer.Option(help="the folder for the gallery")] = Path("demo"),
    size: Annotated[int, typer.Option(help="picture size in pixels")] = 512,
) -> None:
    """Simulate a shell, fit a model to it, light it, and show all of it on a page."""
    from raden_torch.demo import run_demo

    page = run_demo(out, size=size)
    print(f"open {page}")


def _load(path: Path) -> BrdfMeasurement | RadenBrdf:
    """A model or a measurement, whichever the file is."""
    try:
        with path.open("rb") as file:
            head = file.read(9)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; a measurement or a model was wanted") from None
    if head[8:9] == b"{":  # safetensors: the length of a JSON header, then the header
        from raden_torch.brdf.model_file import load_model

        return load_model(path)
    from raden_torch.capture.importers import load_measurement

    return load_measurement(path)


def _light(text: str) -> Light:
    from raden_torch.brdf.lights import DirectionalLight, PointLight

    kind, colon, numbers = text.rpartition(":")
    if colon and kind != "point":
        raise InputError(f"--light {text}: x,y,z or point:x,y,z was wanted")
    triple = _triple("--light", numbers)
    return PointLight(triple) if kind else DirectionalLight(triple)


def _triple(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{option} {text}: three numbers as 1,1,2 were wanted") from None
    return x, y, z


def _pair(option: str, text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise InputError(f"{option} {text}: name=value, as normal=N, was wanted")
    return name, value


def _stops(text: str) -> float | None:
    if text == "auto":
        return None
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--exposure {text}: a number of stops, or auto, was wanted") from None


@contextmanager
def _working(what: str) -> Iterator[None]:
    """A spinner on stderr where a person looks on."""
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"raden: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _fail(message: str) -> None:
    print(f"raden: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


if __name__ == "__main__":
    main()
