"""Options of the commands that make pictures."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from raden_torch.cli.option_types import Bytes, Exposed, Pairs, Triple
from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.brdf.files.display import Display
    from raden_torch.brdf.files.gbuffer_reading import GBufferReading
    from raden_torch.brdf.files.shade_file import Shadowed
    from raden_torch.brdf.shading.lights import Light
    from raden_torch.sequences.lighting import Lighting

_PICTURE = Group("The picture", sort_key=2)
_EXR_FILES = Group("EXR files", sort_key=3)


@Parameter(name="*", group=_PICTURE)
@dataclass(frozen=True)
class DisplayOptions:
    """How scene-linear light becomes a picture: the fields of `Display`."""

    exposure: Exposed = "auto"
    """exposure in stops; auto brings the highlights, key the mean luminance to their place"""
    tone: Literal["srgb", "neutral", "aces"] = "srgb"
    """the curve: srgb has none; neutral (Khronos) and aces (Narkowicz) roll highlights off"""
    gamut: Literal["hue", "clip"] = "hue"
    """colours that the display cannot show keep their hue and lightness, or are cut by channel"""
    colour_space: Literal["srgb", "display-p3", "acescg"] = "srgb"
    """the file's primaries; acescg for an .exr, which is linear in all of them"""

    @property
    def display(self) -> Display:
        """The same for the library."""
        from raden_torch.brdf.files.display import Display

        return Display(self.exposure, self.tone, self.gamut, self.colour_space)

    def over(self, display: Display) -> Display:
        """A scene's own, but for what is asked for here."""
        usual = DisplayOptions()
        asked = {k: v for k, v in vars(self).items() if v != getattr(usual, k)}
        return replace(display, **asked)


@Parameter(name="*", group=_PICTURE)
@dataclass(frozen=True)
class RelitDisplayOptions(DisplayOptions):
    """How new light joins a photograph."""

    exposure: Exposed = "auto"
    """exposure of the masked part in stops; auto keeps its mean luminance, key brings it to 0.18"""


@Parameter(name="*", group=_EXR_FILES)
@dataclass(frozen=True)
class ExrOptions:
    """What an EXR's depth and normals are: fields are named as the library's readers name them."""

    fov_deg: float | None = None
    """horizontal field of view of the camera of an EXR with depth, degrees"""
    depth: str | None = None
    """what the depth of the EXR is: planar (along the camera's axis), distance (along the pixel's
    ray), negative (z of a camera that looks along −z), or by renderer: blender, karma, mitsuba;
    planar unless stated"""
    xyz: Annotated[str, Parameter(name="--normal-xyz")] = "r,g,b"
    """the normals' channels that hold x,y,z (right, up, to the viewer), with a minus where one
    points the other way: b,g,r or =r,-g,-b"""

    tangent: Triple | None = None
    """of a model of several sample azimuths: the direction x,y,z of azimuth 0, of which the part in
    the surface counts; by default the layer "tangent" of the G-buffer, else the azimuths' mean"""
    material: Path | None = None
    """which material of a palette each pixel shows: an .exr, or a PNG of indices from 0; by default
    the layer "material" of the G-buffer"""

    @property
    def reading(self) -> GBufferReading:
        """The same for the library."""
        from raden_torch.brdf.files.gbuffer_reading import GBufferReading

        return GBufferReading(**self._fields)

    @property
    def _fields(self) -> dict[str, Any]:
        own = {"fov_deg": self.fov_deg, "depth": self.depth, "xyz": self.xyz}
        return {**own, "material": self.material, "tangent": self.tangent}


