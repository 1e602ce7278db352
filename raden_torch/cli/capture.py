"""From photographs: calibrate, colour."""

from __future__ import annotations

import typer

from raden_torch.cli.common import app

capture = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="From photographs: the camera, its colour, the light and the normals.",
)
app.add_typer(capture, name="capture")


@capture.callback()
def steps() -> None:
    """From photographs: the camera, its colour, the light and the normals."""
