"""Does a normal map look as if it were stored in another way than it was read?

Three things hold for the normals of a surface that is seen from the front:

* Whole numbers and other maps in 0…1 hold (n + 1)/2, so 2 v − 1 has length 1.
* They face the viewer: z > 0, but for a few at the rim.
* They are those of a height h(x, y), whose slopes p = ∂h/∂x = −nx/nz, q = ∂h/∂y = −ny/nz have no
  curl: ∂p/∂y = ∂q/∂x. Over a map, c = Σ (∂p/∂y − ∂q/∂x)² / Σ (p_x² + p_y² + q_x² + q_y²) is 0, 0.5
  in noise, and of the order of 0.5 where one of x and y is turned around or both are exchanged.
  The denominator is the same for all of these. A sphere's small cap is a paraboloid, and stays one
  when x and y are exchanged: it says nothing, as a flat map does not.

That a map has x *and* y turned around (hollows for bumps) is seen in its outline alone, where an
object's normals point outward. As objects may be hollow, this only chooses between arrangements
that the curl cannot tell apart.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from raden_torch.brdf.files.normal_axes import NormalAxes
from raden_torch.brdf.shading.gbuffer import GBuffer
from raden_torch.geometry import dot, normalised

AWAY = 0.1
"""The share of normals that may face away; of those with z below −`AWAY`. A wide lens sees some."""
OFF_LENGTH, OFF_SHARE, EXPLAINED = 0.1, 0.5, 0.7
CLEARER, LEAST_CURL, MOST_CURL = 3.0, 0.1, 0.15
"""The curl as read over that of another arrangement; the least of the former, the most of the
latter."""
LEAST_CELLS = 200
"""Cells of 2 x 2 pixels that slope more than the steps of the map do, to judge its curl by."""
_GRAZING = 0.2
_LEAST_Z = 0.2
"""Of the mean normal's z."""
_STEPS = 3.0
_GRID, _WINDOW = 4, 64
_POOLED = (1, 4, 8)
"""Pixels whose mean is taken on each side: noise hides the curl of single pixels."""


def warn_of_normals(
    path: object, stored: Tensor, axes: NormalAxes, *, is_coded: bool, step: float = 1e-3
) -> None:
    """Warn where a map says that it is not what it was read as.

    Args:
        stored: `[1, 3, H, W]` in the file's own order, decoded to −1…1; zero where there is none.
        axes: what it was read as.
        is_coded: whether it was decoded from (n + 1)/2.
        step: between neighbouring values, −1…1.
    """
    v = _windows(stored)
    there = (v != 0).any(dim=1)
    if int(there.sum()) < LEAST_CELLS:
        return
    said = _of_length(v.movedim(1, -1)[there], is_coded) or _of_axes(v, there, axes, step)
    if said:
        warnings.warn(f"{path}: {said}", stacklevel=4)


