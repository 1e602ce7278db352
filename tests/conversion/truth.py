"""A reflection that is known by formula, on directions; and readers that share no code with the
project's: each gives the directions and f_r of a file's numbers, by the format's own documents."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

Rows = tuple[np.ndarray, np.ndarray, np.ndarray]  # light [M, 3], view [M, 3], f_r [M, C]


def f_r(light: np.ndarray, view: np.ndarray, *, lopsided: float = 0.05) -> np.ndarray:
    """`[M, 3]` in 1/sr of unit vectors `[M, 3]`; N = +z: a body, a coloured lobe about the mirror,
    and a part that tells left from right and is not reciprocal."""
    half = light + view
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    sharp = np.exp((half[:, 2:] ** 2 - 1) / (0.2 * half[:, 2:]) ** 2)
    side = np.cross(light, view)[:, 2:]
    body = np.array([0.10, 0.11, 0.12])
    return body + sharp * np.array([0.9, 0.7, 0.5]) + lopsided * side * light[:, 2:] * body


def polar(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """`[M, 3]` of angles in radians."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)


def read_astm(path: Path) -> Rows:
    lines = path.read_text("utf-8").splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("VARS"))
    rows = np.array([[float(x) for x in line.split(",")] for line in lines[head + 1 :]])
    return polar(rows[:, 0], rows[:, 1]), polar(rows[:, 2], rows[:, 3]), rows[:, 4:]


def read_fred(path: Path) -> Rows:
    """FRED help: a line of two is the specular direction; the light comes from across."""
    light, view, f = [], [], []
    for line in path.read_text("utf-8").splitlines()[2:]:
        cells = [float(x) for x in line.split()]
        if len(cells) == 2:
            specular = np.deg2rad(cells)
            continue
        light.append((specular[0], specular[1] + np.pi))
        view.append(np.deg2rad(cells[:2]))
        f.append(cells[2:])
    return polar(*np.array(light).T), polar(*np.array(view).T), np.array(f)


def read_zemax(path: Path) -> Rows:
    """About the specular direction; azimuth 0 towards the normal, counter-clockwise looking at the
    sample."""
    words = [
        w for line in path.read_text("utf-8").splitlines() if line[:1] != "#" for w in line.split()
    ]
    at, axes = 8, []
    assert words[0:2] == ["Source", "Measured"]
    for name in ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial"):
        assert words[at] == name
        count = int(words[at + 1])
        axes.append(np.deg2rad([float(x) for x in words[at + 2 : at + 2 + count]]))
        at += 2 + count
    rotation, incidence, azimuth, radial = axes
    assert len(rotation) == 1
    sections = []
    while at < len(words):
        assert words[at + 1] == "DataBegin"
        at += 2
        for _ in incidence:
            assert words[at] == "TIS"
            size = len(azimuth) * len(radial)
            sections.append([float(x) for x in words[at + 2 : at + 2 + size]])
            at += 2 + size
        assert words[at] == "DataEnd"
        at += 1
    values = np.array(sections).reshape(-1, len(incidence) * len(azimuth) * len(radial)).T
    i, a, r = (x.ravel() for x in np.meshgrid(incidence, azimuth, radial, indexing="ij"))
    light = polar(i, np.full_like(i, np.pi))
    specular = polar(i, np.zeros_like(i))
    up = np.stack([-np.cos(i), np.zeros_like(i), np.sin(i)], 1)
    # looking at the sample one looks along −S: counter-clockwise is from `up` to S × up
    left = np.cross(specular, up)
    round_ = np.cos(a)[:, None] * up + np.sin(a)[:, None] * left
    return light, np.cos(r)[:, None] * specular + np.sin(r)[:, None] * round_, values


def read_lighttools(path: Path) -> Rows:
    """As libbsdf takes it: about the normal, the light at azimuth 90."""
    lines = [x for x in path.read_text("utf-8").splitlines() if x[:1] != "#"]
    words = " ".join(lines).split()
    azimuth, radial = (
        np.deg2rad([float(x) for x in words[i + 2 : i + 2 + int(words[i + 1])]])
        for i in (words.index("ScatterAzimuth"), words.index("ScatterRadial"))
    )
    at, blocks = words.index("DataBegin") + 1, {}
    while words[at] != "DataEnd":
        entries = {}
        while words[at] != "TIS":
            entries[words[at]] = words[at + 1]
            at += 2
        size = len(azimuth) * len(radial)
        channel = "XYZ".index(entries.get("TristimulusValue", "TrisX")[-1])
        own = [float(x) for x in words[at + 2 : at + 2 + size]]
        blocks.setdefault(float(entries["AOI"]), {})[channel] = own
        at += 2 + size
    a, r = (x.ravel() for x in np.meshgrid(azimuth, radial, indexing="ij"))
    one = np.ones_like(a)
    light = [polar(np.deg2rad(i) * one, np.pi / 2 * one) for i in blocks]
    values = [np.array([own[c] for c in sorted(own)]).T for own in blocks.values()]
    return np.concatenate(light), np.tile(polar(r, a), (len(blocks), 1)), np.concatenate(values)


def read_speos(path: Path) -> Rows:
    """Ansys help: rows of polar angles, columns of azimuths, the mirror at azimuth 0."""
    lines = path.read_text("utf-8").splitlines()
    assert lines[7] == "1"  # values go with the BSDF
    assert lines[8] == "1"
    incidence = np.deg2rad([float(x) for x in lines[11].split()])
    at, light, view, values = 17, [], [], []
    for i in incidence:
        count = int(lines[at].split()[0])
        azimuth = np.deg2rad([float(x) for x in lines[at + 1].split()])
        for line in lines[at + 2 : at + 2 + count]:
            theta, *row = (float(x) for x in line.split())
            one = np.ones_like(azimuth)
            light.append(polar(i * one, np.pi * one))
            view.append(polar(np.deg2rad(theta) * one, azimuth))
            values += row
        at += 2 + count
    assert lines[at] == "End of file"
    return np.concatenate(light), np.concatenate(view), np.array(values)[:, None]


def merl_index(light: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Which cell `[M]` a MERL reader looks into, by Matusik's rotations."""
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    theta_h, phi_h = np.arccos(np.clip(half[:, 2], -1, 1)), np.arctan2(half[:, 1], half[:, 0])
    c, s = np.cos(-phi_h), np.sin(-phi_h)
    x, y = c * light[:, 0] - s * light[:, 1], s * light[:, 0] + c * light[:, 1]
    c, s = np.cos(-theta_h), np.sin(-theta_h)
    x, z = c * x + s * light[:, 2], -s * x + c * light[:, 2]
    theta_d, phi_d = np.arccos(np.clip(z, -1, 1)), np.arctan2(y, x) % np.pi
    i = np.sqrt(theta_h / (np.pi / 2) * 90 * 90).astype(int).clip(0, 89)
    j = (theta_d / (np.pi / 2) * 90).astype(int).clip(0, 89)
    k = (phi_d / np.pi * 180).astype(int).clip(0, 179)
    return (i * 90 + j) * 180 + k


READERS: dict[str, tuple[str, Callable[[Path], Rows]]] = {
    "astm": (".astm", read_astm),
    "fred": (".txt", read_fred),
    "zemax": (".bsdf", read_zemax),
    "lighttools": (".bsdf", read_lighttools),
    "speos": (".anisotropicbsdf", read_speos),
}
