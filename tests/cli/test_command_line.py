"""Every subcommand's options, as its dataclasses say them: help, values, and what is refused."""

from __future__ import annotations

import ast
import dataclasses
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from cyclopts import App
from rich.console import Console

import raden_torch.cli
from raden_torch.cli.command_table import app
from raden_torch.cli.option_names import options_of

Command = Callable[..., subprocess.CompletedProcess[str]]

GROUPS = ((), ("capture",), ("catalogue",))


def commands() -> list[tuple[str, ...]]:
    """The words of each subcommand."""
    found: list[tuple[str, ...]] = []
    for group in GROUPS:
        parent: App = app
        for word in group:
            parent = parent[word]
        found += [(*group, name) for name in parent if not name.startswith("-")]
    return [words for words in found if words not in GROUPS]


COMMANDS = commands()


def subcommand(words: tuple[str, ...]) -> App:
    return app.parse_commands(words)[1][-1]


def parsed(*words: str) -> dict[str, Any]:
    """What a subcommand is called with."""
    return dict(app.parse_args(words)[1].arguments)


def fields_of(group: Any) -> Iterator[str]:
    """Their names; those of a group in a group are its own."""
    for field in dataclasses.fields(group):
        if dataclasses.is_dataclass(field.default):
            yield from fields_of(field.default)
        else:
            yield field.name


