"""`convert`: a measurement or a model in another program's format.

A list of readings is written as it was read. A format with a grid of directions takes the readings
that lie on it; elsewhere it takes what `fit` makes of them: interpolated within the measured
angles, continued beyond. What the other format has no room for is said in one line.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.brdf.fitting.fit import fit
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.capture.exchange import (
    astm_e1392,
    fred,
    lighttools_bsdf,
    merl,
    speos_bsdf,
    zemax_bsdf,
)
from raden_torch.capture.exchange.colours import channels_for, in_colours_of, of_model
from raden_torch.capture.exchange.formats import FORMATS, Format, format_of
from raden_torch.capture.exchange.polar import by_directions
from raden_torch.capture.exchange.scatter_grid import About, ScatterGrid
from raden_torch.capture.exchange.text import check_values
from raden_torch.conversion.evaluation import f_r_at, in_box
from raden_torch.conversion.grid_values import (
    BY_CELLS,
    GridValues,
    in_channels,
    of_cells,
    of_fit,
    of_fitted_model,
    of_readings,
)
from raden_torch.conversion.options import Conversion, Options
from raden_torch.errors import InputError, check_type
from raden_torch.files import check_output
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR
from raden_torch.reflectance.grid import AngleGrid

STEP_DEG = 5.0
"""Of a grid, where nothing else is asked for."""
USUAL = Options()
_HIGHEST_DEG = 85.0
_MOST_CHANNELS = 3
_GRIDS = {"zemax": zemax_bsdf.write, "lighttools": lighttools_bsdf.write, "speos": speos_bsdf.write}


def convert(
    source: BrdfMeasurement | RadenBrdf,
    path: str | os.PathLike[str],
    options: Options = USUAL,
) -> Conversion:
    """Write a measurement, or a model over the whole hemisphere, in another format.

    Returns:
        What was written, and what was lost.

    Raises:
        InputError: a format that is not known or not told; several sample azimuths for an
            isotropic format; a grid too large; readings that cannot be fitted; a place that cannot
            be written.

    Examples:
        >>> import raden_torch as rt
        >>> shell = rt.simulate_specimen("akoya", step_deg=35)
        >>> print(convert(shell, "shell.astm"))  # doctest: +SKIP
    """
    check_type("source", source, (BrdfMeasurement, RadenBrdf), "load_measurement reads one")
    name = format_of(Path(path), options.to)
    wanted = FORMATS[name]
    target = check_output(path, wanted.suffixes)
    if wanted.grid is not None:
        return _as_grid(source, target, name, options)
    if isinstance(source, RadenBrdf) or options.step_deg is not None:
        sampled, lost = _sampled(source, target, wanted, options)
        done = _as_list(sampled, target, name, replace(options, channel=None), lost)
        return replace(done, as_read=0, interpolated=done.as_read)
    return _as_list(source, target, name, options, [])


def _as_list(
    readings: BrdfMeasurement, path: Path, name: str, options: Options, lost: list[str]
) -> Conversion:
    wanted = FORMATS[name]
    if name == "csv" and options.channel is None and not options.average:
        readings.save(path)
        return Conversion(name, len(readings), len(readings), 0, 0, 0, tuple(lost))
    _, kept, more = _prepared(readings, path, wanted, options)
    values, clipped = _clipped(kept.values, wanted)
    kept = replace(kept, values=values)
    if name == "csv":
        kept.save(path)
    elif name == "astm":
        astm_e1392.write(path, kept)
    else:
        fred.write(path, kept)
    return Conversion(name, len(kept), len(kept), 0, 0, 0, (*lost, *more, *clipped))


def _as_grid(
    source: BrdfMeasurement | RadenBrdf, path: Path, name: str, options: Options
) -> Conversion:
    wanted = FORMATS[name]
    if wanted.grid == "cells" and options.step_deg is not None:
        raise InputError(f"step_deg: expected with another format than {wanted.title}'s cells")
    if isinstance(source, RadenBrdf):
        channels, metadata = channels_for(wanted, options.channel), _metadata_of(source)
        lost = ["what the model has between these directions", *_unheld(metadata, wanted)]
        grid = _regular(path, wanted, options, len(channels), np.zeros(1))
        nodes = merl.nodes() if grid is None else grid.nodes()
        found = of_fitted_model(nodes, source, channels, options, is_reciprocal=grid is None)
    else:
        basis, readings, lost = _prepared(source, path, wanted, options)
        channels, metadata = readings.channels, readings.metadata
        grid, found = _of_measurement(basis, readings, path, wanted, options)
    values, clipped = _clipped(found.values, wanted)
    if grid is None:
        merl.write(path, values / FACTOR_PER_SR)
    else:
        _GRIDS[name](path, grid, values / FACTOR_PER_SR, channels, metadata)
    return found.conversion(name, [*lost, *found.lost, *clipped])


def _of_measurement(
    basis: BrdfMeasurement,
    readings: BrdfMeasurement,
    path: Path,
    wanted: Format,
    options: Options,
) -> tuple[ScatterGrid | None, GridValues]:
    """The grid, None for MERL's cells, and what stands in it."""
    if wanted.grid == "cells":
        nodes = merl.nodes()
        cells = merl.Cells.of(readings)
        if cells is not None:
            return None, of_cells(nodes, cells)
        return None, of_fit(nodes, basis, readings, options, is_reciprocal=True)
    if options.step_deg is None:
        grid = ScatterGrid.through(readings, _about(wanted))
        if grid is not None:
            check_values(path, grid.shape, len(readings.channels))
            return grid, of_readings(grid.nodes(), readings)
    turned = np.zeros(1)
    if readings.azimuth_deg is not None:
        turned = np.unique(np.round(readings.azimuth_deg % 360, 6) % 360)
    grid = _regular(path, wanted, options, len(readings.channels), turned)
    assert grid is not None
    return grid, of_fit(grid.nodes(), basis, readings, options, is_reciprocal=False)


