"""Lost parts of a cube are reported, and the next run restores them bit for bit."""

import shutil

import pytest
from cube_cases import FOURS, different

from wavefield.commands.cli import main
from wavefield.errors import RunStopped, StoreError
from wavefield.pipeline import export, open_cube, run, status
from wavefield.store.layout import chunk_path
from wavefield.store.verify import verify


@pytest.fixture
def cube(measured, tmp_path):
    """The cube of a copy of the measured experiment, in three chunks."""
    shutil.copytree(measured, tmp_path, dirs_exist_ok=True)
    return tmp_path / "cube.zarr"


def remove(path):
    path.unlink()


def change(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 64
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    ("variable", "harm", "word"),
    [
        ("quality", change, "not as it was written: quality"),
        ("frame_status", remove, "missing: frame_status"),
    ],
)
def test_damage_is_found_named_and_measured_again(measured, cube, capsys, variable, harm, word):
    harm(chunk_path(cube, variable, 1))
    assert main(["-q", "verify", str(cube)]) == 1
    assert word in capsys.readouterr().out
    assert status(cube).left == 4
    run(cube.with_name("experiment.yaml"), workflow=FOURS)
    assert not different(measured / "cube.zarr", cube)
    assert main(["-q", "verify", str(cube)]) == 0


def test_a_missing_file_is_measured_again_without_being_asked(measured, cube):
    chunk_path(cube, "z", 1).unlink()
    with pytest.raises(StoreError, match="z/c/1/0/0 is missing"):
        open_cube(cube).z.load()
    run(cube.with_name("experiment.yaml"), workflow=FOURS)
    assert not different(measured / "cube.zarr", cube)


def test_a_damaged_file_is_an_error_that_names_it(cube):
    change(chunk_path(cube, "z", 1))
    with pytest.raises(StoreError, match=r"cube.zarr/z is damaged .*`wavefield verify"):
        open_cube(cube).z.load()
    assert open_cube(cube).z[:4].notnull().any()
    change(cube / "x/c/0")
    with pytest.raises(StoreError, match=r"cube.zarr is damaged .*copy the cube again"):
        verify(cube)


def test_a_cube_whose_disk_is_gone_is_an_error_and_not_missing_values(cube, tmp_path):
    opened = open_cube(cube)
    cube.rename(tmp_path / "moved.zarr")
    with pytest.raises(StoreError, match="no longer exists"):
        opened.to_netcdf(tmp_path / "x.nc", engine="h5netcdf")


@pytest.mark.parametrize("change", [('"frame_rate": 20.0', '"frame_rate": 40.0'), ("{", "")])
def test_changed_metadata_are_never_believed(cube, change):
    file = cube / "zarr.json"
    file.write_text(file.read_text().replace(*change, 1))
    for read in (open_cube, verify, status):
        with pytest.raises(StoreError, match=r"zarr.json .*copy the cube again"):
            read(cube)


def test_an_unfinished_cube_is_not_passed_on_in_silence(tank, tmp_path, capsys):
    def stop(done, total, sentence):
        if done >= 8:
            raise KeyboardInterrupt

    out = tmp_path / "cube.zarr"
    with pytest.raises(RunStopped):
        run(tank, out=out, workflow=FOURS, progress=stop)
    left = status(out).left
    with pytest.warns(UserWarning, match=f"of the 16 steps of .*, {left} are not measured yet"):
        export(out, tmp_path / "cube.nc")
    assert main(["-q", "export", str(out), str(tmp_path / "again.nc")]) == 3
    main(["-q", "analyze", str(out), "--segment", "8"])
    assert capsys.readouterr().err.count(f"{left} are not measured yet") >= 2
