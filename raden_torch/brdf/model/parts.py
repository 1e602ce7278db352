"""The two terms of eq. (2) as models of their own: what gains that differ by pixel multiply."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from raden_torch.brdf.model.model import RadenBrdf

_parts: WeakKeyDictionary[RadenBrdf, tuple[RadenBrdf, RadenBrdf]] = WeakKeyDictionary()


def parts_of(model: RadenBrdf) -> tuple[RadenBrdf | None, RadenBrdf | None]:
    """I_d d and I_s w (table − d), which share the model's tensors; None for a part it has none of.

    Their runtime tables add up to the model's: baking is linear in the gains (decision 22).
    """
    known = _parts.get(model)
    parts = (model.diffuse, model.table, model.layout)
    if known is None or (known[1].diffuse, known[1].table, known[1].layout) != parts:
        known = (
            RadenBrdf(model.diffuse, None, layout=model.layout),
            RadenBrdf(model.diffuse, model.table, diffuse_gain=0.0, layout=model.layout),
        )
        _parts[model] = known
    body, beyond = known
    body.diffuse_gain, beyond.specular_gain = model.diffuse_gain, model.specular_gain
    return (
        None if model.diffuse is None else body,
        None if model.table is None else beyond,
    )
