"""The viewer for everyone: a headset's two eyes, keyboard, fingers, screen readers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import raden_torch as rt
from raden_torch.export.viewer_file import export_viewer
from tests.export.browser import (
    LAMP,
    MODULES,
    Browser,
    needs_browser,
    opened,
    pixels,
    sphere_by_shade,
)

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def shell() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("akoya", step_deg=17.5)).model


@pytest.fixture(scope="module")
def page(shell, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "shell.html"
    export_viewer(shell, path)
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with opened() as shared:
        yield shared


def test_each_eye_sees_shades_picture_and_the_trigger_holds_the_lamp(page, shell, browser):
    headset = Path(__file__).with_name("headset.js").read_text()
    first, entered, held, left = browser.visit(
        page,
        ("toggle", "#headset"),
        ("run", "session.select('selectstart', [-0.4, 0.25, -0.1])"),
        ("run", "session.select('selectend'); session.end()"),
        before=headset,
        scale=0.6,
    )
    assert first["headset"]
    place, radius = np.array([0.0, -0.15, -0.7]), 0.2
    hand = tuple(np.array([-0.4, 0.25, -0.1]) - place)
    for shown, lamp in ((entered, LAMP), (held, hand)):
        picture = pixels(shown["picture"])
        middle = picture.shape[1] // 2
        for x, seen in ((-0.03, picture[:, :middle]), (0.03, picture[:, middle:])):
            eye = tuple((np.array([x, 0.0, 0.0]) - place) / radius)
            wanted, inside = sphere_by_shade(
                shell,
                seen.shape[1],
                seen.shape[0],
                rt.DirectionalLight(lamp),
                eye=eye,
                half=(0.5, 0.6),
            )
            assert inside.mean() > 0.1
            difference = abs(seen - wanted).max(axis=-1)[inside]
            assert np.percentile(difference, 99) <= 2
        assert abs(picture[:, :middle] - picture[:, middle:]).max() > 20
    # back on the page, the lamp stays where it was put
    assert left["state"] == ""
    assert abs(pixels(left["picture"]) - pixels(first["picture"])).max() > 20


def test_without_a_headset_there_is_no_button(page, browser):
    (first,) = browser.visit(page, before="Object.defineProperty(navigator, 'xr', {value: null})")
    assert not first["headset"]


def test_the_keyboard_does_what_the_mouse_does(page, browser):
    first, *seen = browser.visit(
        page,
        ("check", "drag", "point"),
        ("key", "ArrowRight"),
        ("check", "drag", "lamp"),
        ("key", "ArrowRight"),
        ("check", "drag", "surroundings"),
        ("key", "ArrowRight"),
        ("check", "around", "studio"),
        ("key", "ArrowRight"),
        scale=0.18,
    )
    assert seen[1]["angles"] != first["angles"]
    assert seen[1]["picture"] == first["picture"]
    assert seen[3]["aria"].startswith("sphere of akoya; a lamp 29.2° to the right")
    assert [round(one["rotation"]) for one in (seen[4], seen[5], seen[7])] == [0, 3, 7]
    assert seen[7]["aria"].endswith("surroundings: studio")
    assert abs(pixels(seen[7]["picture"]) - pixels(seen[6]["picture"])).max() > 2
    # everything that can be used is reached by Tab, and shows that it is
    reached = (
        "[...document.querySelectorAll('canvas[tabindex], input, button')].filter((e) =>"
        " e.offsetParent && e.tabIndex < 0).map((e) => e.id)"
    )
    browser.visit(page, ("run", reached))
    assert browser.replies == [[]]


def test_two_fingers_zoom_and_one_turns(page, browser):
    finger = (
        "(kind, id, x, y) => picture.dispatchEvent(new PointerEvent(kind, {pointerId: id,"
        " pointerType: 'touch', bubbles: true, clientX: x, clientY: y}))"
    )
    begin = f"picture.setPointerCapture = null; window.finger = {finger};"
    pinch = (
        "finger('pointerdown', 1, 150, 200); finger('pointerdown', 2, 250, 200);"
        "finger('pointermove', 1, 100, 200); finger('pointermove', 2, 300, 200);"
        "finger('pointerup', 1, 100, 200); finger('pointerup', 2, 300, 200)"
    )
    first, _, near = browser.visit(page, ("run", begin), ("run", pinch))
    lit = [(pixels(one["picture"]).sum(-1) > 12).mean() for one in (first, near)]
    assert lit[1] > 1.25 * lit[0]
    assert near["angles"] != first["angles"]


@pytest.mark.skipif(
    not (MODULES / "axe-core/axe.min.js").is_file(),
    reason="axe-core is not installed; make runtimes",
)
@pytest.mark.parametrize("width", [1000, 390])
def test_axe_finds_nothing(page, browser, width):
    browser.visit(page, ("axe",), width=width, scale=0.1)
    assert browser.replies == [[]]


def test_names_for_screen_readers(page, browser):
    unnamed = (
        "[...document.querySelectorAll('input, button, canvas, section, fieldset')].filter((e) =>"
        " !(e.ariaLabel || e.labels?.[0]?.innerText.trim() || e.textContent.trim() || e.hidden))"
        ".map((e) => e.outerHTML)"
    )
    browser.visit(page, ("run", unnamed))
    assert browser.replies == [[]]
