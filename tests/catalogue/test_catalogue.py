"""Shells go in, are found by their colour, and come out as they were."""

from __future__ import annotations

import json
import os
import resource
import shutil
import threading
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials.surface import Surface, reflected
from raden_torch.catalogue import Catalogue, ColourQuery, Geometry
from raden_torch.catalogue.lab_grid import lab_of_f_r
from raden_torch.errors import InputError
from raden_torch.geometry import vectors_from_angles
from raden_torch.images.pixels import read_pixels
from raden_torch.writer_lock import writer_lock

pytest.importorskip("fcntl")


def names(found: list) -> list[str]:
    return [one.entry.file.partition(".")[0] for one in found]


def test_the_greenest_of_three(catalogue: Catalogue, albedo) -> None:
    """A matt surface has one colour, which is known: within the index's rounding (float16)."""
    found = catalogue.find(ColourQuery.read("green"), Geometry(40))
    assert names(found) == ["green", "grey", "red"]
    expected = lab_of_f_r(np.array(albedo["green"]) / np.pi)
    np.testing.assert_allclose(found[0].lab, expected, atol=0.06)
    assert names(catalogue.find(ColourQuery.read("grey"), Geometry(13, -20, 7)))[0] == "grey"
    assert names(catalogue.find(ColourQuery.read("red"), limit=1)) == ["red"]


def test_by_tag_name_and_kind(catalogue: Catalogue) -> None:
    assert names(catalogue.find()) == ["red", "green", "grey"]
    assert names(catalogue.find(tags=["matt", "grey"])) == ["grey"]
    assert names(catalogue.find(name="GRE", kind="model")) == ["green", "grey"]
    assert catalogue.find(kind="measurement") == []
    for colour in ("red", "#ff0000"):
        assert catalogue.find(ColourQuery.read(colour), tags=["none"]) == []


def test_a_shell_leaves_as_it_went_in(catalogue: Catalogue, matt, tmp_path: Path) -> None:
    entry = catalogue.find(name="green")[0].entry
    data = matt("green").read_bytes()
    assert catalogue.content(catalogue.entry(entry.sha256[:6])) == data
    assert catalogue.file(entry).read_bytes() == data
    assert entry.tags == ("matt", "green")
    assert entry.note == "a green one"
    assert (entry.bytes, entry.kind) == (len(data), "model")


def test_a_measurement_is_fitted_and_its_header_kept(tmp_path: Path) -> None:
    """The index against the model that `fit` makes, in directions that are nodes of both."""
    shell = rt.simulate_specimen("akoya", step_deg=35)
    path = tmp_path / "akoya 1.csv"
    shell.save(path)
    path.write_text("# date: 2026-11-03\n# curator: 田中\n" + path.read_text("utf-8"), "utf-8")
    catalogue = Catalogue(tmp_path / "shells", create=True)
    entry = catalogue.add(path).entry
    assert (entry.kind, entry.name, entry.date, entry.simulated) == (
        *("measurement", "akoya", "2026-11-03", True),
    )
    assert entry.header["curator"] == "田中"
    assert entry.fit["measured"] == 75
    assert entry.box_deg == ((0, 70), (-70, 70), (-70, 70))
    assert entry == catalogue.entry(entry.short_id)
    model = rt.fit(rt.load_measurement(path)).model
    for at, is_measured in {(35.0, 35.0, 0.0): True, (80.0, 80.0, 0.0): False}.items():
        found = catalogue.find(ColourQuery.read("red"), Geometry(*at))[0]
        maps = torch.deg2rad(torch.tensor(at, dtype=torch.float64)).view(3, 1, 1, 1)
        n, light, view = (v[None] for v in vectors_from_angles(*maps))
        f_r = reflected(model, Surface(n, view), light).detach().numpy()[0, :, 0, 0]
        np.testing.assert_allclose(found.lab, lab_of_f_r(f_r), atol=0.1)
        assert found.measured == is_measured
    picture = read_pixels(catalogue.thumbnail(entry), colour=True)
    assert picture.shape == (96, 96, 3)
    assert picture[48, 48].max() > 30 > picture[0, 0].max()


def test_adding_twice_says_so(catalogue: Catalogue, matt, tmp_path: Path) -> None:
    again = tmp_path / "another name.safetensors"
    shutil.copy(matt("red"), again)
    added = catalogue.add(again)
    assert (added.state, added.entry.file) == ("known", "red.safetensors")
    assert len(catalogue) == 3


