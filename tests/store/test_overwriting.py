"""No command, whatever is in its way, removes or changes what this program did not write as the same product.

Draws are the same every time; more by hand: ``WAVEFIELD_DRAWS=500 pytest tests/store/test_overwriting.py``.
"""

import contextlib
import io
import json
import os
import re
import shutil
import signal
import warnings
from pathlib import Path

import pytest
import zarr
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from wavefield.atomic_write import MARK_ATTRIBUTE, Product, atomic, remove_leftovers, write_mark
from wavefield.commands.cli import main
from wavefield.errors import StoreError

DRAWS = int(os.environ.get("WAVEFIELD_DRAWS", "4"))
SECONDS = 120  # no command here takes a tenth of it

# the words of every command that writes, and the path that it writes; OUT stands for this path
STEREO = ["experiment.yaml", "--frames", "1", "-o", "OUT"]
COMMANDS = {
    "analyze": (["analyze", "cube.zarr", "--segment", "8"], "waves.zarr"),
    "analyze to": (["analyze", "cube.zarr", "--segment", "8", "-o", "OUT"], "new.zarr"),
    "background": (["background", "experiment.yaml"], "background/cam1.tif"),
    "calibrate": (["calibrate", "calibrated.yaml"], "calibrated_rig.yaml"),
    "calibrate to": (["calibrate", "calibrated.yaml", "-o", "OUT"], "new.yaml"),
    "calibrate, report": (["calibrate", "calibrated.yaml"], "calibrated_rig_report"),
    "catalog add": (["catalog", "add", "OUT", "experiment.yaml"], "campaign.yaml"),
    "demo": (["demo", "OUT"], "demo"),
    "export average": (["export", "cube.zarr", "OUT", "--average", "time"], "mean.nc"),
    "export matlab": (["export", "cube.zarr", "OUT"], "new.mat"),
    "export netcdf": (["export", "cube.zarr", "OUT"], "new.nc"),
    "export uvmat": (["export", "cube.zarr", "OUT"], "new.uvmat"),
    "init": (["init", ".", "-o", "OUT"], "proposed.yaml"),
    "level": (["rig", "level", *STEREO], "new.yaml"),
    "paper": (["paper", "cube.zarr", "-o", "OUT"], "page.html"),
    "refine": (["refine", *STEREO], "new.yaml"),
    "report": (["report", "cube.zarr"], "report.html"),
    "report of a catalog": (["report", "runs.yaml", "-o", "OUT"], "campaign.html"),
    "report to": (["report", "cube.zarr", "-o", "OUT"], "page.html"),
    "rig": (["rig", "rig.yaml", "-o", "OUT"], "new.yaml"),
    **{
        f"rig to {program}": (["rig", "rig.yaml", "--to", program, "-o", "OUT"], name)
        for program, name in {
            "matlab": "new.mat",
            "opencv": "new.yml",
            "uvmat": "new",
        }.items()
    },
    "run": (["run", "experiment.yaml", "--workflow", "here.yaml", "-o", "OUT"], "new.zarr"),
    "run, its log": (["run", "experiment.yaml", "--workflow", "here.yaml", "-o", "new.zarr"], "new.log"),
    "run, its verdict": (
        ["run", "experiment.yaml", "--workflow", "here.yaml", "-o", "new.zarr"],
        "new_verdict.json",
    ),
    "run of a catalog": (["run", "runs.yaml", "--workflow", "here.yaml"], "small-tank"),
    "sheet": (["rig", "sheet", *STEREO], "new.yaml"),
    "simulate": (["simulate", "scene.yaml", "OUT"], "tank"),
    "smooth": (["smooth", "cube.zarr"], "smooth.zarr"),
    "smooth to": (["smooth", "cube.zarr", "-o", "OUT"], "new.zarr"),
}
SLOW = ("demo",)  # only with what must be refused
REFUSED = ("foreign file", "foreign folder", "link", "dangling link", "pipe")
INPUTS = ("experiment.yaml", "rig.yaml", "cam1", "cam1/img_00001.tif", "cube.zarr", "cube.zarr/zarr.json")


