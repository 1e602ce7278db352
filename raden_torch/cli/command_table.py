"""The `raden` command's contents: each subcommand's name, summary, example, and where it stands.

A subcommand's module is imported when that subcommand runs, or shows its own help: none is for
`raden --help`. What options look like on the command line is decided here, once for all of them.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

from cyclopts import App, Group, Parameter

from raden_torch.cli.option_names import option_name
from raden_torch.cli.option_types import read_value

if TYPE_CHECKING:
    from cyclopts.help import DefaultFormatter, HelpPanel
    from rich.console import Console, ConsoleOptions


def _version() -> str:
    from importlib.metadata import version

    return f"raden {version('raden_torch')}"


def _shown_default(value: Any) -> Any:
    """What help says of a default: nothing where the option is simply not given."""
    return None if value is None or value is False or value in ((), "") else value


class _HelpFormatter:
    """cyclopts' own form, where the lines of a docstring are one paragraph."""

    @cached_property
    def _own(self) -> DefaultFormatter:
        from cyclopts.help import DefaultFormatter  # 20 ms, when help is shown

        return DefaultFormatter()

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        for entry in panel.entries:
            text = entry.description.primary_renderable
            entry.description.primary_renderable = type(text)(" ".join(text.plain.split()))
        self._own(console, options, panel)

    def render_usage(self, console: Console, options: ConsoleOptions, usage: Any) -> None:
        self._own.render_usage(console, options, usage)

    def render_description(self, console: Console, options: ConsoleOptions, text: Any) -> None:
        self._own.render_description(console, options, text)


_EVERYWHERE = """\
With every command: --quiet (-q) prints warnings and errors alone where the command writes files; \
--verbose prints each step with its time, and where an error came from. An older output file is \
replaced, unless the command reads it; frames and folders of models are kept without --force.

Exit codes: 0 done; 1 a fault in raden; 2 wrong input, or a place that cannot be written; 3 not \
all is done, as of frames or a scan that stopped; 128 + n stopped by signal n (130: Ctrl-C)."""

app = App(
    name="raden",
    help="Measure how mother-of-pearl reflects, keep it as a small model, light images with it.",
    help_epilogue=_EVERYWHERE,
    help_format="plaintext",
    help_formatter=_HelpFormatter(),
    group_arguments=Group("Arguments", sort_key=0),
    group_parameters=Group("Options", sort_key=1),
    version=_version,
    default_parameter=Parameter(
        name_transform=option_name,
        negative=(),
        converter=read_value,
        json_dict=False,
        json_list=False,
        show_default=_shown_default,
        allow_leading_hyphen=True,  # --light -1,0,1
        allow_repeating=True,  # the last one counts, or all of them where the option is a list
    ),
    print_error=False,
    exit_on_error=False,
)
capture = App(
    name="capture",
    help="From photographs: the camera, its colour, the light and the normals.",
    sort_key=100,
)
catalogue = App(
    name="catalogue",
    help="Thousands of shells in one folder: add them, find them by colour and angle.",
    sort_key=101,
)

