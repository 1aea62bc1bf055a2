"""No command, with any target, removes or changes a file that this program did not write as the same product.

Draws are the same every time; more by hand: ``WAVEFIELD_DRAWS=3000 pytest tests/store/test_overwriting.py``.
"""

import contextlib
import io
import os
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import zarr
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from wavefield.atomic_write import Product, atomic, remove_leftovers, write_mark
from wavefield.commands.cli import main
from wavefield.errors import StoreError

DRAWS = int(os.environ.get("WAVEFIELD_DRAWS", "15"))
ENDINGS = (".nc", ".mat", ".uvmat")

# the words of every command that writes, and what of its own it may replace
COMMANDS = {
    "analyze": (["analyze", "cube.zarr", "--segment", "8", "-o"], {"waves.zarr"}),
    "report": (["report", "cube.zarr", "-o"], {"page.html"}),
    "paper": (["paper", "cube.zarr", "-o"], {"page.html"}),
    "run": (["run", "experiment.yaml", "--workflow", "here.yaml", "-o"], {"cube.zarr"}),
    "calibrate": (["calibrate", "experiment.yaml", "-o"], {"other_rig.yaml"}),
    "refine": (["refine", "experiment.yaml", "--frames", "1", "-o"], {"other_rig.yaml"}),
    "level": (["rig", "level", "experiment.yaml", "--frames", "1", "-o"], {"other_rig.yaml"}),
    "sheet": (["rig", "sheet", "experiment.yaml", "--frames", "1", "-o"], {"other_rig.yaml"}),
    "convert": (["rig", "convert", "rig.yaml", "-o"], {"other_rig.yaml"}),
    "to opencv": (["rig", "convert", "rig.yaml", "--to", "opencv", "-o"], set()),
    "to vic3d": (["rig", "convert", "rig.yaml", "--to", "vic3d", "-o"], set()),
    "to uvmat": (["rig", "convert", "rig.yaml", "--to", "uvmat", "-o"], set()),
    "init": (["init", ".", "-o"], set()),
    "simulate": (["simulate", "demo"], set()),
    "demo": (["demo"], set()),
    "catalog": (["catalog", "add", "TARGET", "experiment.yaml"], set()),
    "export": (["export", "cube.zarr"], {"cube.nc"}),
}
# what may be in the way
TARGETS = (
    *(
        "notes",
        "notes/log.txt",
        "probes.csv",
        "precious.html",
        "cam1",
        "cam1/img_00001.tif",
        "experiment.yaml",
    ),
    *("rig.yaml", "other_rig.yaml", "cube.zarr", "waves.zarr", "page.html", "cube.nc"),
    *("foreign.zarr", "to_notes", "to_waves", "to_nowhere", "to_rig.yaml", "to_page.html", "mixed.zarr"),
    *(f"{kind}{ending}" for kind in ("mine", "folder") for ending in ENDINGS),
    *("verdict.json", "cube.log", "kept/cube.zarr", "locked/cube.zarr", "beside/cube.zarr"),
)


@pytest.fixture(scope="module")
def crowded(measured, tmp_path_factory):
    """The measured experiment among files of all kinds that its user has made."""
    folder = tmp_path_factory.mktemp("crowded") / "lab"
    shutil.copytree(measured, folder)
    (folder / "here.yaml").write_text("cluster: none\n")
    (folder / "notes").mkdir()
    (folder / "notes/log.txt").write_text("three months of work")
    (folder / "probes.csv").write_text("time,p1\n0,0.1\n")
    (folder / "precious.html").write_text("<!doctype html><title>mine</title>")
    (folder / "page.html").write_text('<!doctype html>\n<meta name="generator" content="wavefield">')
    shutil.copy(folder / "rig.yaml", folder / "other_rig.yaml")
    zarr.create_array(folder / "foreign.zarr", data=np.arange(3.0), attributes={"title": "waves of mine"})
    shutil.copytree(folder / "waves.zarr", folder / "mixed.zarr")
    (folder / "mixed.zarr/spectra/notes.txt").write_text("what I think of it")
    main(["-q", "export", str(folder / "cube.zarr"), str(folder / "cube.nc")])
    for link, to in (
        *(("to_notes", "notes"), ("to_waves", "waves.zarr"), ("to_nowhere", "nowhere")),
        *(("to_rig.yaml", "other_rig.yaml"), ("to_page.html", "page.html")),
    ):
        (folder / link).symlink_to(to)
    for ending in ENDINGS:
        (folder / f"mine{ending}").write_text("wavefield, written by me")
        (folder / f"folder{ending}").mkdir()
        (folder / f"folder{ending}/a_1{ending}").write_text("mine")
    for place, name in (("kept", "cube.log"), ("locked", "cube.zarr.lock"), ("beside", "verdict.json")):
        (folder / place).mkdir()
        (folder / place / name).write_text("mine")
        os.utime(folder / place / name, (0, 0))
    return folder


