"""OpenImageIO, set up for this package: the module, files that it opens, what it says of them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any

from raden_torch.packages import require


@cache
def openimageio() -> ModuleType:
    """The module, set for all of the process."""
    require("OpenEXR files", "images")
    import OpenImageIO as oiio

    # by itself it refuses images that are larger than this machine's memory
    oiio.attribute("limits:imagesize_MB", 0)
    # threads of its own would be missing after a fork (a DataLoader's), and be waited for
    oiio.attribute("threads", 1)
    oiio.attribute("exr_threads", -1)
    return oiio


@contextmanager
def opened(
    path: str | os.PathLike[str],
    damaged: Callable[[str], Exception],
    settings: dict[str, int] | None = None,
) -> Iterator[Any]:
    """OpenImageIO's file; its header has been read.

    Args:
        damaged: makes what is raised of the reason why it cannot be opened.
        settings: of its reader, as {"oiio:RawColor": 1}.
    """
    oiio = openimageio()
    config = oiio.ImageSpec()
    for name, value in (settings or {}).items():
        config.attribute(name, value)
    with readable_name(path) as name:
        file = oiio.ImageInput.open(name, config)
        if file is None:
            raise damaged(error_of(oiio))
        try:
            yield file
        finally:
            file.close()


@contextmanager
def readable_name(path: str | os.PathLike[str]) -> Iterator[str]:
    """The path as OpenImageIO takes it; a name that is no text becomes one of an open file."""
    name = os.fspath(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        descriptor = os.open(path, os.O_RDWR if os.access(path, os.W_OK) else os.O_RDONLY)
        try:
            yield f"/dev/fd/{descriptor}"
        finally:
            os.close(descriptor)
    else:
        yield name


def error_of(source: Any) -> str:
    """The first line of what OpenImageIO, or a file of it, says; the others are for programmers."""
    try:
        line = source.geterror().strip().partition("\n")[0]
    except UnicodeDecodeError:  # it repeats the file's own bytes
        line = "its header is damaged"
    found = re.sub(r"^EXR Error \(.*\): (EXR_ERR_\w+ )?", "", line)
    return "".join(c if c.isprintable() else "?" for c in found) or "pixels are missing"