def _about(wanted: Format) -> About:
    assert wanted.grid == "normal" or wanted.grid == "specular"
    return wanted.grid


def _regular(
    path: Path, wanted: Format, options: Options, channels: int, rotation_deg: Floats
) -> ScatterGrid | None:
    """A grid that is made for the format, checked for its size; None for MERL's cells."""
    if wanted.grid == "cells":
        return None
    step = STEP_DEG if options.step_deg is None else options.step_deg
    grid = ScatterGrid.regular(step, _about(wanted), rotation_deg)
    check_values(path, grid.shape, channels)
    return grid


def _prepared(
    measurement: BrdfMeasurement, path: Path, wanted: Format, options: Options
) -> tuple[BrdfMeasurement, BrdfMeasurement, list[str]]:
    """Readings in the format's colours, as they are fitted, and by directions; what that lost."""
    m, lost = in_colours_of(measurement, wanted, options.channel)
    if m.azimuths > 1 and wanted.isotropic and not options.average:
        apart = by_directions(m, over_azimuths=True)[1]
        raise InputError(
            f"{path}: {wanted.title} holds isotropic reflection: expected readings at one sample "
            f"azimuth, or `average`, got {m.azimuths}" + (f"; averaged, {apart}" if apart else "")
        )
    over = False
    if m.azimuths > 1 and options.average:
        over = True
        lost.append(f"the sample's {m.azimuths} azimuths")
    elif wanted.isotropic and m.azimuth_deg is not None and m.azimuth_deg.any():
        over = True
        lost.append("the sample's azimuth")
    if not m.valid.all():
        lost.append(f"{int((~m.valid).sum())} readings that are not valid")
    kept, merged = by_directions(m, over_azimuths=over)
    if merged:
        lost.append(merged)
    if m.std is not None or m.metadata.systematic != Metadata().systematic:
        lost.append("uncertainties")
    if m.count is not None:
        lost.append("counts")
    return kept if over else m, kept, [*lost, *_unheld(m.metadata, wanted)]


