"""The command line: help, options, and the lines that a command prints."""

import pkgutil
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest

from wavefield import __version__
from wavefield.commands.cli import cli, main
from wavefield.errors import StoreError


def _commands(group: click.Group, path: str = "") -> dict[str, click.Command]:
    found = {}
    for name, command in group.commands.items():
        words = f"{path} {name}".strip()
        if isinstance(command, click.Group):
            found |= _commands(command, words)
        else:
            found[words] = command
    return found


COMMANDS = _commands(cli)


def cube_folder(folder: Path) -> Path:
    """Make a folder with the name of a cube."""
    (folder / "cube.zarr").mkdir()
    return folder / "cube.zarr"


INPUTS = (
    *("experiment.yaml", "sea/experiment.yaml", "rest/experiment.yaml", "piv/experiment.yaml"),
    *("run07/experiment.yaml", "campaign.yaml", "tank.yaml", "rig.yaml", "stereo.yaml", "target.yaml"),
    *("workflows/slurm.yaml", "my_scene.yaml", "cal.xml", "a.xml", "b.xml", "cube.zarr/zarr.json"),
    *("rest.zarr/zarr.json", "waves.zarr/zarr.json", "wass_config/ext.xml"),
)


def examples_of(words: str) -> list[list[str]]:
    """Return the examples of a command's help, each as the words after its name."""
    lines = [line.strip() for line in (COMMANDS[words].epilog or "").splitlines()]
    found = [shlex.split(line, comments=True) for line in lines if line.startswith("wavefield ")]
    assert all(example[1:][: len(words.split())] == words.split() for example in found), words
    return [example[1 + len(words.split()) :] for example in found]


@pytest.mark.parametrize("words", COMMANDS)
def test_each_help_has_examples_that_the_command_takes(words, tmp_path, monkeypatch, capsys):
    for name in INPUTS:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    assert main([*words.split(), "--help"]) == 0
    assert "Example" in capsys.readouterr().out
    assert examples_of(words), f"wavefield {words} --help shows no example"
    for example in examples_of(words):
        COMMANDS[words].make_context(words, example)  # parses, and checks files, choices and numbers


def test_version_and_help(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"wavefield {__version__}\n"
    assert main(["-h"]) == 0
    assert "wavefield demo" in capsys.readouterr().out


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "wavefield", "--version"], capture_output=True, text=True)
    assert done.stdout == f"wavefield {__version__}\n", done.stderr


def test_help_is_quick_because_nothing_heavy_is_imported():
    heavy = ["numba", "xarray", "dask", "cv2", "matplotlib", "scipy", "zarr", "distributed"]
    code = f"import sys, wavefield.commands.cli; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


@pytest.mark.parametrize(
    "words",
    [["nonsense"], ["status"], ["status", "no/such/store"], ["run", "no.yaml"], ["analyze", "--what"]],
)
def test_wrong_use_is_status_2(words, capsys):
    assert main(words) == 2
    assert "Error" in capsys.readouterr().err


def test_an_error_is_one_sentence_and_status_1(tmp_path, capsys):
    (tmp_path / "not_a_cube").mkdir()
    assert main(["status", str(tmp_path / "not_a_cube")]) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("wavefield: ")
    assert "not_a_cube" in captured.err
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""


def test_debug_shows_the_traceback(tmp_path, capsys):
    (tmp_path / "not_a_cube").mkdir()
    assert main(["--debug", "status", str(tmp_path / "not_a_cube")]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (ZeroDivisionError("by accident"), 1, ["by accident", "--debug"]),
        (KeyboardInterrupt(), 130, ["interrupted"]),
    ],
)
def test_unforeseen_errors_and_interruptions_have_no_traceback(
    monkeypatch, tmp_path, capsys, raised, code, words
):
    import wavefield.pipeline

    def broken(store):
        raise raised

    monkeypatch.setattr(wavefield.pipeline, "status", broken)
    assert main(["status", str(cube_folder(tmp_path))]) == code
    error = capsys.readouterr().err
    assert all(word in error for word in words)
    assert "Traceback" not in error


