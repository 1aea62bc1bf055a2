"""Faults that once destroyed data or were not noticed, each in the smallest case that shows it."""

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import zipfile

import pytest
import xarray as xr
import yaml

import wavefield as wf
from wavefield import atomic_write
from wavefield.commands.cli import main
from wavefield.errors import StoreError
from wavefield.pipeline.catalog import catalog_add, find_cube
from wavefield.rig import Rig
from wavefield.store.verdict import read_verdict

CATALOG = "catalog.yaml"


@pytest.fixture
def lab(measured, tmp_path, monkeypatch):
    """A copy of the measured experiment, and the working folder of the command line."""
    shutil.copytree(measured, tmp_path / "lab")
    monkeypatch.chdir(tmp_path / "lab")
    return tmp_path / "lab"


def command(*words):
    return main(["-q", *map(str, words)])


def refused(capsys, *words):
    """The error message of a command that is refused."""
    assert command(*words) == 1
    printed = capsys.readouterr().err
    assert "did not foresee" not in printed
    assert "Traceback" not in printed
    return printed


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_background_leaves_the_backgrounds_of_others_and_replaces_its_own(lab, capsys):
    assert command("background", "experiment.yaml") == 0
    assert command("background", "experiment.yaml") == 0, "its own is replaced"
    edit(lab / "experiment.yaml", "name: small-tank", "name: another")
    assert "is a background of something else" in refused(capsys, "background", "experiment.yaml")


def test_calibrate_leaves_the_rig_of_another_experiment(lab, capsys):
    with (lab / "experiment.yaml").open("a") as note:
        note.write("calibration: {target: {kind: strings, mesh: 0.05}, flat: f.tif, tilted: t.tif}\n")
    rig = lab / "rig.yaml"
    Rig.load(rig).save(lab / "other.yaml", source="0123456789abcdef")
    rig.write_text((lab / "other.yaml").read_text())
    before = rig.read_text()
    assert "is a rig of something else" in refused(capsys, "calibrate", "experiment.yaml")
    rig.write_text("# levelled by hand on 12 May, do not touch\n" + before)
    assert "was changed since" in refused(capsys, "calibrate", "experiment.yaml")
    assert "do not touch" in rig.read_text()


def test_comments_in_a_catalog_stay(lab, capsys):
    assert command("catalog", "add", CATALOG, "experiment.yaml") == 0
    edit(lab / CATALOG, "\nuser_parameters:", "\n# camera 2 moved before run 3\nuser_parameters:")
    edit(lab / "experiment.yaml", "name: small-tank", "name: second")
    shutil.copy("experiment.yaml", "second.yaml")
    assert command("catalog", "add", CATALOG, "second.yaml") == 0, capsys.readouterr().err
    assert "# camera 2 moved before run 3\nuser_parameters:" in (lab / CATALOG).read_text()


@pytest.mark.slow
def test_runs_that_are_added_at_once_are_all_registered(lab):
    text = (lab / "experiment.yaml").read_text()
    names = [f"run{number}" for number in range(8)]
    for name in names:
        (lab / f"{name}.yaml").write_text(text.replace("name: small-tank", f"name: {name}"))
    code = (
        "import sys; from wavefield.pipeline.catalog import catalog_add\n"
        "for name in sys.argv[1:]: catalog_add('catalog.yaml', name + '.yaml')"
    )
    jobs = [subprocess.Popen([sys.executable, "-c", code, *names[k::2]], cwd=lab) for k in range(2)]
    assert [job.wait() for job in jobs] == [0, 0]
    options = yaml.safe_load((lab / CATALOG).read_text())["user_parameters"]["run"]["options"]
    assert sorted(options) == names


def test_a_catalog_sees_a_cube_that_was_measured_before(lab):
    catalog_add(CATALOG, "experiment.yaml")
    assert find_cube(CATALOG).resolve() == (lab / "cube.zarr").resolve()
    assert command("status", CATALOG) in (0, 3)


