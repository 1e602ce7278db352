"""The channels of a measurement, or of a model, as another format has room for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import ONE_BAND
from raden_torch.capture.exchange.formats import Format
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.colour_conversion import xyz_of_f_r
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB, XYZ

_LUMINANCE = "Y"
_USUAL = Metadata()


def in_colours_of(
    measurement: BrdfMeasurement, wanted: Format, channel: str | None
) -> tuple[BrdfMeasurement, list[str]]:
    """The measurement in channels that a format holds, and what that lost, a phrase each.

    Args:
        channel: the one to keep, as "Y", "R" or "550nm"; None keeps as much as there is room for,
            Y where that is one channel.

    Raises:
        InputError: a channel that is not there; bands that make no colour for a format that holds
            one channel or a colour.
    """
    m = measurement
    if channel is not None:
        return _picked(m, channel, wanted)
    if m.is_spectral:
        return _of_bands(m, wanted)
    if wanted.xyz and not (wanted.rgb and m.channels == RGB):
        return _as_d65(m)
    if wanted.rgb:
        return m.as_rgb(), []
    return _picked(m, _LUMINANCE, wanted)


def channels_for(wanted: Format, channel: str | None) -> tuple[str, ...]:
    """The channels of a model's values in a format."""
    if channel is not None and not (wanted.rgb and not wanted.one):
        return ONE_BAND
    return XYZ if wanted.xyz else RGB if wanted.rgb else ONE_BAND


def of_model(f_r: Floats, channels: tuple[str, ...], channel: str | None) -> Floats:
    """Linear RGB f_r `[M, 3]` in 1/sr → reflectance factors `[M, C]` of `channels_for`.

    Raises:
        InputError: a model has no such channel.
    """
    if channel is not None and channel not in (*XYZ, *RGB):
        raise InputError(f"channel: expected X, Y, Z, R, G or B of a model, got {channel!r}")
    if channels == RGB and channel is None:
        return f_r * FACTOR_PER_SR
    if channels == XYZ:
        return xyz_of_f_r(f_r)
    one = (
        FACTOR_PER_SR * f_r[:, [RGB.index(channel)]]
        if channel in RGB
        else xyz_of_f_r(f_r)[:, [XYZ.index(channel or _LUMINANCE)]]
    )
    return np.repeat(one, len(channels), axis=1)


def _of_bands(m: BrdfMeasurement, wanted: Format) -> tuple[BrdfMeasurement, list[str]]:
    if wanted.bands:
        return m, []
    if len(m.channels) == 1:
        return (m, []) if wanted.one else _grey(m, "grey: one band")
    if not m.has_colour:
        raise InputError(
            f"measurement: {len(m.channels)} bands that make no colour: expected `channel`, one of "
            f"{', '.join(m.channels[:8])}, for {wanted.title}, got none"
        )
    lost = f"the spectrum of {len(m.channels)} bands"
    if wanted.xyz or wanted.rgb:
        return (_as_d65(m)[0] if wanted.xyz else m.as_rgb()), [f"{lost} (its colour is kept)"]
    return _picked(m, _LUMINANCE, wanted)


def _as_d65(m: BrdfMeasurement) -> tuple[BrdfMeasurement, list[str]]:
    """XYZ under D65 for the 2° observer, which files without a white are taken for."""
    about = m.metadata
    usual = replace(about, white=_USUAL.white, observer=_USUAL.observer)
    if about == usual:
        return m.as_xyz(), []
    adapted = replace(m.as_rgb(), metadata=usual).as_xyz()
    return adapted, [f"white {about.white}, {about.observer} (adapted to D65 by Bradford)"]


def _picked(m: BrdfMeasurement, channel: str, wanted: Format) -> tuple[BrdfMeasurement, list[str]]:
    others = [name for name in m.channels if name != channel]
    if channel in m.channels:
        source = m
    elif channel in (*XYZ, *RGB) and m.has_colour:
        source, others = (m.as_xyz() if channel in XYZ else m.as_rgb()), list(m.channels)
    else:
        raise InputError(f"channel: expected one of {', '.join(m.channels[:8])}, got {channel!r}")
    at = source.channels.index(channel)
    name = (channel,) if source.is_spectral else ONE_BAND
    std = None if source.std is None else source.std[:, [at]]
    one = replace(source, values=source.values[:, [at]], std=std, channels=name)
    lost = [f"{', '.join(others[:6])}{', …' if len(others) > 6 else ''} (only {channel} is kept)"]
    if not wanted.one:
        return _grey(one, f"grey: {channel} alone")[0], lost if others else []
    return one, lost if others else []


def _grey(m: BrdfMeasurement, why: str) -> tuple[BrdfMeasurement, list[str]]:
    std = None if m.std is None else np.repeat(m.std, 3, axis=1)
    grey = replace(m, values=np.repeat(m.values, 3, axis=1), std=std, channels=RGB)
    return grey, [f"which wavelength it was ({why})"]
