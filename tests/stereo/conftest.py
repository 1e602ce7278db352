"""A simulated sphere of shell for all tests here."""

import pytest

from tests.stereo.scenes import Scene, lamps_around, photographed, shell, sphere


@pytest.fixture(scope="session")
def scene() -> Scene:
    """A sphere of the analytic shell under 10 lamps."""
    normal, mask = sphere(40)
    lamps = lamps_around(10)
    return Scene(photographed(normal, mask, lamps, shell), lamps, normal, mask)