def test_a_damaged_or_missing_file_is_told_and_restored(catalogue: Catalogue, matt) -> None:
    red, green = (catalogue.find(name=name)[0].entry for name in ("red", "green"))
    data = bytearray(catalogue.file(red).read_bytes())
    data[-1] ^= 1
    catalogue.file(red).write_bytes(data)
    shutil.rmtree(catalogue.file(green).parent)
    with pytest.raises(InputError, match=r"expected \d+ bytes with this SHA-256.*damaged; restore"):
        catalogue.content(red)
    with pytest.raises(InputError, match=r"expected .*file, got none; restore it from a copy, or "):
        catalogue.content(green)
    assert len(list(catalogue.damages())) == 2
    for name in ("red", "green"):
        assert catalogue.add(matt(name)).state == "restored"
    assert list(catalogue.damages()) == []
    kept = catalogue.thumbnail(red).read_bytes()
    catalogue.thumbnail(red).unlink()
    assert "expected a thumbnail, got none; add red.safe" in next(catalogue.damages())
    assert catalogue.add(matt("red")).state == "restored"
    assert catalogue.thumbnail(red).read_bytes() == kept


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda f: (f / "catalogue.json").unlink(), "got one without catalogue.json"),
        (lambda f: (f / "catalogue.json").write_text("{"), "got no valid JSON"),
        (lambda f: (f / "catalogue.json").write_text('{"a": 1}'), "expected the format"),
        (lambda f: versioned(f, 2), "version 1 or older, got 2: a newer raden_torch wrote it"),
        (lambda f: [p.unlink() for p in (f / "index").iterdir()], "expected an index file that"),
        (lambda f: zero_its_first_page(next((f / "index").iterdir())), "got a damaged one"),
        (lambda f: shutil.rmtree(f), "got no folder"),
    ],
)
def test_what_is_no_catalogue(
    catalogue: Catalogue, damage: Callable[[Path], object], said: str
) -> None:
    damage(catalogue.folder)
    with pytest.raises(InputError, match=said) as error:
        Catalogue(catalogue.folder).find()
    assert "\n" not in str(error.value)


def versioned(folder: Path, version: int) -> None:
    path = folder / "catalogue.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "version": version}))