def tree(folder):
    """All that is in a folder: contents of files, targets of links."""
    out = {}
    for path in folder.rglob("*"):
        if path.is_symlink():
            out[path.relative_to(folder).as_posix()] = str(path.readlink())
        elif path.is_file():
            out[path.relative_to(folder).as_posix()] = path.read_bytes()
    return out


@pytest.fixture(scope="module")
def contents(crowded):
    before = tree(crowded)
    return lambda: before  # of short words where it is printed


@settings(max_examples=DRAWS, suppress_health_check=list(HealthCheck), phases=[Phase.generate])
@given(st.sampled_from(list(COMMANDS)), st.sampled_from(TARGETS))
def test_nothing_is_removed_or_changed_that_was_not_written_as_the_same(crowded, contents, command, target):
    words, own = COMMANDS[command]
    if target in own and command in ("report", "paper", "run", "calibrate", "refine", "level", "sheet"):
        return  # replaced, which takes long
    words = [target if word == "TARGET" else word for word in words]
    words += [] if "catalog" in words else [target]
    before = os.getcwd()
    os.chdir(crowded)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        with contextlib.redirect_stderr(io.StringIO()) as complaints:
            try:
                code = main(["-q", *words])
            finally:
                os.chdir(before)
    now = tree(crowded)
    lost = [name for name, content in contents().items() if now.get(name) != content]
    for name in {*now, *lost}:
        if now.get(name) != contents().get(name):  # as it was, for the next draw
            path = crowded / name
            if path.is_symlink() or path.exists():
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    for name in lost:
        path = crowded / name
        path.parent.mkdir(parents=True, exist_ok=True)
        content = contents()[name]
        path.symlink_to(content) if isinstance(content, str) else path.write_bytes(content)
    assert {Path(name).parts[0] for name in lost} <= own & {target}, (words, lost[:9])
    printed = complaints.getvalue()
    assert "did not foresee" not in printed, (words, printed)
    assert code in (0, 1, 2, 3)


def replaced(path, product, write):
    with atomic(path, product) as draft:
        write(draft)


@pytest.fixture
def old_waves(tmp_path):
    """A wave store of an earlier analysis, and what it is."""
    path, product = tmp_path / "waves.zarr", Product("wave store")
    zarr.create_group(path, attributes={"title": "waves of a cube"})
    write_mark(path, product)
    return path, product


def test_an_old_store_outlives_a_writer_that_is_killed_before_the_new_one_has_its_name(
    old_waves, monkeypatch
):
    path, product = old_waves
    old = tree(path)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", lambda *_: os._exit(9))
        child = os.fork()
        if not child:
            replaced(path, product, lambda draft: shutil.copytree(path, draft))
        os.waitpid(child, 0)
    assert not path.exists()
    (path.parent / ".waves.zarr.20261101.old").mkdir()  # a dated backup of the user's
    remove_leftovers(path)
    assert tree(path) == old
    assert sorted(one.name for one in path.parent.iterdir()) == [".waves.zarr.20261101.old", "waves.zarr"]


def test_a_file_that_appears_while_its_product_is_being_written_stays(tmp_path):
    path = tmp_path / "out.nc"
    with pytest.raises(StoreError, match="was not written by wavefield"):
        replaced(path, Product("export"), lambda draft: draft.write_bytes(path.write_text("mine") * b"x"))
    assert path.read_text() == "mine"


def test_a_link_is_never_replaced(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with (
        pytest.raises(StoreError, match="is a link"),
        atomic(tmp_path / "link", replace=True) as draft,
    ):
        draft.write_text("new")
    assert (tmp_path / "link").is_symlink()
