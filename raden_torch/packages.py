"""The packages that only some work needs, by the extra of pyproject.toml that brings them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from threading import Lock

from raden_torch.errors import InputError

_IMAGES = {
    "cv2": "opencv-contrib-python-headless",
    "OpenImageIO": "OpenImageIO",
    "PIL": "pillow",
    "fileseq": "fileseq",
}
_SPECTRAL = {"colour": "colour-science"}
_PLOTS = {"matplotlib": "matplotlib", **_SPECTRAL}
_PHOTO = {**_IMAGES, **_PLOTS}

EXTRAS = {
    "images": _IMAGES,
    "spectral": _SPECTRAL,
    "plots": _PLOTS,
    "photo": _PHOTO,
    "spectrometer": {"serial": "pyserial", **_SPECTRAL},
    "export": {"onnx": "onnx", "onnxruntime": "onnxruntime", "onnxscript": "onnxscript"},
    "simulate": {"mitsuba": "mitsuba", **_PHOTO},
    "xls": {"xlrd": "xlrd"},
    "raw": {"rawpy": "rawpy", **_IMAGES},
    "heif": {"pillow_heif": "pillow-heif", **_IMAGES},
    "icc": {"imagecodecs": "imagecodecs", **_IMAGES},
    "catalogue": {"pyarrow": "pyarrow", **_IMAGES, **_SPECTRAL},
    "cluster": {"distributed": "distributed"},
}
"""For each extra the modules that are imported, with the names that pip installs them by."""


_STDERR = Lock()


class MissingPackageError(InputError, ImportError):
    """Work was asked for that needs a package which is not installed."""


def require(work: str, *extras: str) -> None:
    """Refuse work whose packages are not installed. Nothing is imported.

    Args:
        work: what needs them, in the plural.
        extras: keys of `EXTRAS`.

    Raises:
        MissingPackageError: one line with the packages and the command that installs them.
    """
    lacking = {
        extra: [package for module, package in EXTRAS[extra].items() if not _is_installed(module)]
        for extra in extras
    }
    missing = dict.fromkeys(package for packages in lacking.values() for package in packages)
    if missing:
        wanted = ",".join(extra for extra, packages in lacking.items() if packages)
        raise MissingPackageError(
            f"{work} need {', '.join(missing)}, not installed here: "
            f"pip install 'raden_torch[{wanted}]'"
        )


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # ValueError: a module that was imported without a spec
        return False


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Foreign libraries print their errors as well as raising them; the raised ones are enough.

    One thread at a time: what is redirected is the process's, other threads' messages too, so that
    it is held around the foreign calls alone.
    """
    with _STDERR:
        saved = os.dup(2)
        null = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(null, 2)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            os.close(null)