def zero_its_first_page(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[4:200] = bytes(196)
    path.write_bytes(data)


def test_a_check_reads_every_byte_of_the_index(catalogue: Catalogue) -> None:
    """A colour that nobody asks for here."""
    path = next((catalogue.folder / "index").iterdir())
    end = pq.read_metadata(path).row_group(0).column(30)
    data = bytearray(path.read_bytes())
    data[end.data_page_offset + end.total_compressed_size // 2] ^= 1
    path.write_bytes(data)
    assert len(catalogue.find()) == 3
    with pytest.raises(InputError, match="got another: damaged"):
        list(catalogue.damages())


def test_a_folder_with_other_things_is_not_taken(tmp_path: Path, matt) -> None:
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "a.txt").touch()
    with pytest.raises(InputError, match=r"a new or empty one, got one without catalogue\.json"):
        Catalogue(tmp_path / "letters", create=True)
    with pytest.raises(InputError, match="got a file"):
        Catalogue(matt("red"), create=True)


def test_what_is_no_shell(catalogue: Catalogue, tmp_path: Path) -> None:
    path = tmp_path / "letter.txt"
    path.write_text("Dear museum")
    with pytest.raises(InputError, match=r"letter\.txt: expected one of a model, "):
        catalogue.add(path)
    with pytest.raises(InputError, match="tags and note: expected one printable line"):
        catalogue.add(path, note="a\nb")
    for wanted, said in {"": "hexadecimal", "xyz1": "hexadecimal", "0" * 64: "got none"}.items():
        with pytest.raises(InputError, match=said):
            catalogue.entry(wanted)
    assert len(catalogue) == 3


@pytest.mark.usefixtures("quick")
def test_one_writer_at_a_time(catalogue: Catalogue, tmp_path: Path) -> None:
    """Another one waits for it, and says who it is where it waits in vain."""
    path = tmp_path / "a.csv"
    path.write_text("a")
    lock = catalogue.folder / "writer.lock"
    with (
        writer_lock(lock, 0),
        pytest.raises(InputError, match=rf"within 0.1 s, but process {os.getpid()} on "),
    ):
        catalogue.add(path, wait_s=0.1)
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with writer_lock(lock, 0):
            held.set()
            done.wait(0.3)

    other = threading.Thread(target=hold)
    other.start()
    held.wait()
    assert catalogue.add(path, wait_s=30).state == "new"
    other.join()


@pytest.mark.usefixtures("quick")
def test_readers_see_whole_catalogues_while_another_adds(tmp_path: Path) -> None:
    """A reader in a loop beside 37 additions. Expected: what it sees only grows, without a gap."""
    catalogue = Catalogue(tmp_path / "shells", create=True)
    seen: list[int] = []
    failed: list[BaseException] = []
    over = threading.Event()

    def look() -> None:
        try:
            while not over.is_set():
                found = Catalogue(catalogue.folder).find(ColourQuery.read("green"))
                assert sorted(one.entry.number for one in found) == list(range(len(found)))
                seen.append(len(found))
        except BaseException as error:
            failed.append(error)

    reader = threading.Thread(target=look)
    reader.start()
    for number in range(37):
        path = tmp_path / "a.csv"
        path.write_text(f"shell {number}")
        catalogue.add(path)
    over.set()
    reader.join()
    assert failed == []
    assert seen == sorted(seen)
    assert len(set(seen)) > 3
    segments = sorted(p.name for p in (catalogue.folder / "index").iterdir())
    rows = [pq.read_metadata(catalogue.folder / "index" / name).num_rows for name in segments]
    assert rows == [32, 4, 1]  # 37 in binary


@contextmanager
def room_for(number_of_bytes: int):
    """Stands for a full disk: no file may be longer."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (number_of_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize(("most", "file"), [(400, "shells/000003/"), (5000, "index/000003")])
@pytest.mark.usefixtures("quick")
def test_a_full_disk(catalogue: Catalogue, tmp_path: Path, most: int, file: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text("a" * 1000)
    before = {p for p in catalogue.folder.rglob("*") if p.is_file()}
    with pytest.raises(OSError, match="too large") as error, room_for(most):
        catalogue.add(path)
    assert file in str(error.value.filename)
    assert {p for p in catalogue.folder.rglob("*") if p.is_file()} == before
    assert catalogue.add(path).entry.number == 3


def test_from_the_command_line(raden, catalogue: Catalogue, matt, tmp_path: Path) -> None:
    shells, blue = catalogue.folder, matt("blue")
    done = raden("catalogue", "add", shells, blue, tmp_path / "none.csv", blue, "--tag", "Kyoto")
    assert done.returncode == 2
    assert "blue.safetensors: added\n" in done.stdout
    assert "is in the catalogue already, unchanged" in done.stdout
    assert "none.csv: expected a file, got none\n" in done.stderr
    assert "1 of 3 files were not added" in done.stderr
    found = raden("catalogue", "find", shells, "--colour", "青", "--at", 40, "--json")
    best = json.loads(found.stdout)["shells"][0]
    assert (best["file"], best["tags"]) == ("blue.safetensors", ["Kyoto"])
    shown = raden("catalogue", "show", shells, best["id"][:8])
    assert "SHA-256: " + best["id"] in shown.stdout
    assert "60 deg: L* 52.7" in shown.stdout
    out = tmp_path / "out.safetensors"
    assert raden("catalogue", "get", shells, best["id"], "-o", out).returncode == 0
    assert out.read_bytes() == blue.read_bytes()
    sheet = tmp_path / "sheet.png"
    text = raden("catalogue", "find", shells, "--colour", "green", "--sheet", sheet).stdout
    assert [line.split()[1] for line in text.splitlines()[1:5]] == [
        one.entry.short_id for one in catalogue.find(ColourQuery.read("green"))
    ]
    assert read_pixels(sheet, colour=True).std() > 10
    assert raden("catalogue", "check", shells).stdout.endswith("4 shells, each as it was added\n")
    catalogue.file(catalogue.entry(best["id"])).write_bytes(b"")
    checked = raden("catalogue", "check", shells)
    assert checked.returncode == 2
    assert "1 of 4 shells are damaged or missing" in checked.stderr
    refused = raden("catalogue", "find", shells, "--colour", "red", "--at", 95)
    assert refused.stderr == "raden: --at: expected 0…80 degrees, got 95 degrees\n"
