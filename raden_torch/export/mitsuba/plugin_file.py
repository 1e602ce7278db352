"""`export_plugin`: a model as an .xml file of the plugin `raden`, with its table beside it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

from raden_torch import __version__
from raden_torch.brdf.materials.runtime import models_of
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.model import Provenance
from raden_torch.errors import InputError
from raden_torch.export.mitsuba.plugin import NAME
from raden_torch.export.table_file import single_table, write_table
from raden_torch.files import check_outputs, written_beside

_TEXT = """\
<!-- {source}. Written by raden_torch {version}. Python only: mitsuba.set_variant(…), then
     raden_torch.export.mitsuba.plugin.register(), then this file. f_r in 1/sr, linear sRGB. -->
<bsdf version="3.0.0" type="{name}" id={stem}>
    <string name="filename" value={table}/>
    <boolean name="two_sided" value="false"/>
</bsdf>
"""


@dataclass(frozen=True)
class PluginReport:
    """What was written.

    Attributes:
        files: the .xml file, the table and its description.
        table_bytes: of the table.
        half_precision: the largest change that half precision makes to a node, over the peak.
    """

    files: tuple[Path, ...]
    table_bytes: int
    half_precision: float

    def __str__(self) -> str:
        return (
            f"Mitsuba 3 BSDF: a table of {self.table_bytes} bytes; half precision changes a node "
            f"by at most {self.half_precision:.1e} of the peak"
        )


def export_plugin(model: Reflection, path: str | os.PathLike[str]) -> PluginReport:
    """Write a model as a BSDF of Mitsuba 3, for scenes that `register` its plugin.

    Beside `shell.xml` go `shell.bin` and `shell.json`, the table and what it is. A scene takes them
    by `<include filename="shell.xml"/>` and `<ref id="shell"/>`; all of them are in its folder.

    Args:
        model: of the three angles; on the CPU.
        path: ends in .xml.

    Raises:
        InputError: another suffix, a palette or a sample of several azimuths, a table
            too large for a texture or not finite in half precision, or a file cannot be written.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.mitsuba.plugin_file import export_plugin
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> [file.name for file in export_plugin(model, "shell.xml").files]
        ['shell.xml', 'shell.bin', 'shell.json']
    """
    text, table, about = (Path(path).with_suffix(s) for s in (Path(path).suffix, ".bin", ".json"))
    check_outputs(text, table, about)
    if text.suffix != ".xml":
        raise InputError(f"{text}: suffix: expected .xml, got {text.suffix or 'none'!r}")
    form = single_table(model)
    models = models_of(model)
    source = models[0].provenance if models else Provenance()
    size, change = write_table(form, source, table, about)
    with written_beside(text) as temporary:
        temporary.write_text(_text(source, text.stem, about.name), "utf-8")
    return PluginReport((text, table, about), size, change)


def _text(source: Provenance, stem: str, table: str) -> str:
    kind = "SIMULATED sample" if source.simulated else "Sample"
    # two hyphens end a comment
    sample = " ".join(source.sample.split()).replace("--", "- -") or "unnamed"
    return _TEXT.format(
        source=f"{kind}: {sample}",
        version=__version__,
        name=NAME,
        stem=quoteattr(stem),
        table=quoteattr(table),
    )