@pytest.fixture(scope="module")
def lab(measured, tmp_path_factory):
    """The measured experiment with what some commands need besides; every draw leaves it as it was."""
    folder = tmp_path_factory.mktemp("lab") / "lab"
    shutil.copytree(measured, folder)
    (folder / "here.yaml").write_text("cluster: none\n")
    (folder / "scene.yaml").write_text(
        "name: small\nframes: 2\nrig: {crop: 0.12}\ngrid: {x: [-0.04, 0.04], y: [-0.06, 0.06], step: 0.01}\n"
    )
    text = (folder / "experiment.yaml").read_text()
    target = "calibration: {target: {kind: strings, mesh: 0.05}, flat: cam1/*.tif, tilted: cam2/*.tif}\n"
    (folder / "calibrated.yaml").write_text(
        text.replace("rig: rig.yaml", "rig: calibrated_rig.yaml") + target
    )
    before = os.getcwd()
    os.chdir(folder)
    try:
        assert main(["-q", "catalog", "add", "runs.yaml", "experiment.yaml"]) == 0
    finally:
        os.chdir(before)
    return folder


def run_in(folder, words):
    """Exit status of a command in a folder, and what it prints as an error."""

    def late(*_):
        raise AssertionError(f"{words} did not end")

    before, errors = os.getcwd(), io.StringIO()
    os.chdir(folder)
    signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(errors),
        ):
            warnings.simplefilter("ignore")
            return main(["-q", *words]), errors.getvalue()
    finally:
        signal.alarm(0)
        os.chdir(before)


@pytest.fixture(scope="module")
def clean(lab):
    """All that is in it."""
    found = tree(lab)
    return lambda: found  # of short words where it is printed


def restore(lab, clean):
    """Make the folder as it was."""
    now = tree(lab)
    changed = [name for name, content in now.items() if clean.get(name) != content]
    for name in sorted(changed, reverse=True):  # what is in a folder before the folder
        clear(lab / name)
    for name, content in clean.items():
        path = lab / name
        if os.path.lexists(path):
            continue
        if content == "folder":
            path.mkdir(parents=True)
        elif isinstance(content, bytes):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        else:
            path.symlink_to(content)


@pytest.fixture(scope="module")
def products(lab, clean, tmp_path_factory):
    """What a command writes where nothing is in its way, by command; None where it has nothing to write."""
    found = {}

    def product_of(command):
        if command not in found:
            words, out = COMMANDS[command]
            clear(lab / out)
            run_in(lab, [out if word == "OUT" else word for word in words])
            found[command] = None
            if (lab / out).exists():
                found[command] = tmp_path_factory.mktemp("product") / Path(out).name
                put(lab / out, found[command])
            restore(lab, clean())
        return found[command]

    return product_of


def clear(path):
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def put(source, path):
    shutil.copytree(source, path, symlinks=True) if source.is_dir() else shutil.copy(source, path)


def of_another(path):
    """Turn a product into that of another source, its mark with it."""
    for file in [path] if path.is_file() else [path / "zarr.json", *path.glob("*.html")]:
        if file.name == "zarr.json" and file.exists():
            data = json.loads(file.read_text())
            mark = data["attributes"].get(MARK_ATTRIBUTE)
            if mark:
                mark["source"] = "0" * 15 + "1"
            else:  # a cube
                data["attributes"]["recipe_hash"] = "0" * 15 + "1"
            file.write_text(json.dumps(data, indent=2))
        elif file.exists():
            content = file.read_bytes()
            file.write_bytes(
                re.sub(
                    rb"(wavefield [a-z ]+) [0-9a-f]{16} ([0-9a-f]{32})", rb"\1 0000000000000001 \2", content
                )
            )


def add_to(path):
    if path.is_dir():
        (path / "my notes.txt").write_text("what I think of it")
    else:
        with path.open("ab") as file:
            file.write(b"# added by me\n")