def _unheld(about: Metadata, wanted: Format) -> list[str]:
    """What no file of this format holds."""
    said = [*wanted.lost]
    if about.simulated and not wanted.names:
        said.append("that it is simulated")
    return said


def _clipped(values: Floats, wanted: Format) -> tuple[Floats, list[str]]:
    below = int((values < 0).sum())
    if wanted.negative or not below:
        return values, []
    why = "noise, or colours outside sRGB" if wanted.rgb else "noise"
    share = f"{below} of {int(np.isfinite(values).sum())} values that were negative ({why})"
    return np.where(values < 0, 0.0, values), [f"{share} and are 0"]


def _sampled(
    source: BrdfMeasurement | RadenBrdf, path: Path, wanted: Format, options: Options
) -> tuple[BrdfMeasurement, list[str]]:
    """A model, or what readings make one, on a grid of our angles to 85 degrees."""
    step = STEP_DEG if options.step_deg is None else options.step_deg
    if not 0 < step <= 45:
        raise InputError(f"step_deg: expected above 0 and up to 45 degrees, got {step:g}")
    up = int(_HIGHEST_DEG / step + 1e-9)
    check_values(path, (up + 1, 2 * up + 1, 2 * up + 1), _MOST_CHANNELS)
    axis = step * np.arange(-up, up + 1, dtype=np.float64)
    a, r, t = AngleGrid(axis[up:], axis, axis).nodes_deg().reshape(-1, 3).T
    angles = np.stack([a, r, t], axis=1)
    if isinstance(source, RadenBrdf):
        values, inside, channels, about, lost = _of_model(source, angles, wanted, options)
    else:
        values, inside, channels, about, lost = _of_readings(source, angles, path, wanted, options)
    if options.holes:
        values[~inside] = np.nan
    elif not inside.all():
        lost.append(f"that {int((~inside).sum())} values lie beyond the measured angles")
    return BrdfMeasurement(a, r, t, values, channels, metadata=about), lost


_Sampled = tuple[Floats, Bools, tuple[str, ...], Metadata, list[str]]


def _of_model(model: RadenBrdf, angles: Floats, wanted: Format, options: Options) -> _Sampled:
    channels = channels_for(wanted, options.channel)
    values = of_model(f_r_at(model, angles), channels, options.channel)
    about = replace(_metadata_of(model), notes=("values of a model, not readings",))
    return (
        values,
        in_box(model, angles),
        channels,
        about,
        ["what the model has between these directions"],
    )


def _of_readings(
    measurement: BrdfMeasurement, angles: Floats, path: Path, wanted: Format, options: Options
) -> _Sampled:
    basis, kept, lost = _prepared(measurement, path, wanted, options)
    if kept.azimuths > 1:
        raise InputError(
            f"{path}: expected readings at one sample azimuth, or `average`, for a grid of "
            f"`step_deg`, got {kept.azimuths}"
        )
    about = replace(kept.metadata, notes=(*kept.metadata.notes, "resampled, not readings"))
    cells = merl.Cells.of(basis)
    if cells is not None:
        values = cells(angles)
        inside = np.asarray(~np.isnan(values).any(axis=1))
        return values, inside, kept.channels, about, [*lost, BY_CELLS]
    result = fit(basis, assume=options.assume)
    values = in_channels(f_r_at(result.model, angles), kept.channels)
    lost.append(f"the readings themselves (a fit stands for them: {result.report.interpolation})")
    return values, in_box(result.model, angles), kept.channels, about, lost


def _metadata_of(model: RadenBrdf) -> Metadata:
    about = model.provenance
    return Metadata(about.sample, about.instrument, simulated=about.simulated)