_COMMANDS = (
    (
        "model_commands:fit",
        "Fit a model to a measurement, a palette to several of one shell, or a folder of models.",
        "raden fit shell.csv -o shell.safetensors; raden fit shells/*.csv -o models/",
    ),
    (
        "file_commands:info",
        "Say what a file holds; compare two measurements; score a model on other readings.",
        "raden info scan.csv photographs.csv",
    ),
    (
        "analyse_command:analyse",
        "Estimate the thickness of nacre's tablets and its spread from how the colour changes.",
        "raden analyse shell.csv --json",
    ),
    (
        "file_commands:merge",
        "Make one measurement of several, each reading weighed by its uncertainty.",
        "raden merge scan.csv photographs.csv -o shell.csv",
    ),
    (
        "convert_command:convert",
        "Write a measurement or a model in another program's format, and say what was lost.",
        "raden convert shell.csv shell.binary; raden convert gold.binary gold.bsdf --to zemax; "
        "raden convert shell.safetensors shell.anisotropicbsdf --step 2.5",
    ),
    (
        "file_commands:plot",
        "Draw the paper's graphs of a measurement or a model; or where two measurements differ.",
        "raden plot shell.csv -o graphs.png --figure 5 --figure 9",
    ),
    (
        "export_commands:export",
        "Write a model as an ONNX shader for other programs, checked in ONNX Runtime.",
        "raden export shell.safetensors -o shell.onnx --profile scene",
    ),
    (
        "export_commands:verify",
        "Check an exported shader in every runtime on this machine.",
        "raden verify shell.onnx",
    ),
    (
        "model_commands:bench",
        "Run time against error, of every form of the model and every backend.",
        "raden bench --out bench",
    ),
    (
        "picture_commands:render",
        "Light a shape, an EXR G-buffer, or a sequence of them, with a model; render a scene file.",
        "raden render shell.safetensors --light 1,1,2 -o sphere.png",
    ),
    (
        "relight_command:relight",
        "Relight the masked part of photographs, or of a sequence; the rest of them is kept.",
        "raden relight box.png --normals n.png --mask m.png --model shell.safetensors "
        "--light 1,1,2 -o relit.png",
    ),
    (
        "sweep_command:sweep",
        "Run a command once for each row of a table of its options, into a folder.",
        "raden sweep lights.csv -o lit -- render shell.safetensors --size 256",
    ),
    (
        "picture_commands:demo",
        "Simulate a shell, fit a model to it, light it, and show all of it on a page.",
        "raden demo --out demo",
    ),
    (
        "scan_command:scan",
        "Measure a sample with a goniospectrometer, from its plan to a measurement file.",
        "raden scan --config rig.toml --sample yakogai -o shell.csv",
    ),
)
_CAPTURE_COMMANDS = (
    (
        "capture_commands:calibrate",
        "Calibrate a camera on photographs of a ChArUco board; where does the board lie?",
        "raden capture calibrate board*.jpg --squares 5x7 --square 0.04 --marker 0.02 "
        "-o camera.json",
    ),
    (
        "capture_commands:colour",
        "Fit the map from a camera's RGB to XYZ on photographs of a colour chart.",
        "raden capture colour chart.tif --coded linear -o colour.json",
    ),
    (
        "capture_commands:lights",
        "Find the directions to the lamps (or their places) in photographs of a chrome ball.",
        "raden capture lights chrome1.png chrome2.png chrome3.png --mask ball.png -o lights.json",
    ),
    (
        "capture_commands:normals",
        "Solve normals, albedo and confidence from photographs under known lamps.",
        "raden capture normals box1.png box2.png box3.png box4.png --lights lights.json "
        "--mask box.png -o box",
    ),
    (
        "capture_brdf_command:brdf",
        "Measure a BRDF: every lit pixel of a sphere, plane or cylinder is a reading.",
        "raden capture brdf lamp*.tif --shape sphere --mask sample.png --lights lights.json "
        "--white-mask white.png --white-factor 98.5 -o shell.csv",
    ),
    (
        "guide_command:guide",
        "Say where lamp and camera should stand next, for a flat, bent or convex piece.",
        "raden capture guide --size 100x80 --count 40 --assume isotropic+reciprocal -o plan.json "
        "-o plan.png",
    ),
    (
        "handheld_command:handheld",
        "Choose pictures of a phone's video or stills; find their camera, lamp and tone curve.",
        "raden capture handheld walk.mp4 --squares 11x9 --square 0.016 --marker 0.012 "
        "--region '0.05,0.04 0.11,0.04 0.11,0.10 0.05,0.10' "
        "--white-region '0.13,0.04 0.15,0.04 0.15,0.06 0.13,0.06' --ball 0.03,0.12,8 -o walk",
    ),
    (
        "segment_command:segment",
        "Propose which pixels of a photographed inlay show which shell: a palette's map.",
        "raden capture segment lamp*.png --shells 3 -o map.png",
    ),
    (
        "texture_command:texture",
        "Find each piece's shell and how its layers lean: a palette and a G-buffer to relight.",
        "raden capture texture lamp*.tif --lights lights.json --model yakogai.safetensors "
        "--model awabi.safetensors -o inlay; --shells 2 for the models learns two shells from the "
        "photographs",
    ),
    (
        "batch.photo_sets:batch",
        "Take the steps above for every photograph set of a folder, with one report.",
        "raden capture batch shells; shells/defaults.toml and shells/*/set.toml say which steps",
    ),
    (
        "simulated_photographs_command:simulate",
        "Photograph a simulated specimen by Mitsuba 3, with everything that is true of it beside.",
        "raden capture simulate --material yakogai -o photographs",
    ),
)
_CATALOGUE_COMMANDS = (
    (
        "catalogue_commands:add",
        "Add measurements and models, each kept byte for byte; make the catalogue if need be.",
        "raden catalogue add shells yakogai*.csv --tag Tokyo",
    ),
    (
        "catalogue_commands:find",
        "Rank the shells by a colour at an angle, as the greenest at 40 degrees.",
        "raden catalogue find shells --colour green --at 40 --sheet greenest.png",
    ),
    (
        "catalogued_shell_commands:show",
        "Say where a shell came from, how it was fitted, and its colours over the angles.",
        "raden catalogue show shells 4c6997",
    ),
    (
        "catalogued_shell_commands:get",
        "Write a shell's file as it was added, byte for byte.",
        "raden catalogue get shells 4c6997 -o shell.csv",
    ),
    (
        "catalogued_shell_commands:check",
        "Read every shell's file and compare it with its SHA-256.",
        "raden catalogue check shells",
    ),
)

app.command(capture)
app.command(catalogue)
app.register_install_completion_command(
    help="Install completion of commands and options for bash, zsh, fish or PowerShell."
)
for group, commands in (
    (app, _COMMANDS),
    (capture, _CAPTURE_COMMANDS),
    (catalogue, _CATALOGUE_COMMANDS),
):
    for place, (where, summary, example) in enumerate(commands):
        group.command(
            f"raden_torch.cli.{where}",
            name=where.partition(":")[2],
            help=summary,
            help_epilogue=f"Example: {example}",
            sort_key=place,
        )