def test_warnings_are_one_line(monkeypatch, tmp_path, capsys):
    import warnings

    import wavefield.pipeline

    def warning(store):
        warnings.warn("a frame is missing", stacklevel=1)
        raise StoreError("done")

    monkeypatch.setattr(wavefield.pipeline, "status", warning)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(["status", str(cube_folder(tmp_path))]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "wavefield: warning: a frame is missing",
        "wavefield: done",
    ]


def test_rig_is_shown_and_converted_there_and_back(tmp_path, capsys):
    from wavefield.rig import Rig
    from wavefield.tank import paper_rig

    rig = paper_rig()
    rig.save(tmp_path / "rig.yaml")
    assert main(["rig", str(tmp_path / "rig.yaml")]) == 0
    assert "cam3: 2432 x 1728 px" in capsys.readouterr().out
    there, back = str(tmp_path / "opencv.yaml"), str(tmp_path / "back.yaml")
    assert main(["rig", str(tmp_path / "rig.yaml"), "--to", "opencv", "-o", there]) == 0
    assert main(["rig", there, "-o", back]) == 0
    again = Rig.load(back)
    assert again["cam1"].fx == pytest.approx(rig["cam1"].fx, rel=1e-12)
    assert main(["rig", "a.xml", "cam2=b.xml"]) == 2
    assert main(["rig", "cam1=a.xml", "--size", "big"]) == 2
    capsys.readouterr()
    assert main(["rig", str(tmp_path)]) == 0
    assert "cam3: 2432 x 1728 px" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("experiment.yaml", "frame_rate: 20\ncameras: {cam1: {images: a}}", "it is an experiment file; give"),
        ("rig.yaml", "cameras: {cam1: {images: a}}", "camera 'cam1': got an unexpected keyword argument"),
        ("image.tif", "II*\0\0", "is not a rig file"),
        ("report.html", "<!doctype html>", "is not a rig file of a program that"),
    ],
)
def test_a_file_that_is_no_rig_is_named_with_what_it_is(tmp_path, capsys, name, content, reason):
    (tmp_path / name).write_text(content)
    assert main(["rig", str(tmp_path / name)]) == 1
    printed = capsys.readouterr().err
    assert name in printed
    assert reason in printed


def test_the_next_command_is_one_of_this_folder(tmp_path, monkeypatch, capsys):
    import click

    from wavefield.commands.progress import print_next

    monkeypatch.chdir(tmp_path)
    with click.Context(click.Command("run")):
        print_next("analyze", tmp_path / "run 7" / "cube.zarr")
        print_next("analyze", tmp_path.parent / "cube.zarr")
    here, elsewhere = capsys.readouterr().out.splitlines()
    assert here == "Next: wavefield analyze 'run 7/cube.zarr'"
    assert elsewhere.endswith(f"{tmp_path.parent}/cube.zarr")


def test_simulate_lists_every_scene(capsys):
    from wavefield.tank import Scene

    assert main(["simulate", "--help"]) == 0
    listed = capsys.readouterr().out.split("Scenes:")[1].split("Examples:")[0].replace(",", " ").split()
    assert set(Scene.presets()) <= set(listed)


def test_every_public_name_is_there_and_known_to_type_checkers():
    import wavefield as wf

    assert all(callable(getattr(wf, name)) for name in wf.__all__ if name != "__version__")
    rooms = {module.name for module in pkgutil.iter_modules(wf.__path__)}
    assert not rooms & set(wf.__all__)  # else a name is the function or the room, as it was imported before
    assert (Path(wf.__file__).parent / "py.typed").exists()


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, wavefield; print([m for m in sys.modules if m.startswith(('wavefield.', 'numpy'))])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == (
        "['wavefield.lazy_names']\n"
    )
