"""Ctrl-C, SIGTERM and a closed terminal: one line, 128 + the number, and nothing half done."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import raden_torch as rt
from raden_torch.interrupts import Interrupted, signals_interrupt

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


@pytest.fixture(autouse=True)
def _signals_as_at_a_terminal() -> Iterator[None]:
    """A background job of a shell ignores SIGINT, and so do the processes that it starts."""
    numbers = [getattr(signal, name) for name in NAMES]
    before = [signal.signal(number, signal.default_int_handler) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def twice(number: int) -> None:
    try:
        signal.raise_signal(number)
    finally:
        signal.raise_signal(number)  # an impatient one, while things are cleaned up


@pytest.mark.parametrize("name", NAMES)
def test_a_signal_is_raised_once(name: str) -> None:
    number = getattr(signal, name)
    before = signal.getsignal(number)
    with pytest.raises(Interrupted, match=name) as caught, signals_interrupt():
        twice(number)
    assert caught.value.exit_code == 128 + number
    assert signal.getsignal(number) is before


def swallowed() -> None:
    try:
        signal.raise_signal(signal.SIGTERM)
    except Interrupted:
        raise AttributeError("half imported") from None


def test_a_swallowed_signal_explains_what_fails_after_it() -> None:
    with pytest.raises(Interrupted, match="SIGTERM"), signals_interrupt():
        swallowed()


def test_what_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with signals_interrupt():
        signal.raise_signal(signal.SIGHUP)


@pytest.mark.parametrize("raised", [KeyboardInterrupt(), Interrupted(signal.SIGTERM)], ids=repr)
def test_a_library_call_leaves_the_older_file(
    tmp_path: Path, raised: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "shell.csv"
    measurement = rt.simulate_specimen("yakogai", step_deg=35.0)
    path.write_text("older")

    def half(value: float) -> str:
        raise raised

    monkeypatch.setattr("raden_torch.measurement.native_csv._number", half)
    with pytest.raises(type(raised)):
        measurement.save(path)
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    measurement = rt.simulate_specimen("yakogai")
    measurement.save(folder / "shell.csv")
    rt.save_model(rt.fit(measurement, interpolation="trilinear").model, folder / "m.safetensors")
    return folder


def wait_until_it_listens(pid: int) -> None:
    """Until the process has handlers of its own for SIGTERM, however long its start takes here."""
    if not Path("/proc/self/status").exists():
        time.sleep(0.5)
        return
    deadline = time.monotonic() + 300
    while True:
        status = Path(f"/proc/{pid}/status").read_text()
        caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
        if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("fit", "shell.csv", "-o", "out.safetensors"),
        ("render", "m.safetensors", "--size", "2000", "-o", "out.png"),
        ("demo", "--out", "demo"),
        ("scan", "--simulate", "--specimen", "shell.csv", "--time-scale", "100", "-o", "out.csv"),
    ],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_command_is_stopped(
    inputs: Path, tmp_path: Path, words: tuple[str, ...], name: str
) -> None:
    """At a random moment: no half file, no temporary one, no process left over."""
    work, temporary = tmp_path / "work", tmp_path / "temporary"
    work.mkdir()
    temporary.mkdir()
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "raden_torch.cli"),
            *(str(inputs / word) if (inputs / word).exists() else word for word in words),
        ],
        cwd=work,
        env=os.environ | {"TMPDIR": str(temporary)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    wait_until_it_listens(process.pid)
    time.sleep(random.Random(f"{words[0]} {name}").uniform(0.5, 2.0))
    number = getattr(signal, name)
    process.send_signal(number)
    _, said = process.communicate(timeout=300)  # returns when no child holds the pipe any more
    assert process.returncode == 128 + number, said
    assert "Traceback" not in said
    assert f"stopped by {name}" in said
    written = [path.name for path in work.rglob("*") if path.is_file()]
    assert not [name for name in written if name.startswith((".", "out."))] or written == [
        "out.journal.jsonl"
    ]
    assert not list(temporary.iterdir())
