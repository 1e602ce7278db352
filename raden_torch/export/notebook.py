"""A model as the last expression of a notebook's cell: the viewer, in a frame (decision 35)."""

from __future__ import annotations

import html

from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.errors import InputError
from raden_torch.export.viewer_file import viewer_page


def viewer_frame(model: RadenBrdf) -> str | None:
    """HTML that shows a model, for a notebook's output; it takes nothing from the network.

    Returns:
        A caption and an `iframe` that holds the whole page, some 1.4 MB; None where no viewer can
        be made of the model, so that the notebook shows its text.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.notebook import viewer_frame
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> viewer_frame(model)[:53]
        '<p>akoya (simulated: computed, not measured)</p><ifra'
    """
    try:
        page = viewer_page([model])
    except InputError:
        return None
    source = model.provenance
    name = html.escape(source.sample or "unnamed sample")
    caption = f"{name} (simulated: computed, not measured)" if source.simulated else name
    # no origin of its own: the page reads nothing of the notebook
    return (
        f'<p>{caption}</p><iframe title="Viewer of {name}" sandbox="allow-scripts" '
        'allow="xr-spatial-tracking" style="width: 100%; height: 46rem; border: 0" '
        f'srcdoc="{html.escape(page)}"></iframe>'
    )
