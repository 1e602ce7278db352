"""`raden render scene.toml`: one picture, frames, or a moving one."""

from __future__ import annotations

from pathlib import Path

from raden_torch.cli.picture_options import DisplayOptions
from raden_torch.cli.sequence_options import SequenceOptions
from raden_torch.cli.sequence_run import run_frames
from raden_torch.cli.status import progress, working
from raden_torch.errors import InputError
from raden_torch.files import check_output
from raden_torch.scene.animation import MOVING, render_moving
from raden_torch.scene.scene import Scene
from raden_torch.sequences.plan import target_pattern
from raden_torch.sequences.scene_job import SceneJob, plan_scene

_MEMORY = 4 * 1024**3
"""For pictures that wait to be written."""


def render_scene(
    path: Path,
    output: Path,
    display: DisplayOptions,
    size: int | None,
    samples: int | None,
    sequence: SequenceOptions,
    *,
    is_plain: bool,
) -> None:
    """Args: is_plain: nothing was said that a scene file says itself."""
    if not is_plain:
        raise InputError(
            f"{path}: a scene has its own lights, camera and surfaces; beside it come "
            "`output`, `size`, `samples`, `frames`, `force`, `json` and the options of the picture"
        )
    scene = Scene.read(path, width=size, samples=samples)
    shown_by = display.over(scene.display)
    if sequence.frames is None:
        shown_by.check_path(output)
        check_output(output, inputs=(path, *scene.files))
        with working("rendering"):
            stops = shown_by.write(scene.frame(), output, scene.caption)
        print(f"wrote {output} (exposure {stops:+.2f} stops)")
        return
    if sequence.skip_missing:
        raise InputError(
            f"{path}: --skip-missing: expected frames with files of their own, got none"
        )
    if sequence.frames[0] < 1:
        raise InputError(f"{path}: `frames`: expected frames from 1, got {sequence.frames[0]}")
    if output.suffix.lower() in MOVING and not output.is_dir():
        if sequence.force or sequence.json or sequence.where.engine != "local":
            raise InputError(
                f"{output}: expected frames in files of their own with --force, --json or "
                "--engine, got one file"
            )
        with progress("rendering") as shown:
            render_moving(scene, sequence.frames, output, shown_by, shown=shown)
        print(f"wrote {output} ({len(sequence.frames)} frames)")
        return
    job = SceneJob(
        target=target_pattern(output, "frame_####.png"),
        force=sequence.force,
        scene=path,
        display=shown_by,
        width=size,
        samples=samples,
    )
    with working("looking at the first frame"):
        job, frames = plan_scene(job, scene, sequence.frames)
    run_frames(job, frames, sequence, _MEMORY, scene)