def test_all_commands_are_here() -> None:
    one = [words[0] for words in COMMANDS if len(words) == 1]
    assert " ".join(one) == (
        "fit info analyse merge convert plot export verify bench render relight sweep demo scan"
    )
    steps = [" ".join(words) for words in COMMANDS if len(words) == 2]
    capture = ["calibrate", "colour", "lights", "normals", "brdf", "guide"]
    capture += ["handheld", "segment", "texture", "batch", "simulate"]
    catalogue = ["add", "find", "show", "get", "check"]
    assert steps == [f"capture {x}" for x in capture] + [f"catalogue {x}" for x in catalogue]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_lists_every_field_and_an_example(
    raden: Command, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.setattr(app, "console", Console(width=200))  # the app's own is kept as it began
    done = raden(*words, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    shown = " ".join(done.stdout.replace("│", " ").split())
    assert f"Example: raden {' '.join(words)} " in shown
    command = subcommand(words)
    assert command.default_command is not None
    hints = get_type_hints(command.default_command)
    groups = [hint for hint in hints.values() if dataclasses.is_dataclass(hint)]
    options = options_of(app, words)
    for group in groups:
        for name in fields_of(group):
            assert f"{options[name]} " in shown
    with app.app_stack(words):
        arguments = command.assemble_argument_collection(parse_docstring=True)
    said = [argument for argument in arguments if argument.show and not argument.children]
    assert {argument.name for argument in said} >= set(options.values())
    for argument in said:
        assert argument.parameter.help, argument.name
        assert " ".join(argument.parameter.help.split()) in shown
        assert all(name in shown for name in argument.names)


def test_help_names_every_command(raden: Command) -> None:
    for words, code in (("--help",), 0), (("-h",), 0), ((), 2):
        done = raden(*words)
        assert (done.returncode, done.stderr) == (code, "")
        assert all(f"│ {name} " in done.stdout for name, *step in COMMANDS if not step)
    for group in ("capture", "catalogue"):
        for words, code in ((group, "-h"), 0), ((group,), 2):
            done = raden(*words)
            assert (done.returncode, done.stderr) == (code, "")
            steps = [step[0] for name, *step in COMMANDS if step and name == group]
            assert all(f"│ {step} " in done.stdout for step in steps)


@pytest.mark.parametrize("words", [("--help",), ("capture", "--help"), ("render", "--help")])
def test_help_imports_nothing_heavy(words: tuple[str, ...]) -> None:
    code = (
        "import sys\nfrom raden_torch.cli import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "print(sorted({'torch', 'numpy', 'cv2', 'scipy', 'OpenImageIO'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=True
    )
    assert done.stdout.endswith("\n[]\n")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk to write to")
@pytest.mark.parametrize("words", [("--help",), ("fit", "-h"), ("--version",)])
def test_help_onto_a_full_disk(words: tuple[str, ...]) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "raden_torch.cli", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 2
    assert done.stderr == "raden: output: No space left on device\n"


BRDF = ("capture", "brdf", "--lights", "l.json", "--shape", "sphere", "-o", "x.csv")
CALIBRATE = ("capture", "calibrate", "a.png", "--square", "1", "--marker", "0.5", "-o", "x.json")
RELIGHT = ("relight", "p.png", "--normals", "n.png", "--model", "m", "-o", "x.png")

REFUSED = [
    # unknown
    (("rendr",), "rendr: no such command, did you mean render?; `raden -h` lists them"),
    (("capture", "brd"), "brd: no such command, did you mean brdf?"),
    (("--versio",), "--versio: no such option, did you mean --version?"),
    (("render", "m", "--lihgt", "1,1,2"), "--lihgt: no such option, did you mean --light?"),
    (("fit", "a.csv", "-o", "m.safetensors", "--asume=isotropic"), "did you mean --assume?"),
    ((*BRDF, "a.png", "--white-factr", "98"), "--white-factr: no such option, did you mean"),
    ((*BRDF, "a.png", "--frobnicate"), "--frobnicate: no such option; `raden capture brdf -h`"),
    (("render", "m", "-x", "1"), "-x: no such option"),
    (("scan", "--no-simulate"), "--no-simulate: no such option, did you mean --simulate?"),
    (("render", "m", "--reading.smooth", "1"), "--reading.smooth: no such option"),
    # missing
    (("fit",), "fit: MEASUREMENTS is missing; `raden fit -h` says what it is"),
    (("fit", "a.csv"), "fit: --output is missing"),
    (("merge", "-o", "x.csv"), "merge: FILES is missing"),
    (BRDF, "capture brdf: PHOTOS is missing"),
    ((*BRDF[:2], "a.png", *BRDF[4:]), "capture brdf: --lights is missing"),
    (CALIBRATE, "capture calibrate: --squares is missing"),
    (RELIGHT[:2], "relight: --output is missing"),
    (("export", "m", "-o"), "-o: expected a value, got none"),
    (("render", "m", "--light"), "--light: expected a value, got none"),
    # too many
    (("info", "a.csv", "b.csv", "c.csv"), "info: expected no further argument, got c.csv"),
    (("bench", "here"), "bench: expected no further argument, got here"),
    # of another type
    (("render", "m", "--size", "wide"), "--size: expected a whole number, got wide"),
    (("export", "m", "-o", "x.onnx", "--opset", "18.5"), "--opset: expected a whole number"),
    (("scan", "--readings", "0x10"), "--readings: expected a whole number, got 0x10"),
    (("scan", "--step", "five"), "--step: expected a number, got five"),
    (("scan", "--target-error", "none"), "--target-error: expected a number, got none"),
    (("render", "m", "--fov="), "--fov: expected a number, got nothing"),
    ((*BRDF, "a.png", "--exposure", "[1, 2]"), "--exposure: expected a number, got [1, 2]"),
    ((*BRDF, "a.png", "--lamp", "1", "--lamp", "x"), "--lamp: expected a whole number, got x"),
    ((*BRDF, "a.png", "--white-at", "1,2"), "--white-at: expected three numbers as 1,1,2, got"),
    ((*BRDF, "a.png", "--region", "0,0 1,1"), "--region: expected three or more points in met"),
    ((*BRDF, "a.png", "--axis", "0,0 nan,1"), "--axis: expected two points in metres"),
    (("capture", "colour", "c.png", "-o", "x.json", "--corners", "1,2"), "--corners: expected fo"),
    ((*CALIBRATE, "--squares", "5-7"), "--squares: expected columns x rows, as 5x7, got 5-7"),
    (("scan", "--tilt", "70"), "--tilt: expected first and last in degrees, as 0:70, got 70"),
    (("scan", "--tilt", "a:70"), "--tilt: expected a number, got a"),
    (("scan", "--fault", "busy"), "--fault: expected name=value"),
    (("render", "m", "--memory", "much"), "--memory: expected a size as 2G or 512M, got much"),
    (
        ("render", "m", "--exposure", "dim"),
        "--exposure: expected a number of stops, auto or key, got",
    ),
    ((*RELIGHT, "--original-light", "1,2"), "--original-light: expected three numbers as 1,1,2"),
    (("bench", "--compiled=maybe"), "--compiled: expected true or false, got maybe"),
    # another choice
    ((*RELIGHT, "--green", "vulkan"), "--green: expected opengl or directx, got vulkan"),
    ((*BRDF, "a.png", "--shape", "cube"), "--shape: expected sphere, plane or cylinder, got"),
    (
        ("fit", "a.csv", "-o", "m", "--assume", "none"),
        "--assume: expected isotropic or isotropic+reciprocal, got none",
    ),
    # what contradicts itself
    (("bench", "--height", "3"), "--height: expected 16…8192, got 3"),
    ((*RELIGHT, "--strip", "3", "--sheet", "3"), "--strip and --sheet bring their own lamps"),
    ((*BRDF, "a.png", "--lamps-stand", "board"), "--lamps-stand board and --lights-seen-in go"),
]


@pytest.mark.parametrize(("words", "wanted"), REFUSED)
def test_what_cannot_be_read_is_one_line(
    raden: Command, tmp_path: Path, words: tuple[str, ...], wanted: str
) -> None:
    done = raden(*words, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("raden: ")
    assert wanted in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_values_stand_for_themselves() -> None:
    got = parsed("render", "-om.png", "--light", "-1,0,1", "shell", "--light=point:1,2,3")
    assert got["model"] == Path("shell")
    assert got["output"] == Path("m.png")
    assert [(lamp.position, lamp.is_point) for lamp in got["light"]] == [
        ((-1.0, 0.0, 1.0), False),
        ((1.0, 2.0, 3.0), True),
    ]
    words = ("--normal-xyz", "-r,g,b", "--memory", "1.5G", "--fov", "-3", "--channel", "normal=N")
    exr = parsed("render", "m", *words)["exr"]
    assert (exr.xyz, exr.memory, exr.fov_deg) == ("-r,g,b", 3 << 29, -3.0)
    assert exr.reading.channels == {"normal": "N"}
    assert parsed("render", "m", "--exposure", "auto")["display"].exposure == "auto"
    assert parsed("render", "m", "--exposure", "-1.5")["display"].exposure == -1.5
    assert parsed("demo", "--size", "64", "--size", "32") == {"size": 32}  # the last one counts
    assert parsed("verify", "--", "-odd.onnx")["file"] == Path("-odd.onnx")
    plan = parsed("scan", "--plan", "random", "--tilt", "-70:7.5", "--step", "2")["plan"]
    assert (plan.kind, plan.tilt, plan.step_deg) == ("random", (-70.0, 7.5), 2.0)
    assert parsed("info", "null", "none") == {"file": Path("null"), "other": Path("none")}


def test_files_may_stand_between_options() -> None:
    got = parsed(*BRDF[:2], "a.png", "b.png", *BRDF[2:], "c.png", "--dark", "d.png", "e.png")
    assert got["photos"] == tuple(map(Path, ("a.png", "b.png", "c.png", "e.png")))
    assert got["reading"].dark == (Path("d.png"),)
    assert got["setup"].lights == Path("l.json")


@pytest.mark.parametrize(
    ("words", "wanted"), [((), None), (("--legacy",), True), (("--no-legacy",), False)]
)
def test_a_switch_has_two_names(words: tuple[str, ...], wanted: bool | None) -> None:
    board = parsed(*CALIBRATE, "--squares", "5x7", *words)["board"]
    assert (board.squares, board.legacy) == ((5, 7), wanted)


def test_a_simulation_s_options_are_the_library_s() -> None:
    from raden_torch.capture.photo.simulation.simulate import Options
    from raden_torch.cli.simulated_photographs_command import SimulationOptions

    ours, theirs = (dataclasses.asdict(each()) for each in (SimulationOptions, Options))
    assert ours == {name: value for name, value in theirs.items() if name in ours}


def test_a_plan_s_options_are_the_library_s() -> None:
    from raden_torch.capture.spectrometer.plan_choice import PlanChoice
    from raden_torch.cli.scan_options import PlanOptions

    assert dataclasses.asdict(PlanOptions()) == dataclasses.asdict(PlanChoice())
    assert not PlanOptions(seed=3).is_made
    assert not PlanChoice(seed=3).is_made
    assert PlanOptions(seed=3, step_deg=5.0).is_made


def test_functions_of_the_command_line_stay_small() -> None:
    large = []
    for path in sorted(Path(raden_torch.cli.__file__).parent.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names = [a.arg for a in (*node.args.args, *node.args.kwonlyargs)]
                lines = (node.end_lineno or 0) - node.lineno + 1
                if len(names) > 12 or lines > 60:
                    large.append(f"{path.name}: {node.name}: {len(names)}, {lines} lines")
    assert not large
