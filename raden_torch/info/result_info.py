"""JSON files in words: what `raden capture` and `raden bench` found."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from raden_torch.errors import InputError
from raden_torch.schema import Count, Finite, read_document

if TYPE_CHECKING:
    from raden_torch.capture.photo.camera import Camera


class _Normals(Struct):
    lamps: list[Any]
    files: dict[str, str]
    method: str
    pixels_solved: Count
    median_confidence: Finite
    median_standard_error_deg: Finite
    notes: list[str] = []


class _Inlay(Struct):
    materials: list[str]
    pieces: list[Any]
    photographs: list[Any]
    files: dict[str, str]
    layers: str
    median_residual: Finite
    notes: list[str] = []
    learnt: dict[str, Any] = {}


class _Brdf(Struct):
    shape: str
    grid_step_deg: Finite
    cells: Count
    cells_covered: Count
    coverage: Finite
    samples: Count
    photographs: list[Any]
    median_relative_std_percent: dict[str, dict[str, Finite]]
    next: list[dict[str, Any]]
    notes: list[str] = []


def recognises_result(head: bytes) -> bool:
    return _is_json_with(head, rb'"format"\s*:\s*"raden capture"')


def describe_result(path: Path) -> str:
    """By its kind, which names the command that wrote it."""
    kind = str(_parsed(path).get("kind"))
    if kind not in _RESULTS:
        raise InputError(f"{path}: expected a result of {', '.join(_RESULTS)}; got {kind[:40]!r}")
    return _RESULTS[kind](path)


def recognises_opencv(head: bytes) -> bool:
    return head.startswith((b"%YAML", b"<?xml")) and b"camera_matrix" in head


def describe_camera(path: Path) -> str:
    """Size, focal lengths, distortion; residuals and poses where they are known."""
    from raden_torch.capture.photo.camera import read_camera

    camera = read_camera(path)
    if recognises_opencv(path.read_bytes()[:64_000]):
        return "\n".join(["camera, a calibration by OpenCV", *_lens(camera)])
    found = _parsed(path)
    lines = ["camera, written by `raden capture calibrate`", *_lens(camera)]
    if "reprojection_rms_px" in found:
        rms, spread = found["reprojection_rms_px"], found["focal_std_px"]
        lines.append(f"re-projection rms {rms:.3f} px; focal lengths ± {spread[0]:.2g} px")
    lines.append(f"poses of the board: {len(found.get('poses', ()))}")
    return "\n".join([*lines, *_notes(found)])


def _lens(camera: Camera) -> list[str]:
    (fx, _, x), (_, fy, y), _ = camera.matrix
    lens = ", ".join(f"{value:.4g}" for value in camera.distortion)
    return [
        f"{camera.size[1]} x {camera.size[0]} pixels; focal lengths {fx:.1f}, {fy:.1f} px; "
        f"horizontal field of view {camera.fov_deg:.2f} deg",
        f"principal point {x:.1f}, {y:.1f} px; distortion (OpenCV's order): {lens}",
    ]


def _lights(path: Path) -> str:
    from raden_torch.capture.photo.lamps import read_lamps

    lamps, found = read_lamps(path), _parsed(path)
    where = "directions" if lamps.position is None else f"positions in {lamps.unit}"
    head = [
        f"lights: {len(lamps)} lamps ({where}), written by `raden capture lights`",
        f"camera's response: exponent {lamps.exponent:g}; balls: {len(found.get('balls', ()))}",
    ]
    places = [] if lamps.position is None else lamps.position.tolist()
    at = [
        f"{name}: at {', '.join(f'{c:.4g}' for c in place)} {lamps.unit}"
        for name, place in zip(lamps.names, places, strict=False)
    ]
    return "\n".join([*head, str(lamps), *at, *_notes(found)])


def _colour(path: Path) -> str:
    from raden_torch.capture.photo.colour import read_colour

    correction, found = read_colour(path), _parsed(path)
    mean, worst = found["mean_delta_e_2000"], found["worst_delta_e_2000"]
    left_out = found["left_out_delta_e_2000"][correction.method]
    exponent = found["neutral_exponent"]
    return "\n".join(
        [
            "colour of a camera, written by `raden capture colour`",
            f"{found['maps']}, by {correction.method}; {found['chart']}",
            f"ΔE2000: mean {mean:.2f}, worst {worst:.2f}; each patch left out in turn: "
            f"mean {left_out['mean']:.2f}, worst {left_out['worst']:.2f}",
            "neutral patches: "
            + ("not known" if exponent is None else f"signal ~ reflectance^{exponent:.2f}"),
            *_notes(found),
        ]
    )


def _normals(path: Path) -> str:
    from raden_torch.capture.photo.result_file import read_result

    found = read_result(path, "normals", _Normals)
    return "\n".join(
        [
            "normals of an object, written by `raden capture normals`",
            f"{found.pixels_solved} pixels solved from {len(found.lamps)} photographs, "
            f"method {found.method}",
            f"median confidence {found.median_confidence:g}, standard error "
            f"{found.median_standard_error_deg:g} deg",
            f"maps beside it: {', '.join(found.files.values())}",
            *(f"note: {note}" for note in found.notes),
        ]
    )


def _inlay(path: Path) -> str:
    from raden_torch.capture.photo.result_file import read_result

    found = read_result(path, "inlay", _Inlay)
    return "\n".join(
        [
            "inlay from photographs, written by `raden capture texture`",
            f"{len(found.pieces)} pieces from {len(found.photographs)} photographs, layers: "
            f"{found.layers}",
            f"materials: {', '.join(found.materials)}",
            *_learnt(found),
            f"residual of a photograph: {100 * found.median_residual:.2g} % of a pixel's mean "
            "light over all lamps",
            f"beside it: {', '.join(found.files.values())}",
            *(f"note: {note}" for note in found.notes),
        ]
    )


def _learnt(found: _Inlay) -> list[str]:
    if not found.learnt:
        return []
    return [f"the shells were learnt from {len(found.photographs)} photographs, not measured"]


def _brdf(path: Path) -> str:
    from raden_torch.capture.photo.result_file import read_result

    found = read_result(path, "brdf", _Brdf)
    return "\n".join(
        [
            f"report of a BRDF from {len(found.photographs)} photographs of a {found.shape}, "
            "written by `raden capture brdf`",
            f"grid of {found.grid_step_deg:g} deg: {found.cells_covered} of {found.cells} "
            f"cells covered ({100 * found.coverage:.1f} %), {found.samples} samples",
            *(
                f"standard deviation, {region}: {terms['total']:.3g} % (median)"
                for region, terms in found.median_relative_std_percent.items()
            ),
            *(f"next: {stance['text']}" for stance in found.next),
            *(f"note: {note}" for note in found.notes),
        ]
    )


_RESULTS: dict[str, Callable[[Path], str]] = {
    "camera": describe_camera,
    "colour": _colour,
    "lights": _lights,
    "normals": _normals,
    "brdf": _brdf,
    "inlay": _inlay,
}


def recognises_truth(head: bytes) -> bool:
    return _is_json_with(head, rb'"renderer"\s*:\s*"Mitsuba')


def describe_truth(path: Path) -> str:
    """Material, camera, lamps of simulated photographs."""
    found = _parsed(path)
    height, width = found["camera"]["size"]
    return "\n".join(
        [
            "truth of simulated photographs, written by `raden capture simulate`",
            f"{found['material']} ({found['material_source']}), {found['specimen']['shape']}; "
            f"{found['renderer']}",
            f"camera: {width} x {height} pixels, {found['camera']['bits']} bits, focal length "
            f"{found['camera']['matrix'][0][0]:.1f} px",
            f"photographs: {len(found['exposure_s'])}; lamps: {len(found['lamps'])}; "
            f"boards: {len(found['boards'])}",
            f"beside it: {found['measurement']}, {found['normals']}",
        ]
    )


def recognises_bench(head: bytes) -> bool:
    return _is_json_with(head, rb'"runs"\s*:\s*\d+,\s*"default_nodes"')


def describe_bench(path: Path) -> str:
    """Specimen, frame, and the default's times and errors."""
    found = _parsed(path)
    height, width = found["frame"]
    kind = "simulated" if found["simulated"] else "measured"
    return "\n".join(
        [
            f"benchmark on {found['sample'] or 'an unnamed sample'} ({kind}), "
            "written by `raden bench`",
            f"frame {width} x {height}; {len(found['rows'])} rows; default: "
            f"{found['interpolation']}, {found['default_nodes']} nodes",
            *(
                f"{row['backend']} {row['precision']}: {row['times_floor']:.1f} times a copy, RMS "
                + ", ".join(
                    f"{error['rms']:.5f} {_PLACES[region]}"
                    for region, error in row["errors"].items()
                )
                for row in found["rows"]
                if row["default"]
            ),
        ]
    )


_PLACES = {
    "inside": "inside the measured box",
    "outside": "outside it",
    "hemisphere": "over the hemisphere",
}


def _is_json_with(head: bytes, pattern: bytes) -> bool:
    return head.lstrip()[:1] == b"{" and re.search(pattern, head) is not None


def _parsed(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = read_document(path, "a file that raden wrote")
    return found


def _notes(found: dict[str, Any]) -> list[str]:
    return [f"note: {note}" for note in found.get("notes", ())]
