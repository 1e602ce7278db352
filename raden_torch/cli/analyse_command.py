"""raden analyse: what the colours of a shell say of its layers."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from raden_torch.cli.file_commands import load_either
from raden_torch.cli.json_output import AsJson, print_json
from raden_torch.cli.option_types import argument
from raden_torch.cli.status import working

if TYPE_CHECKING:
    from raden_torch.measurement import BrdfMeasurement


def analyse(
    file: Annotated[Path, argument("a measurement or a model")],
    /,
    *,
    coat_index: Annotated[
        float, Parameter(help="index of the clear lacquer over the shell; 1 if it is bare")
    ] = 1.53,
    as_json: AsJson = False,
) -> None:
    from raden_torch.optics.tablet_fit import estimate_tablets

    with working(f"analysing {file.name}"):
        estimate = estimate_tablets(_readings(file), coat_n=coat_index)
    if not as_json:
        print(estimate)
        return
    print_json(
        **asdict(estimate),
        tablet_95_percent_nm=estimate.tablet_interval_nm,
        spread_95_percent=estimate.spread_interval,
    )


def _readings(path: Path) -> BrdfMeasurement:
    """The measurement, or what a model gives along the mirror ridge of its measured box."""
    from raden_torch.measurement import BrdfMeasurement

    loaded = load_either(path)
    if isinstance(loaded, BrdfMeasurement):
        return loaded

    import numpy as np
    import torch

    from raden_torch.measurement import Metadata
    from raden_torch.measurement.colour_conversion import xyz_of_f_r

    (_, high), _, (t_low, t_high) = loaded.measured_box_deg
    incidence, tilt = (x.ravel() for x in np.meshgrid(np.arange(0, min(high, 75) + 1e-6, 5.0),
        np.arange(max(0.0, t_low), t_high + 1e-6, 5.0)))  # fmt: skip
    angles = (
        torch.deg2rad(torch.as_tensor(x).view(1, -1, 1)) for x in (incidence, incidence, tilt)
    )
    with torch.no_grad():
        f_r = loaded.fit_form(*angles)[:, :, 0].T.cpu().numpy()
    source = loaded.provenance
    metadata = Metadata(source.sample, source.instrument, simulated=source.simulated)
    return BrdfMeasurement(incidence, incidence, tilt, xyz_of_f_r(f_r), metadata=metadata)