@Parameter(name="*", group=_EXR_FILES)
@dataclass(frozen=True)
class GBufferOptions(ExrOptions):
    """How an EXR is read as a G-buffer, and lit."""

    preset: str | None = None
    """the renderer that wrote the EXR: arnold, blender, karma, mitsuba, unreal or vray; the options
    beside it come first"""
    space: Literal["camera", "world", "tangent"] | None = None
    """the space of the normals; camera unless stated. With world, --light and --camera are in the
    renderer's world, too"""
    position_space: Literal["camera", "world"] | None = None
    """the space of the positions; that of the normals unless stated"""
    world: Literal["y-up", "z-up", "unreal"] | None = None
    """which way the renderer's world points; y-up unless stated"""
    camera_file: Path | None = None
    """JSON with camera_to_world, or position and target, and fov_deg; the EXR's own header unless
    given"""
    channels: Annotated[Pairs, Parameter(name="--channel")] = ()
    """channels of the EXR, as normal=N, depth=Z or material=IndexMA; may be repeated"""
    smooth_px: float = 0.0
    """smooth the EXR's depth over this many pixels"""
    tolerance: float = 0.0
    """for an EXR: the largest error of a pixel's radiance that is accepted to save time"""
    memory: Bytes = 4 * 1024**3
    """for an EXR lit into an .exr: shade it in bands within this much memory; for --frames: that of
    all frames under way"""
    shadows: bool = False
    """what the EXR shows casts shadows of the lamps; needs positions and their --camera, or depth
    and --fov"""
    thickness: float | None = None
    """for --shadows: how deep a visible surface is, in the unit of the positions; a tenth of the
    median distance unless stated"""

    def __post_init__(self) -> None:
        if self.thickness is not None and not self.shadows:
            raise InputError("--thickness: expected with --shadows, whose occluders it describes")

    def check_without_gbuffer(self) -> None:
        """Refuse what describes the pixels of a G-buffer where there is none."""
        if self.material is not None:
            raise InputError("--material: expected with --gbuffer, whose pixels it describes")
        if self.shadows:
            raise InputError("--shadows: expected with --gbuffer, whose surfaces cast them")
        frame = ("preset", "space", "position_space", "world", "camera_file")
        given = [name for name in frame if getattr(self, name) is not None]
        if given:
            option = given[0].replace("_", "-")
            raise InputError(f"--{option}: expected with --gbuffer, whose vectors it describes")
        for field in fields(self):
            if field.name != "tangent" and getattr(self, field.name) != field.default:
                raise InputError(f"`{field.name}`: expected with --gbuffer, which it describes")

    @property
    def shadowed(self) -> Shadowed | None:
        """What gives lights their shadows, where they are asked for."""
        if not self.shadows:
            return None
        from raden_torch.brdf.shading.screen_shadows import with_screen_shadows

        return partial(with_screen_shadows, thickness=self.thickness)

    @property
    def _fields(self) -> dict[str, Any]:
        from raden_torch.brdf.files.renderer_presets import preset

        frame = ("depth", "space", "position_space", "world", "camera_file")
        given = {k: v for k in frame if (v := getattr(self, k)) is not None}
        known = {} if self.preset is None else preset(self.preset)
        channels = dict(self.channels)
        own = {**super()._fields, "channels": channels, "smooth_px": self.smooth_px}
        return {**own, **known, **given}


@Parameter(name="*")
@dataclass(frozen=True)
class SpectrumOptions:
    """Of a spectral model: the light's spectrum, and the eye that sees it."""

    illuminant: str | None = None
    """the spectrum of all lights, of a model of `raden fit --spectral`: A, D65, FL11, LED-B3, …; or
    a .csv with the columns wavelength_nm and power; D65 unless stated"""
    white: str | None = None
    """the illuminant that the eye is adapted to; that of the lights unless stated; D65 adapts
    nothing"""

    @property
    def files(self) -> tuple[Path, ...]:
        """What is read of them."""
        given = (Path(name) for name in (self.illuminant, self.white) if name is not None)
        return tuple(path for path in given if path.suffix)


@Parameter(name="*")
@dataclass(frozen=True)
class EnvironmentOptions:
    """What surrounds the scene; beside --light, or instead of it."""

    environment: Path | None = None
    """a lat-long map of the surroundings, .hdr or .exr: first row up, middle column away from the
    viewer"""
    rotate_environment: float = 0.0
    """turn it by this many degrees about the vertical, counter-clockwise from above"""
    environment_intensity: float = 1.0
    """multiply it"""
    light_setup: Literal["tent", "window", "softbox"] | None = None
    """instead of --environment: lights as a photographer sets them up for lacquer"""

    def __post_init__(self) -> None:
        if self.environment is not None and self.light_setup is not None:
            raise InputError("--environment and --light-setup both surround the scene; give one")

    @property
    def lighting(self) -> Lighting:
        """The same for the library, without lamps."""
        from raden_torch.sequences.lighting import Lighting

        return Lighting(
            environment=self.environment,
            light_setup=self.light_setup,
            rotation_deg=self.rotate_environment,
            intensity=self.environment_intensity,
        )

    def lights(self) -> list[Light]:
        """None, or one."""
        return self.lighting.surroundings()
