"""The viewer in a real browser: its picture against `shade`, and what a person does with it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

import raden_torch as rt
from raden_torch.brdf.files.environment_file import load_environment
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError
from raden_torch.export.viewer_file import LARGEST_BYTES, export_viewer
from tests.export.browser import (
    LAMP,
    Browser,
    needs_browser,
    opened,
    pixels,
    sphere_by_shade,
)


@pytest.fixture(scope="module")
def shells() -> dict[str, rt.RadenBrdf]:
    fitted = {n: rt.fit(rt.simulate_specimen(n, step_deg=10)) for n in ("yakogai", "akoya")}
    return {name: result.model for name, result in fitted.items()}


@pytest.fixture(scope="module")
def page(shells, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "shell.html"
    export_viewer(shells["yakogai"], path)
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with opened() as shared:
        yield shared


@needs_browser
@pytest.mark.slow
def test_the_picture_is_shades_and_a_person_can_move_it(page, shells, browser, tmp_path):
    obj = tmp_path / "corner.obj"
    obj.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    first, turned, lit, keyed, nearer, plate, part, mesh = browser.visit(
        page,
        ("drag", 60, 20),
        ("key", "Shift+ArrowLeft"),
        ("key", "+"),
        ("key", "PageUp"),
        ("check", "shape", "plate"),
        ("check", "part", "1"),
        ("file", str(obj)),
    )
    assert first["label"] == "Simulated: yakogai is computed, not measured."
    assert first["aria"] == "sphere of yakogai; a lamp 25.8° to the right and 20.1° up"
    picture = pixels(first["picture"])
    wanted, inside = sphere_by_shade(shells["yakogai"], first["width"], first["height"])
    assert picture.shape == wanted.shape
    assert wanted[inside].max() == 255
    difference = abs(picture - wanted).max(axis=-1)[inside]
    assert np.percentile(difference, 99.5) <= 1
    assert difference.max() <= 4  # the mesh's facets, where the highlight is steepest
    angles = [float(word.rstrip("°")) for word in first["angles"][:3]]
    assert angles[0] + angles[1] == pytest.approx(
        math.degrees(math.asin(np.linalg.norm(LAMP[:2]))), abs=1
    )
    # a sphere looks the same when it is turned, but for its facets
    assert abs(pixels(turned["picture"]) - picture)[inside].max() <= 4
    moved = (turned, lit, keyed, nearer, plate, part, mesh)
    for before, after in pairwise(moved):
        assert abs(pixels(after["picture"]) - pixels(before["picture"])).max() > 8
    assert keyed["stops"] == "+0.2"
    assert mesh["state"] == "corner.obj: 4 triangles"


def write_room(path: Path) -> None:
    """A dim room with a coloured gradient, and a window of 60 times its light."""
    y, x = np.mgrid[0:48, 0:96] / 48
    room = 0.1 + 0.2 * np.stack([y, 1 - y, (1 + np.cos(np.pi * x)) / 2], -1)
    room[14:22, 30:40] = 8, 9, 12
    cv2.imwrite(str(path), room.astype(np.float32)[..., ::-1])


@needs_browser
@pytest.mark.slow
def test_surroundings_from_a_file_light_it_as_in_shade(page, shells, browser, tmp_path):
    write_room(tmp_path / "room.hdr")
    with_lamp, alone, turned, built_in = browser.visit(
        page,
        ("file", str(tmp_path / "room.hdr")),
        ("toggle", "#lit"),
        ("run", "rotation.value = 40; rotation.dispatchEvent(new Event('input'))"),
        ("check", "around", "studio"),
        scale=0.18,
    )[1:]
    assert with_lamp["state"] == "room.hdr: 96 x 48"
    assert (with_lamp["lamps"], alone["lamps"]) == (257, 256)
    for shown, lamps, rotation in (
        (with_lamp, [rt.DirectionalLight(LAMP)], 0.0),
        (alone, [], 0.0),
        (turned, [], 40.0),
    ):
        room = load_environment(tmp_path / "room.hdr", rotation_deg=rotation)
        every = type(room)(room.radiance, rotation, samples="all")
        wanted, inside = sphere_by_shade(
            shells["yakogai"],
            shown["width"],
            shown["height"],
            [every, *lamps],
            stops=shown["exposure"],
        )
        difference = abs(pixels(shown["picture"]) - wanted).max(axis=-1)[inside]
        assert wanted[inside].max() > 120
        assert np.percentile(difference, 99) <= 3
        assert difference.max() <= 6
    assert turned["rotation"] == 40
    assert abs(pixels(turned["picture"]) - pixels(alone["picture"])).max() > 40
    assert abs(pixels(built_in["picture"]) - pixels(turned["picture"])).max() > 40


@needs_browser
@pytest.mark.slow
def test_two_shells_at_a_phones_width_and_a_lost_device(shells, browser, tmp_path):
    page = tmp_path / "two.html"
    assert export_viewer(shells["yakogai"], page, compare=shells["akoya"]) < LARGEST_BYTES
    lose = "window.lost = picture.getContext('webgl2').getExtension('WEBGL_lose_context')"
    first, lost, back = browser.visit(
        page,
        ("run", f"{lose}; window.lost.loseContext()"),
        ("run", "window.lost.restoreContext()"),
        width=390,
    )
    assert first["wide"] <= 390
    picture, side = pixels(first["picture"]), first["width"]
    for name, half in (("yakogai", slice(0, side // 2)), ("akoya", slice(side // 2 + 1, None))):
        wanted, inside = sphere_by_shade(shells[name], side, first["height"])
        difference = abs(picture - wanted).max(axis=-1)[:, half][inside[:, half]]
        assert np.percentile(difference, 99) <= 1
    assert lost["state"].startswith("The graphics device was lost")
    assert back["state"] == ""
    assert abs(pixels(back["picture"]) - picture).max() == 0


@needs_browser
@pytest.mark.slow
def test_what_a_browser_lacks_is_said(page, shells, browser):
    (none,) = browser.visit(page, before="HTMLCanvasElement.prototype.getContext = () => null;")
    assert none["state"].startswith("This browser has no WebGL 2")
    small = (
        "const asked = WebGL2RenderingContext.prototype.getParameter;"
        "WebGL2RenderingContext.prototype.getParameter = function (name) {"
        "  return name === this.MAX_3D_TEXTURE_SIZE ? 64 : asked.call(this, name); };"
    )
    (refused,) = browser.visit(page, before=small)
    sides = max(shells["yakogai"].layout.shape)
    assert refused["state"] == (
        f"This device takes textures of 64 texels a side; the shell's table has {sides}."
    )
    # a driver that takes the nearest texel where it was asked to filter
    nearest = (
        "const given = WebGL2RenderingContext.prototype.texParameteri;"
        "WebGL2RenderingContext.prototype.texParameteri = function (target, name, value) {"
        "  given.call(this, target, name, value === this.LINEAR ? this.NEAREST : value); };"
    )
    (unfiltered,) = browser.visit(page, before=nearest)
    assert unfiltered["state"].startswith("This device does not filter half-float textures")
    wanted, inside = sphere_by_shade(shells["yakogai"], unfiltered["width"], unfiltered["height"])
    difference = abs(pixels(unfiltered["picture"]) - wanted).max(axis=-1)[inside]
    assert np.percentile(difference, 99.5) <= 1


@needs_browser
@pytest.mark.slow
def test_files_that_it_cannot_show_are_refused_in_one_line(page, browser, tmp_path):
    write_room(tmp_path / "room.hdr")
    whole = (tmp_path / "room.hdr").read_bytes()
    cv2.imwrite(str(tmp_path / "square.hdr"), np.ones((8, 8, 3), np.float32))
    damaged = {
        "notes.txt": (b"no mesh", "expected a mesh (.obj, .glb, .gltf) or surroundings (.hdr)"),
        "picture.hdr": (b"\x89PNG\r\n", "expected a Radiance picture, which begins with #?"),
        "cut.hdr": (whole[: len(whole) // 2], "the file is cut or damaged"),
        "square.hdr": ((tmp_path / "square.hdr").read_bytes(), "twice as wide as high"),
        "cut.gltf": (b'{"meshes": [', "got a damaged file"),
        "binary.glb": (b"\0" * 64, "expected a binary glTF"),
        "empty.obj": (b"v 0 0 0\n", "expected triangles, got none"),
    }
    for name, (data, _) in damaged.items():
        (tmp_path / name).write_bytes(data)
    first, *shown = browser.visit(page, *(("file", str(tmp_path / name)) for name in damaged))
    for (name, (_, message)), after in zip(damaged.items(), shown, strict=True):
        assert message in after["state"]
        assert name in after["state"]
        assert "\n" not in after["state"]
        assert after["picture"] == first["picture"]


def test_a_name_cannot_leave_its_element(shells, tmp_path):
    odd = rt.RadenBrdf(shells["akoya"].diffuse, shells["akoya"].table)
    odd.provenance = type(odd.provenance)(sample="</script><script>alert(1)</script>")
    export_viewer(odd, tmp_path / "odd.html")
    text = (tmp_path / "odd.html").read_text()
    assert "</script><script>alert" not in text
    assert text.count("<script") == 3


def test_what_does_not_fit_is_refused(shells, tmp_path):
    with pytest.raises(InputError, match=r"ends in \.html"):
        export_viewer(shells["akoya"], tmp_path / "page.htm")
    large = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
    large.layout = RuntimeLayout((32, 112, 112), (0.4, 0.4))
    with pytest.raises(InputError, match=r"expected a page of at most 3000000 bytes"):
        export_viewer(large, tmp_path / "page.html")
    assert not list(tmp_path.iterdir())
