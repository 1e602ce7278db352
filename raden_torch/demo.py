"""`raden demo`: the main job on the built-in simulated shell, and a page that shows it."""

from __future__ import annotations

import html
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar, cast

import torch
from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn
from torch import Tensor

from raden_torch.artwork.lacquer import Lacquer
from raden_torch.artwork.plate import plate
from raden_torch.brdf.files.image_file import Photograph, write_photograph
from raden_torch.brdf.files.model_file import save_model
from raden_torch.brdf.fitting.fit import FitResult, fit
from raden_torch.brdf.fitting.score import score
from raden_torch.brdf.shading.lights import DirectionalLight
from raden_torch.brdf.shading.relight import lamp_ring
from raden_torch.brdf.shading.shade import shade
from raden_torch.errors import InputError
from raden_torch.export.check import ExportReport
from raden_torch.export.export import export_onnx
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement
from raden_torch.optics import simulate_specimen
from raden_torch.pictures import render_shape, save_picture
from raden_torch.plots import draw, save_plot
from raden_torch.relighting import relight_files
from raden_torch.scene.animation import render_moving
from raden_torch.scene.scene import Scene
from raden_torch.scene.scene_file import (
    AnimationTable,
    CameraTable,
    DirectionalTable,
    DisplayTable,
    EnvironmentTable,
    LightsTable,
    MaterialTable,
    ObjectTable,
    PictureTable,
    SceneTable,
)

Result = TypeVar("Result")

SPECIMEN = "yakogai"
_KEY_LIGHT = DirectionalLight((-1.0, 1.2, 2.0))
_STRIP_DEG = (-60, -36, -12, 12, 36, 60)
_OFF_GRID_READINGS = 2000
_TURNING_FRAMES = 12


@dataclass(frozen=True)
class Figure:
    """One picture of the gallery: its file and what it shows."""

    file: str
    title: str
    text: str


