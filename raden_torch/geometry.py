"""N, L, V ↔ (incidence, receiving, tilt). The one place with the sign conventions.

With p = L×V/|L×V| and N′ = N − (N·p)p:

- incidence a = ∠(N′, L) ≥ 0,
- receiving r = the signed angle from N′ to V, positive away from L, so that a mirror has r = a,
- tilt t = asin(N·p).

Where N′ is not between L and V on L's side, p is flipped so that a ≥ 0: (a, r, t) → (−a, −r, −t).
Hence cos θi = cos a cos t and cos θr = cos r cos t. L ∥ V leaves p free; there the plane of L and N
is taken: t = 0, a = θ, r = −θ. See docs/conventions.md for the drawing.

Source: Take (2012), §5.4, made unambiguous. The half-angle forms on d = V − L need no quadrants
(`atan2` is not portable to ONNX) and lose nothing where L and V almost agree.
"""

from __future__ import annotations

import torch
from torch import Tensor

from raden_torch.errors import InputError, check_type

XYZ_DIM = -3
"""The dimension that holds x, y, z in every vector map."""


def raden_angles(normal: Tensor, light: Tensor, view: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Incidence, receiving and tilt of each pixel.

    Args:
        normal, light, view: `[..., 3, H, W]` directions away from the surface (the surface normal,
            to the light, to the viewer), of any length, broadcastable against each other.

    Returns:
        incidence, receiving, tilt: `[..., 1, H, W]` in radians; float64 where an input is, else
        float32 (float16 and bfloat16 are computed and returned in float32). All three are 0 where
        a vector is zero or not finite. The gradient is finite everywhere.

    Raises:
        InputError: a tensor is not floating point, has no xyz dimension, or does not broadcast.

    Examples:
        Light from 45° on the left and the viewer at 45° on the right, over a surface that leans by
        30°:

        >>> import torch
        >>> import raden_torch as rt
        >>> normal, light, view = torch.tensor(
        ...     [[0.0, 1.0, 3**0.5], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
        ... ).view(3, 3, 1, 1)
        >>> [round(angle.rad2deg().item(), 3) for angle in rt.raden_angles(normal, light, view)]
        [45.0, 45.0, 30.0]
    """
    n, l, v = unit_vectors(normal=normal, light=light, view=view)  # noqa: E741
    return angles_from_unit_vectors(n, l, v)


def unit_vectors(**maps: Tensor) -> tuple[Tensor, ...]:
    """The maps as unit vectors in one dtype; an invalid vector becomes zero.

    Raises:
        InputError: as in `raden_angles`.
    """
    check_vector_maps(**maps)
    dtype = working_dtype(*maps.values())
    return tuple(normalised(m.to(dtype)) for m in maps.values())


def angles_from_unit_vectors(n: Tensor, l: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor]:  # noqa: E741
    """`raden_angles` of vectors that are unit (or zero) already, in float32 or float64."""
    tiny = torch.finfo(n.dtype).tiny ** 0.5
    eps = torch.finfo(n.dtype).eps
    n_l, n_v = dot(n, l), dot(n, v)
    facing = torch.where(dot(l, v) < 0, -torch.ones_like(n_l), torch.ones_like(n_l))
    d = v - facing * l  # the short diagonal: exact where L and V almost agree, or almost oppose
    p_s = cross(l, d)  # p times s
    s = length(p_s)
    apart = s > 4 * eps
    s_safe = torch.where(apart, s, torch.ones_like(s))
    # The part of N along the unit vector in the plane of L and V that is across L (towards V),
    # (d − (d·L)L)/s, and along the one across V (away from L), (d − (d·V)V)/s.
    across_l = (dot(n, d) - dot(d, l) * n_l) / s_safe
    across_v = facing * (dot(n, d) - dot(d, v) * n_v) / s_safe
    h = torch.sqrt(n_l * n_l + across_l * across_l + tiny)
    a = _twice_atan(across_l, h + n_l)
    r = -_twice_atan(across_v, h + n_v)
    t = _twice_atan(dot(n, p_s) / s_safe, 1 + h)
    flip = torch.where(a < 0, -torch.ones_like(a), torch.ones_like(a))

    theta = _twice_atan(length(cross(n, l)), 1 + n_l)
    back = torch.where(facing > 0, torch.zeros_like(n_l), torch.full_like(n_l, torch.pi))
    return (
        torch.where(apart, a * flip, theta),
        torch.where(apart, r * flip, back - theta),
        torch.where(apart, t * flip, torch.zeros_like(t)),
    )


def vectors_from_angles(
    incidence: Tensor, receiving: Tensor, tilt: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The inverse of `raden_angles`, in the frame with N = +z.

    Args:
        incidence, receiving, tilt: `[..., 1, H, W]` in radians, broadcastable.

    Returns:
        normal, light, view: `[..., 3, H, W]` unit vectors, in the dtype of the angles. The plane of
        L and V holds the x axis and leans by the tilt towards −y.

    Examples:
        >>> import torch
        >>> import raden_torch as rt
        >>> degrees = torch.tensor([30.0, -10.0, 20.0], dtype=torch.float64)
        >>> angles = degrees.deg2rad().view(3, 1, 1, 1)
        >>> back = rt.raden_angles(*rt.vectors_from_angles(*angles))
        >>> [round(angle.rad2deg().item(), 9) for angle in back]
        [30.0, -10.0, 20.0]
    """
    for name, angle in (("incidence", incidence), ("receiving", receiving), ("tilt", tilt)):
        check_type(name, angle, Tensor, "in radians, as torch.deg2rad(degrees) gives them")
    a, r, t = torch.broadcast_tensors(incidence, receiving, tilt)
    if not a.is_floating_point():
        raise InputError(f"vectors_from_angles: expected a floating-point dtype, got {a.dtype}")
    if a.ndim < 3 or a.shape[XYZ_DIM] != 1:
        raise InputError(
            f"vectors_from_angles: expected angles of shape [..., 1, H, W], got {list(a.shape)}"
        )
    zero, one = torch.zeros_like(a), torch.ones_like(a)
    normal = torch.cat([zero, zero, one], XYZ_DIM)
    light = torch.cat([-a.sin(), -a.cos() * t.sin(), a.cos() * t.cos()], XYZ_DIM)
    view = torch.cat([r.sin(), -r.cos() * t.sin(), r.cos() * t.cos()], XYZ_DIM)
    return normal, light, view


def working_dtype(*tensors: Tensor) -> torch.dtype:
    """float64 where one of the tensors is, else float32: nothing is computed in half precision."""
    return torch.float64 if any(t.dtype == torch.float64 for t in tensors) else torch.float32


def check_vector_maps(**maps: Tensor) -> None:
    """Raise InputError, in one line, unless the maps are `[..., 3, H, W]` and broadcast."""
    for name, m in maps.items():
        if not isinstance(m, Tensor) or not m.is_floating_point():
            kind = m.dtype if isinstance(m, Tensor) else type(m).__name__
            raise InputError(
                f"{name}: expected a floating-point tensor [B, 3, H, W], got "
                f"{kind}{how_to_convert(m)}"
            )
        if m.ndim < 3 or m.shape[XYZ_DIM] != 3:
            raise InputError(
                f"{name}: expected shape [B, 3, H, W], got {list(m.shape)}{how_to_convert(m)}"
            )
    if len({m.device for m in maps.values()}) > 1:
        where = ", ".join(f"{name} on {m.device}" for name, m in maps.items())
        raise InputError(f"maps: expected one device, got {where}")
    try:
        # not broadcast_shapes, which imports sympy when it is first called: half a second
        torch.broadcast_tensors(*maps.values())
    except RuntimeError:
        shapes = ", ".join(f"{name} {list(m.shape)}" for name, m in maps.items())
        raise InputError(
            f"maps: expected equal sizes or 1, which broadcast, got {shapes}"
        ) from None


def how_to_convert(given: object) -> str:
    """The call that makes `[B, 3, H, W]` of vectors in another layout, for an error message;
    empty where none is known."""
    shape = tuple(getattr(given, "shape", ()))
    if 3 not in shape or len(shape) > 4:
        return ""
    call = "x" if isinstance(given, Tensor) else "torch.from_numpy(x)"
    if isinstance(given, Tensor) and not given.is_floating_point():
        call += ".float()"
    if len(shape) == 2 and shape[1] == 3:  # [P, 3]: points in a column
        call += ".T[None, :, :, None]"
    elif len(shape) == 3 and shape[0] != 3:  # [H, W, 3]
        call += ".movedim(-1, 0)[None]"
    elif len(shape) == 3:  # [3, H, W]
        call += "[None]"
    elif len(shape) == 4 and shape[1] != 3 and shape[3] == 3:  # [B, H, W, 3]
        call += ".movedim(-1, 1)"
    return "" if call == "x" else f"; convert it by {call}"


def normalised(v: Tensor) -> Tensor:
    """`v` scaled to unit length; zero where `v` is zero or not finite.

    Dividing by the largest component first keeps huge and denormal vectors from over- and
    underflowing. What is unit already, to a few roundings, is left as it is: scaling it again would
    only add an error, which counts where L and V almost agree.
    """
    valid = torch.isfinite(v).all(XYZ_DIM, keepdim=True)
    v = torch.where(valid, v, torch.zeros_like(v))
    largest = v.detach().abs().amax(XYZ_DIM, keepdim=True)
    valid = largest > 0
    largest = torch.where(valid, largest, torch.ones_like(largest))
    # a denormal's 1/length would overflow in the gradient: there it stops growing
    slope = 1 / largest.clamp(min=torch.finfo(v.dtype).tiny ** 0.5)
    scaled = v * slope + (v / largest - v * slope).detach()
    length = torch.sqrt(torch.where(valid, dot(scaled, scaled), torch.ones_like(largest)))
    unit = scaled / length
    is_unit = (length * largest - 1).abs() < 8 * torch.finfo(v.dtype).eps
    # the value of v itself, the gradient of the normalisation
    return unit + torch.where(is_unit, v - unit, torch.zeros_like(v)).detach()


def unit_columns(v: Tensor) -> Tensor:
    """`[3, N]` vectors at unit length; zero stays zero.

    In a fraction of the time of `torch.nn.functional.normalize`, whose norm over the first
    dimension is slow.
    """
    return v * v.square().sum(0).clamp_(min=1e-24).rsqrt_()


def dot(a: Tensor, b: Tensor) -> Tensor:
    """a·b of two vector maps, `[..., 1, H, W]`."""
    return (a * b).sum(XYZ_DIM, keepdim=True)


def cross(a: Tensor, b: Tensor) -> Tensor:
    a, b = torch.broadcast_tensors(a, b)
    return torch.linalg.cross(a, b, dim=XYZ_DIM)


def length(v: Tensor) -> Tensor:
    """|v|, with gradient 0 instead of NaN at 0."""
    square = dot(v, v)
    positive = square > 0
    root = torch.sqrt(torch.where(positive, square, torch.ones_like(square)))
    return torch.where(positive, root, torch.zeros_like(square))


def _twice_atan(y: Tensor, x: Tensor) -> Tensor:
    """2 atan(y/x) for x ≥ 0, finite with its gradient at x = 0."""
    return 2 * torch.atan(y / torch.clamp(x, min=torch.finfo(x.dtype).eps))