@pytest.mark.parametrize(
    ("words", "size"),
    [
        *((["export", "cube.zarr", f"o.{ending}"], 2_000) for ending in ("nc", "mat", "uvmat")),
        *((["rig", "rig.yaml", "--to", to, "-o", "o.txt"], 256) for to in ("opencv", "wavefield")),
    ],
)
@pytest.mark.slow
def test_a_full_disk_is_a_sentence_and_leaves_no_file(lab, words, size):
    line = [sys.executable, "-m", "wavefield", "-q", *words]
    limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))  # noqa: E731
    found = subprocess.run(line, cwd=lab, capture_output=True, text=True, timeout=100, preexec_fn=limit)
    assert found.returncode == 1, found
    assert "is full, or a quota is used up" in found.stderr
    assert "Traceback" not in found.stderr
    assert "Wrote" not in found.stdout
    assert not list(lab.glob("o.*"))
    assert not list(lab.glob(".wavefield-*"))


WRITER = """
import sys, time
from wavefield.atomic_write import atomic
with atomic(sys.argv[1]) as draft:
    draft.write_text("half")
    print("begun", flush=True)
    time.sleep(60)
"""


@pytest.mark.slow
def test_a_killed_writer_leaves_nothing_after_the_next_command(lab):
    writer = subprocess.Popen([sys.executable, "-c", WRITER, "x.nc"], cwd=lab, stdout=subprocess.PIPE)
    assert writer.stdout.readline() == b"begun\n"
    assert len(list(lab.glob(".wavefield-*"))) == 1
    assert command("export", "cube.zarr", "y.nc") == 0
    assert len(list(lab.glob(".wavefield-*"))) == 1, "of a writer that is at work"
    writer.kill()
    writer.wait()
    writer.stdout.close()
    assert command("export", "cube.zarr", "z.nc") == 0
    assert not list(lab.glob(".wavefield-*"))


@pytest.mark.parametrize("closed_twice", [False, True])
def test_a_signal_while_a_draft_is_removed_leaves_nothing_and_still_stops(
    tmp_path, monkeypatch, closed_twice
):
    remove = atomic_write.shutil.rmtree
    calls = []

    def interrupted(folder, **options):
        calls.append(folder)
        if len(calls) == 1:
            try:
                raise KeyboardInterrupt
            finally:
                if closed_twice:
                    raise OSError(errno.EBADF, "Bad file descriptor")
        remove(folder, **options)

    monkeypatch.setattr(atomic_write.shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_write.atomic(tmp_path / "x.txt") as draft:
        draft.write_text("whole")
    assert not list(tmp_path.glob(".wavefield-*"))


def test_a_draft_whose_removal_a_signal_prevents_is_removed_when_the_process_ends(tmp_path):
    program = """if True:
        from wavefield import atomic_write
        def interrupted(folder):
            raise KeyboardInterrupt
        atomic_write._remove = interrupted
        with atomic_write.atomic("x.txt") as draft:
            draft.write_text("whole")
    """
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert "KeyboardInterrupt" in ended.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["x.txt"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_command_that_is_ended_by_a_signal_removes_what_it_began(lab, name):
    line = [sys.executable, "-m", "wavefield", "-q", "smooth", "cube.zarr"]
    job = subprocess.Popen(line, cwd=lab, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 60
    while not list(lab.glob(".wavefield-*")) and job.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    job.send_signal(getattr(signal, name))
    job.communicate(timeout=60)
    assert not list(lab.glob(".wavefield-*"))


@pytest.mark.parametrize("words", [["report", "cube.zarr"], ["rig", "rig.yaml"], ["paper", "cube.zarr"]])
def test_devices_are_refused_before_they_are_opened(lab, capsys, words):
    assert "is a pipe or a device" in refused(capsys, *words, "-o", "/dev/zero")


@pytest.mark.parametrize("name", ["smooth.zarr", "waves.zarr"])
def test_smoothed_fields_and_waves_are_verified(lab, capsys, name):
    assert command("smooth", "cube.zarr") == 0
    assert command("verify", name) == 0
    if name == "smooth.zarr":
        assert xr.open_dataset(name, engine="wavefield").z.notnull().any()
    next(file for file in (lab / name).rglob("c/*") if file.is_file()).unlink()
    assert command("verify", name) == 1
    assert "not as it was written" in capsys.readouterr().out
    with pytest.raises(StoreError, match="is not as it was written"):
        xr.open_dataset(name, engine="wavefield")


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "demo", "x" * 256],
        ["simulate", "demo", "file/d"],
        ["smooth", "cube.zarr", "-o", "x" * 255 + ".zarr"],
        ["export", "cube.zarr", "file/x.nc"],
        ["export", "cube.zarr", "x" * 255 + ".nc"],
        ["export", "cube.zarr", "cube.zarr/x.nc"],
        ["report", "cube.zarr", "-o", "cube.zarr/x.html"],
        ["smooth", "cube.zarr", "-o", "cube.zarr/smooth.zarr"],
        ["run", "experiment.yaml", "-o", "."],
    ],
)
def test_impossible_outputs_are_one_sentence(lab, capsys, words):
    (lab / "file").write_text("")
    assert len(refused(capsys, *words).strip().splitlines()) == 1
    assert not (lab / "cube.zarr/x.nc").exists()