def obstruct(lab, out, obstacle, own):
    """Put something in the way of a command's output."""
    path = lab / out
    if obstacle != "beside it":
        clear(path)
    path.parent.mkdir(exist_ok=True)
    if obstacle == "foreign file":
        path.write_text("wavefield, written by me\n")
    elif obstacle == "foreign folder":
        path.mkdir()
        (path / "index.html").write_text("three months of work")
        (path / f"a_1{path.suffix}").write_text("three months of work")
    elif obstacle == "link":
        (lab / "thesis").mkdir()
        (lab / "thesis/text.tex").write_text("years")
        path.symlink_to(lab / "thesis" if path.suffix in (".zarr", "", ".uvmat") else lab / "thesis/text.tex")
    elif obstacle == "dangling link":
        path.symlink_to(lab / "nowhere")
    elif obstacle == "pipe":
        os.mkfifo(path)
    elif obstacle == "another kind":
        put(lab / ("waves.zarr" if path.suffix == ".zarr" and out != "waves.zarr" else "cube.zarr"), path)
    elif own is not None:
        put(own, path)
        if obstacle == "of another experiment":
            of_another(path)
        elif obstacle == "user's part":
            add_to(path)
    for backup in (f".{path.name}.20261101.old", f"{path.name}.bak", f".wavefield-{path.name}"):
        place = path.with_name(backup)
        place.mkdir()
        (place / "note").write_text("years")


def tree(folder):
    """All that is in a folder: contents of files, targets of links, kinds of what else there is."""
    out = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            out[name] = str(path.readlink())
        elif path.is_file():
            out[name] = path.read_bytes()
        else:
            out[name] = "folder" if path.is_dir() else "pipe"
    return out


OBSTACLES = (
    *(*REFUSED, "own input", "another kind", "of another experiment", "user's part"),
    *("beside it", "own product"),
)
# files without a source, to which a run or `catalog add` adds, or which it replaces, if they are its own kind
GROWS = ("catalog add", "run, its log", "run, its verdict", "run of a catalog")


@settings(max_examples=DRAWS, suppress_health_check=list(HealthCheck), phases=[Phase.generate])
@given(st.sampled_from(list(COMMANDS)), st.sampled_from(OBSTACLES), st.sampled_from(INPUTS))
def test_nothing_is_removed_or_changed_that_was_not_written_as_the_same(
    lab, clean, products, without_pixels, command, obstacle, own_input
):
    if command in SLOW and obstacle not in REFUSED:
        return
    words, out = COMMANDS[command]
    restore(lab, clean())
    if obstacle == "own input" and "OUT" in words:
        out = own_input
    elif obstacle == "own input":
        return
    else:
        remade = obstacle in ("of another experiment", "user's part", "own product")
        obstruct(lab, out, obstacle, products(command) if remade else None)
    before = tree(lab)
    with without_pixels():
        code, printed = run_in(lab, [out if word == "OUT" else word for word in words])
    now = tree(lab)
    lost = [
        name
        for name, content in before.items()
        if now.get(name) != content and not may_change(command, obstacle, out, name, content, now.get(name))
    ]
    assert not lost, (command, obstacle, out, lost[:5], printed)
    assert "did not foresee" not in printed, (command, obstacle, out, printed)
    assert "Traceback" not in printed, (command, obstacle, out, printed)
    assert code in (0, 1, 2, 3), (command, obstacle, code)
    assert code != 1 or 0 < len(printed.splitlines()) <= 3, (command, obstacle, out, printed)
    assert not [name for name in set(now) - set(before) if re.search(r"\.wavefield-[0-9a-f]{32}", name)]


def may_change(command, obstacle, out, name, old, new):
    """Whether a command may change a file that was there: its own product, or the log of an earlier run."""
    ours = obstacle in ("own product", "user's part", "of another experiment")
    if name.endswith(".log") and (ours or Path(name).name != Path(out).name):
        return isinstance(new, bytes) and new.startswith(old)  # a run adds to it
    if obstacle in ("beside it", "own product") or (command in GROWS and ours):
        goes_on = command.startswith("run") and name.startswith("new")
        return goes_on or Path(name).parts[0] == Path(out).parts[0]
    return False


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
    with pytest.raises(StoreError, match="is a link"), atomic(tmp_path / "link", replace=True) as draft:
        draft.write_text("new")
    assert (tmp_path / "link").is_symlink()