def _windows(m: Tensor) -> Tensor:
    """`[B, 3, h, w]`: a large map at 4 x 4 places, a small one whole."""
    height, width = m.shape[-2:]
    if max(height, width) <= _GRID * _WINDOW:
        return m
    tops, lefts = (
        [(2 * k + 1) * n // (2 * _GRID) - min(n, _WINDOW) // 2 for k in range(_GRID)]
        if n > _GRID * _WINDOW
        else [0]
        for n in (height, width)
    )
    h, w = (_WINDOW if n > _GRID * _WINDOW else n for n in (height, width))
    return torch.cat([m[..., y : y + h, x : x + w] for y in tops for x in lefts])


# --- length


def _is_unit(v: Tensor) -> float:
    """The share of `[N, 3]` of length 1."""
    length = torch.linalg.vector_norm(v, dim=1)
    return float(((length - 1).abs() <= OFF_LENGTH).float().mean())


def _of_length(v: Tensor, is_coded: bool) -> str | None:
    """What `[N, 3]` decoded vectors seem to be, where they are no normals."""
    unit = _is_unit(v)
    if is_coded and float(v[:, 2].max()) < -0.95:
        return "expected x, y and z, got only x and y (blue is 0 everywhere)"
    if unit >= 1 - OFF_SHARE:
        return None
    if not is_coded:
        if _is_unit(2 * v - 1) < EXPLAINED:
            return None  # normals may have any length
        return "the normals seem to be stored as (n + 1)/2, with some values below 0; cut these off"
    from kornia.color import linear_rgb_to_rgb, rgb_to_linear_rgb

    s = (v + 1) / 2

    def recoded(curve: Callable[[Tensor], Tensor]) -> float:
        return _is_unit(2 * curve(s.T[None, :, :, None])[0, :, :, 0].T - 1)

    said = f"{1 - unit:.0%} of the normals are not of unit length; "
    if float(((s - s.mean(dim=1, keepdim=True)).abs() < 0.02).all(dim=1).float().mean()) > 0.9:
        return said + "expected a normal map, got a grey image, perhaps a height map"
    if recoded(rgb_to_linear_rgb) >= EXPLAINED:
        return said + "they would be without the sRGB curve: save the map as linear (non-colour)"
    if recoded(linear_rgb_to_rgb) >= EXPLAINED:
        return said + (
            "they would be with the sRGB curve: the map was decoded as a colour; convert it as raw "
            "(non-colour) data"
        )
    if float(s[:, 2].std()) < 0.01:
        return said + "blue is the same everywhere, as if x and y alone were stored"
    is_longer = torch.linalg.vector_norm(s, dim=1) > 1 + OFF_LENGTH
    if _is_unit(s) >= 0.2 and float(is_longer.float().mean()) < 0.1:
        return said + "expected (n + 1)/2, got what seems to be n cut off at 0"
    return said + "is it a picture, not a normal map?"


# --- arrangement


def _of_axes(v: Tensor, there: Tensor, axes: NormalAxes, step: float) -> str | None:
    z = axes.of_map(v)[:, 2][there]
    away, base = _share_away(z), axes
    if away > AWAY or float(z.mean()) < _LEAST_Z:
        facing = _facing(v, there, axes)
        if facing is not None:
            base = facing
        elif away > 0.5:
            return (
                f"expected x right, y up, z to the viewer, got {away:.0%} of the normals facing "
                "away from the viewer; they stay black"
            )
    best, clearer = _least_curl(v, there, base, step)
    if best == axes:
        return None
    best = _outward(best, best.of_map(v), there)
    why = []
    if base != axes:
        share = float((z < _LEAST_Z).float().mean())
        why.append(f"{share:.0%} of the normals are seen from behind or edge-on")
    if clearer:
        change = _change(axes, best)
        why.append(f"with {change} the normals fit a surface {clearer:.0f} times better")
    return f"{', and '.join(why)}; if so, give {best.option()}"


def _share_away(z: Tensor) -> float:
    return float((z < -AWAY).float().mean())


def _facing(v: Tensor, there: Tensor, axes: NormalAxes) -> NormalAxes | None:
    """Where z is another channel, which all but a few normals agree on; x or y takes its place."""
    turned = axes.turned(1, 1, -1)
    candidates = [turned]
    for sign in (1, -1):
        for place in (0, 1):
            channels, signs = list(axes.channels), list(axes.signs)
            channels[place], channels[2] = channels[2], channels[place]
            signs[place], signs[2] = 1, sign
            candidates.append(NormalAxes(tuple(channels), tuple(signs)))  # type: ignore[arg-type]
    for candidate in candidates:
        z = candidate.of_map(v)[:, 2][there]
        if _share_away(z) < 0.02 and float(z.mean()) > 0.3:
            return candidate
    return None


def _least_curl(
    v: Tensor, there: Tensor, base: NormalAxes, step: float
) -> tuple[NormalAxes, float]:
    """The arrangement of x and y with far less curl, and how many times less; else `base`, 0."""
    (x, y, z), (sx, sy, sz) = base.channels, base.signs
    swapped = NormalAxes((y, x, z), (sx, sy, sz))
    arrangements = (base, base.turned(1, -1), swapped, swapped.turned(1, -1))
    found = (base, 0.0)
    for curls in _curls(base.of_map(v), there, step):
        least = min(range(4), key=lambda k: curls[k])
        if least == 0 and curls[0] * CLEARER < min(curls[1:]):
            return base, 0.0
        clearer = curls[0] / max(curls[least], 1e-3)
        is_other = curls[0] > LEAST_CURL and curls[least] < MOST_CURL
        if is_other and clearer > max(CLEARER, found[1]):
            found = (arrangements[least], clearer)
    return found


def warn_of_facing(path: object, gbuffer: GBuffer) -> None:
    """Warn where normals in world space face away from their camera."""
    n, v = (
        _windows(m.expand_as(gbuffer.normal))
        for m in (gbuffer.normal, gbuffer.view_map(gbuffer.normal))
    )
    there = (n != 0).any(dim=1)
    if gbuffer.mask is not None:
        there = there & (_windows(gbuffer.mask.expand_as(gbuffer.normal))[:, 0] > 0)
    if int(there.sum()) < LEAST_CELLS:
        return
    away = float((dot(normalised(n), normalised(v))[:, 0][there] < -AWAY).float().mean())
    if away > AWAY:
        warnings.warn(
            f"{path}: {away:.0%} of the normals face away from the camera; is it another camera, "
            "another world (--world) or space (--space) that they are in?",
            stacklevel=2,
        )


def _curls(n: Tensor, there: Tensor, step: float) -> Iterator[list[float]]:
    """c of the four arrangements of `[B, 3, H, W]`, at each scale that has enough cells."""
    for size in (size for size in _POOLED if size <= min(n.shape[-2:])):
        mean = avg_pool2d(n, size) if size > 1 else n
        whole = avg_pool2d(there[:, None].float(), size)[:, 0] == 1 if size > 1 else there
        x, y, z = mean.unbind(1)
        steep = torch.linalg.vector_norm(mean, dim=1)
        known = whole & (z > _GRAZING * steep) & (steep > 0.1)
        z = torch.where(known, z, torch.ones_like(z))
        p_x, p_y = _differences(-x / z)
        q_x, q_y = _differences(-y / z)
        energy = p_x**2 + p_y**2 + q_x**2 + q_y**2
        inside = known[:, 1:, 1:] & known[:, 1:, :-1] & known[:, :-1, 1:] & known[:, :-1, :-1]
        # a step of n is one of up to 1/z² of a slope; smooth slopes may consist of steps alone
        coarse = (_STEPS * step / z[:, 1:, 1:] ** 2) ** 2
        counted = inside & (energy > coarse)
        if int(counted.sum()) < LEAST_CELLS:
            continue
        # creases and outlines have the largest slopes' differences: no more than the top tenth
        e = energy[counted]
        most = e.kthvalue(1 + int(0.9 * (len(e) - 1))).values
        weight = counted * (most / energy.clamp(min=1e-30)).clamp(max=1)
        total = float((weight * energy).sum())
        curls = []
        for a, b in ((p_y, q_x), (q_y, p_x)):
            squares, product = (weight * (a * a + b * b)).sum(), (weight * a * b).sum()
            curls += [float(squares - sign * 2 * product) / total for sign in (1, -1)]
        yield curls


def _differences(m: Tensor) -> tuple[Tensor, Tensor]:
    """∂/∂x and ∂/∂y (up) of `[B, H, W]` in the middle of each cell of 2 x 2."""
    a, b, c, d = m[:, :-1, :-1], m[:, :-1, 1:], m[:, 1:, :-1], m[:, 1:, 1:]
    return (b + d - a - c) / 2, (a + b - c - d) / 2


def _outward(axes: NormalAxes, n: Tensor, there: Tensor) -> NormalAxes:
    """`axes`, with x and y both turned around where the outline's normals point inward by it."""
    x, y, _ = n.unbind(1)
    across, down = there[:, :, 1:] != there[:, :, :-1], there[:, 1:] != there[:, :-1]
    # of the two pixels of such a pair one has no normal, whose x and y are 0
    right = (x[:, :, :-1] - x[:, :, 1:])[across]
    up = (y[:, 1:] - y[:, :-1])[down]
    outward = torch.cat([right, up])
    if len(outward) < 50 or float(outward.sum()) > -0.5 * float(outward.abs().sum()):
        return axes
    return axes.turned(-1, -1)


def _change(before: NormalAxes, after: NormalAxes) -> str:
    if before.channels != after.channels:
        return "channels exchanged"
    colours = ["red", "green", "blue"]
    turned = [
        colours[c]
        for c, a, b in zip(before.channels, before.signs, after.signs, strict=True)
        if a != b
    ]
    return " and ".join(turned) + " turned around"