def test_waves_of_another_cube_are_refused(lab, capsys):
    other = wf.open_cube("cube.zarr").load().assign_attrs(recipe_hash="0123456789abcdef")
    shutil.rmtree("waves.zarr")
    wf.analyze(other, "waves.zarr", segment=8)
    assert "has the waves of another cube" in refused(capsys, "report", "cube.zarr")


def test_waves_of_an_earlier_state_of_a_cube_are_left_out(lab):
    assert wf.open_run("cube.zarr").waves is not None
    from wavefield.store.write_cube import reset_chunks

    reset_chunks(lab / "cube.zarr", [4])
    found = wf.open_run("cube.zarr")
    assert found.waves is None
    assert "has changed since" in found.reason("waves")


def test_an_archive_in_a_cube_writes_nothing(lab, tmp_path):
    mine = tmp_path / "my_bashrc"
    mine.write_text("mine")
    (lab / "cube.zarr/checksum").mkdir()
    with zipfile.ZipFile(lab / "cube.zarr/checksum/metadata.zip", "w") as archive:
        archive.writestr(str(mine), "not mine any more")
    wf.status("cube.zarr")
    wf.run("experiment.yaml", workflow=wf.Workflow(cluster="none"))
    assert mine.read_text() == "mine"


def test_a_verdict_without_its_checksum_is_not_believed(lab):
    data = json.loads((lab / "verdict.json").read_text())
    del data["checksum"]
    (lab / "verdict.json").write_text(json.dumps(data))
    with pytest.raises(StoreError, match="is not a verdict written by wavefield"):
        wf.status("cube.zarr")


def test_no_message_advises_to_remove_a_cube(lab):
    (lab / "cube.zarr/zarr.json").write_text("{")
    for read in (wf.open_cube, wf.open_run, wf.status, wf.verify):
        with pytest.raises(StoreError) as error:
            read(lab)
        assert "remove" not in str(error.value)


def test_stdout_on_a_full_disk_is_a_sentence(lab):
    with open("/dev/full", "w") as full:
        line = [sys.executable, "-m", "wavefield", "status", "cube.zarr"]
        found = subprocess.run(line, cwd=lab, stdout=full, stderr=subprocess.PIPE, text=True)
    assert found.returncode == 1
    assert "Traceback" not in found.stderr
    assert "did not foresee" not in found.stderr


def test_two_cameras_in_one_place_are_one_sentence(lab, capsys):
    data = yaml.safe_load((lab / "rig.yaml").read_text())
    data["cameras"]["cam3"] = data["cameras"]["cam1"]
    (lab / "rig.yaml").write_text(yaml.safe_dump(data))
    edit(lab / "experiment.yaml", "cam3/img", "cam1/img")
    assert command("check", "experiment.yaml") == 1
    assert "cam1 and cam3 are in one place" in capsys.readouterr().out


def test_a_pipe_in_the_place_of_a_verdict_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "verdict.json")
    with pytest.raises(StoreError, match="is a pipe or a device"):
        read_verdict(tmp_path / "cube.zarr")
