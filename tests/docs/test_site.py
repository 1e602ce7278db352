"""The documentation site builds without a warning, holds what it should, and needs no network."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import raden_torch as rt

PROJECT = Path(__file__).parents[2]
pytest.importorskip("sphinx", reason="Sphinx, of the extra `docs`, is not installed")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built as `make docs` does, without running the notebooks, which have their own test."""
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", "docs/site"]
    done = subprocess.run(
        [*build, "-d", str(folder / "doctrees"), ".", str(folder / "html")],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | {"RADEN_TORCH_DOCS_NOTEBOOKS": "off"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder / "html"


def test_every_page_and_notebook_is_there(site: Path) -> None:
    sources = [*PROJECT.glob("docs/*.md"), *PROJECT.glob("docs/decisions/*.md")]
    sources += [*PROJECT.glob("notebooks/*.ipynb"), *PROJECT.glob("README*.md")]
    pages = [source.relative_to(PROJECT).with_suffix(".html") for source in sources]
    assert len(pages) > 60
    assert not [page for page in pages if not (site / page).is_file()]


def test_the_reference_has_every_public_name_and_command(site: Path) -> None:
    page = (site / "docs/site/reference.html").read_text("utf-8")
    assert not [name for name in rt.__all__ if f'id="raden_torch.{name}"' not in page]
    assert re.search(r"<p>Fit the model of Take \(2012\) to a measurement\.</p>", page)
    commands = (site / "docs/site/commands.html").read_text("utf-8")
    assert all(f"raden {name}" in commands for name in ("fit", "render", "scan", "capture brdf"))


def test_it_loads_nothing_from_elsewhere(site: Path) -> None:
    """Links may lead out of the site; scripts, styles, fonts and pictures are in it."""
    loaded = re.compile(
        r"<(?:script|img|iframe|source)[^>]*\ssrc=[\"'](?:https?:)?//[^\"']*"
        r"|<link[^>]*\shref=[\"'](?:https?:)?//[^\"']*"
    )
    in_styles = re.compile(r"(?:@import|url\()\s*[\"']?(?:https?:)?//[^\s\"')]*")
    found = [
        hit for page in site.rglob("*.html") for hit in loaded.findall(page.read_text("utf-8"))
    ]
    for style in site.rglob("*.css"):
        found += in_styles.findall(style.read_text("utf-8"))
    assert len(list(site.rglob("*.css"))) > 2
    assert found == []


def test_links_out_of_the_site_are_whole(site: Path) -> None:
    """They are not fetched here; `make links` does that."""
    pattern = re.compile(r'<a class="reference external" href="([^"]+)"')
    links = {link for page in site.rglob("*.html") for link in pattern.findall(page.read_text())}
    assert links
    assert not [link for link in links if not re.fullmatch(r"https://[\w.-]+\.[a-z]+/\S*", link)]