def run_demo(out: Path, *, size: int = 512, console: Console | None = None) -> Path:
    """Simulate, fit, light, and write the gallery.

    Args:
        out: the folder; it is made where missing. Files of an earlier run are replaced.
        size: width and height of the large picture in pixels.
        console: where its steps are shown; stderr unless given.

    Returns:
        The path of `index.html`.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder for the gallery, got a file")
    out.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    columns = (TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console or Console(stderr=True)) as progress:
        step = partial(_step, progress)
        measurement = step("simulating the shell", lambda: simulate_specimen(SPECIMEN))
        measurement.save(out / "shell.csv")
        result = step("fitting the model", lambda: fit(measurement))
        save_model(result.model, out / "shell.safetensors")
        off_grid = step("scoring it off the grid", lambda: _score_off_grid(result))
        figures = [
            *step("rendering a scene", lambda: _scene(out, size)),
            step("lighting the sphere", lambda: _sphere(result, out, size)),
            step("moving the lamp", lambda: _lamp_strip(result, out, size // 2)),
            step("setting the shell in lacquer", lambda: _plate(result, out, size)),
            step("relighting a photograph", lambda: _relit(result, out, size // 2)),
            step("drawing the graphs", lambda: _graphs(measurement, out)),
        ]
        exported = step("exporting to ONNX", lambda: export_onnx(result.model, out / "shell.onnx"))
    seconds = time.perf_counter() - started
    page = out / "index.html"
    with written_beside(page) as temporary:
        temporary.write_text(
            _page(measurement, result, off_grid, exported, figures, seconds), "utf-8"
        )
    return page


def _step(progress: Progress, what: str, work: Callable[[], Result]) -> Result:
    """Do one piece of work under a line of its own."""
    task = progress.add_task(what, total=1)
    done = work()
    progress.update(task, completed=1)
    return done


def _score_off_grid(result: FitResult) -> str:
    """The simulation can be asked between the nodes of its own grid."""
    generator = torch.Generator().manual_seed(0)
    u = torch.rand(_OFF_GRID_READINGS, 3, generator=generator, dtype=torch.float64).numpy()
    geometries = u * [70.0, 140.0, 140.0] - [0.0, 70.0, 70.0]
    return str(score(result.model, simulate_specimen(SPECIMEN, geometries_deg=geometries)))


def _scene(out: Path, size: int) -> list[Figure]:
    """A box in a room, still and turning."""
    table = SceneTable(
        picture=PictureTable(size=(5 * size // 4, 5 * size // 4 * 9 // 16)),
        camera=CameraTable(position=(1.5, 3.3, 5.8), target=(0.06, 0.24, 0.0), fov_deg=35.0),
        object=ObjectTable(
            artwork="makie", swing_deg=22.0, table=(0.14, 0.133, 0.125), table_roughness=0.02
        ),
        # one thickness each: to bake a shell takes seconds
        materials=[
            MaterialTable(name=name, shell=name, tablets=[1.0]) for name in ("yakogai", "mexican")
        ],
        lights=LightsTable(
            environment=EnvironmentTable(builtin="room"),
            directional=[
                DirectionalTable(direction=(-0.15, 0.6, 1.0), irradiance=(0.8, 0.78, 0.75))
            ],
        ),
        display=DisplayTable(exposure=0.3),
        animation=AnimationTable(frames=_TURNING_FRAMES, fps=9.0),
    )
    scene = Scene(table, out)
    scene.display.write(scene.frame(), out / "box.png", scene.caption)
    small = scene.resized((size // 2, size // 2 * 9 // 16))
    frames = range(1, _TURNING_FRAMES + 1)
    render_moving(small, frames, out / "box_turning.webp", scene.display)
    text = "Black urushi, gold powder and raden of four simulated shells by a paper window"
    return [
        Figure("box.png", "A maki-e box", f"{text}: raden render scene.toml, docs/scenes.md."),
        Figure("box_turning.webp", "The same, turning", "Colours travel over the pieces."),
    ]


def _sphere(result: FitResult, out: Path, size: int) -> Figure:
    image = render_shape(result.model, "sphere", [_KEY_LIGHT], size=size, samples=3)
    save_picture(image, out / "sphere.png", result.model)
    return Figure(
        "sphere.png",
        "A sphere (the paper's fig. 10)",
        "One lamp above the camera's left shoulder. The colour of the highlight's rim travels with "
        "the angle between lamp and eye.",
    )


def _lamp_strip(result: FitResult, out: Path, size: int) -> Figure:
    images = []
    for angle in _STRIP_DEG:
        a = torch.deg2rad(torch.tensor(float(angle)))
        lamp = DirectionalLight((float(a.sin()), 0.3, float(a.cos())))
        images.append(render_shape(result.model, "sphere", [lamp], size=size, samples=2))
    save_picture(torch.cat(images, dim=-1), out / "lamps.png", result.model)
    return Figure(
        "lamps.png",
        "Six lamps",
        f"The lamp goes round the sphere, from {_STRIP_DEG[0]} to {_STRIP_DEG[-1]} degrees; "
        "one exposure for all.",
    )


def _plate(result: FitResult, out: Path, size: int) -> Figure:
    image = render_shape(result.model, "plate", size=size * 5 // 4, samples=2)
    save_picture(image, out / "plate.png", result.model)
    return Figure(
        "plate.png",
        "Raden in black urushi (the paper's fig. 11)",
        "Every piece of shell leans a little otherwise, as cut shell does, and takes another "
        "colour. Two small lamps; the lacquer has its own gloss.",
    )


def _relit(result: FitResult, out: Path, size: int) -> Figure:
    """The inputs of `raden relight` as files (a simulated photograph), and what becomes of them."""
    plain = plate(size, (0.0, 0.0, 6.0), samples=1)
    lamp = [DirectionalLight((-1.0, 1.0, 1.5))]
    bone = shade(Lacquer(base=(0.55, 0.52, 0.45)), plain.shell, lamp)
    photo = Photograph((bone + shade(Lacquer(), plain.lacquer, lamp)).clamp(0, 1), 255)
    write_photograph(photo, out / "simulated_photograph.png")
    mask = cast(Tensor, plain.shell.mask).expand(1, 3, -1, -1)
    write_photograph(Photograph(mask, 255), out / "mask.png", coded="linear")
    normals = (plain.shell.normal + 1) / 2
    write_photograph(Photograph(normals, 65535), out / "normals.png", coded="linear")
    relight_files(
        [out / "simulated_photograph.png"],
        out / "normals.png",
        out / "mask.png",
        out / "shell.safetensors",
        out / "relit.png",
        lamp_ring(6, 65.0),
        layout="strip",
    )
    return Figure(
        "relit.png",
        "A photograph relit",
        "A simulated photograph of a plate with bone inlay becomes raden under six lamps around "
        "it: raden relight simulated_photograph.png --normals normals.png --mask mask.png "
        "--model shell.safetensors --strip 6 --elevation 65 -o relit.png",
    )


def _graphs(measurement: BrdfMeasurement, out: Path) -> Figure:
    save_plot(draw(measurement), out / "graphs.png")
    return Figure(
        "graphs.png",
        "The paper's figs. 5 to 9, and the path of the colour",
        "The mirror ridge, the diffuse part and its fit, the two peaks along the tilt, and how the "
        "colour travels with the angle.",
    )


def _page(
    measurement: BrdfMeasurement,
    result: FitResult,
    off_grid: str,
    exported: ExportReport,
    figures: list[Figure],
    seconds: float,
) -> str:
    sections = "\n".join(
        f"<figure><img src='{html.escape(f.file)}' alt='{html.escape(f.title)}'>"
        f"<figcaption><b>{html.escape(f.title)}.</b> {html.escape(f.text)}</figcaption></figure>"
        for f in figures
    )
    facts = html.escape(
        f"{measurement!r}\n{result.report}\noff the grid: {off_grid}\nONNX file: {exported}"
    )
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>raden_torch: a simulated shell</title>
<meta name="viewport" content="width=device-width">
<style>
body {{ background: #14110f; color: #ddd6cc; font: 16px/1.5 system-ui, sans-serif;
       max-width: 64rem; margin: 2rem auto; padding: 0 1rem }}
img {{ max-width: 100%; height: auto; border-radius: 4px }}
figure {{ margin: 2rem 0 }} figcaption {{ color: #a89f92 }}
pre {{ background: #1f1a17; padding: 1rem; overflow-x: auto; font-size: 13px }}
</style>
<h1>A simulated shell, measured, fitted and lit</h1>
<p>Everything here is made from a <b>simulated</b> specimen ({html.escape(SPECIMEN)}): film optics,
not a measurement. Fitted model: <a href="shell.safetensors">shell.safetensors</a>; its readings:
<a href="shell.csv">shell.csv</a>; the shader for other programs:
<a href="shell.onnx">shell.onnx</a>. Made in {seconds:.0f} s.</p>
{sections}
<h2>The fit</h2>
<pre>{facts}</pre>
</html>
"""
