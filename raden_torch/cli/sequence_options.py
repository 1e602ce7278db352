"""Options of commands that do many frames."""

from __future__ import annotations

from dataclasses import dataclass

from cyclopts import Group, Parameter

from raden_torch.cli.engine_options import ON_THIS_MACHINE, EngineOptions
from raden_torch.cli.option_types import Frames
from raden_torch.errors import InputError

_FRAMES = Group("Sequences", sort_key=4)


@Parameter(name="*", group=_FRAMES)
@dataclass(frozen=True)
class SequenceOptions:
    """Which frames, and what becomes of those that are there or missing."""

    frames: Frames = None
    """frames to do, as 1001-1240 or 1-10x2,15: names of files have a place for the number (####);
    of a scene also into a folder, or an .mp4, .webm or .webp"""
    force: bool = False
    """replace frames that are there; they are kept unless stated"""
    skip_missing: bool = False
    """leave out frames whose files are missing, rather than refuse them all"""
    json: bool = False
    """a line of JSON on stdout for each frame, for a farm"""
    where: EngineOptions = ON_THIS_MACHINE

    def __post_init__(self) -> None:
        for name in ("force", "skip_missing", "json"):
            if getattr(self, name) and self.frames is None:
                raise InputError(f"--{name.replace('_', '-')}: expected with --frames, got none")
        if self.where.engine != "local" and self.frames is None:
            raise InputError("--engine: expected with --frames, got none")
