"""Name, clock and water are labels: changing them re-labels a cube, and no step is measured again."""

import shutil

import numpy as np
import pytest
import xarray as xr
from cube_cases import HERE, different

from wavefield.commands.cli import main
from wavefield.errors import StoreError
from wavefield.images import read_image, write_image
from wavefield.pipeline import chunk, open_cube, open_run, run
from wavefield.store.preview import read_steps, read_thinned, thinning
from wavefield.store.read import open_group
from wavefield.store.relabel import RATES


@pytest.fixture
def cube(own_tank, reference, monkeypatch):
    """The cube of the small tank beside its file, and no means to measure."""
    for path in reference.parent.glob("cube*"):
        copy = shutil.copytree if path.is_dir() else shutil.copy
        copy(path, own_tank.parent / path.name)

    def never(*_):
        raise AssertionError("a step was measured again")

    monkeypatch.setattr(chunk, "measure_chunk", never)
    return own_tank.parent / "cube.zarr"


def change(path, *pairs):
    text = path.read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


def test_changed_labels_relabel_a_cube(own_tank, cube, reference):
    before = open_cube(reference).load()
    change(own_tank, ('.tif"}', '.tif", offset: -123}'), ("depth: 0.7", "depth: 0.65"), ("small-", "large "))
    change(own_tank, ("frame_rate: 20.0", "description: a second look\nframe_rate: 25.0"))
    run(own_tank, workflow=HERE)
    after = open_cube(cube).load()
    np.testing.assert_allclose(after.time, (np.arange(16) - 123 + 0.5) / 25.0)
    assert int(after.frame[0]) == -123
    for name in ("z", "eps_y", "eps_piv", "z_std", "quality", "frame_status"):
        np.testing.assert_array_equal(after[name], before[name])
    assert set(RATES) == {"z_t", "u", "v", "w", "u_std", "v_std", "w_std"}
    for name in RATES:
        assert after[name].dtype == np.float32
        np.testing.assert_allclose(after[name], 1.25 * before[name], rtol=2e-7)
    assert after.attrs["water_depth"] == 0.65
    assert after.attrs["experiment"] == after.wavefield.recipe["experiment"] == "large tank"
    assert after.attrs["description"] == "a second look"
    assert after.wavefield.recipe["software"] == before.wavefield.recipe["software"]
    assert "labelled anew, nothing is measured again: frame_rate" in (cube.parent / "cube.log").read_text()
    plain = xr.open_zarr(cube)  # by stock readers alike
    np.testing.assert_allclose(plain.w, after.w, rtol=1e-7)
    assert float(plain.time[0]) == float(after.time[0])


def test_what_reads_the_cube_by_itself_sees_the_new_rate(own_tank, cube, reference):
    wide = np.asarray(open_cube(reference).w[3:5])
    change(own_tank, ("frame_rate: 20.0", "frame_rate: 40.0"))
    run(own_tank, workflow=HERE)
    group = open_group(cube)
    np.testing.assert_allclose(read_steps(group, "w", 3, 5), 2 * wide, rtol=2e-7)
    thin = thinning(group)
    row = thin.names.index("w")
    shown = read_thinned(group, thin, 0, 16)[row, ..., 3] * np.float64(thin.scales[row])
    np.testing.assert_allclose(shown, 2 * wide[0, :: thin.every, :: thin.every], atol=1.01e-4)


def test_a_report_does_not_show_waves_of_another_rate(own_tank, cube, undrawn):
    assert main(["-q", "analyze", str(cube), "--segment", "8"]) == 0
    assert open_run(cube).waves is not None
    change(own_tank, ("frame_rate: 20.0", "frame_rate: 25.0"))
    run(own_tank, workflow=HERE)
    found = open_run(cube)
    assert found.waves is None
    assert "has changed since" in found.reason("waves")


def test_labels_go_there_and_back_bit_for_bit(own_tank, cube, reference):
    for old, new in (("20.0", "17.3"), ("17.3", "20.0")):
        change(own_tank, (f"frame_rate: {old}", f"frame_rate: {new}"))
        run(own_tank, workflow=HERE)
    assert not different(cube, reference)


def test_a_resumed_run_measures_on_at_the_rate_of_the_store(own_tank, reference, tmp_path):
    change(own_tank, ("frame_rate: 20.0", "frame_rate: 25.0"))
    cube = tmp_path / "cube.zarr"
    shutil.copytree(reference, cube)
    (cube / "w/c/0/0/0").unlink()
    (cube / "frame_status/c/0").unlink()
    run(own_tank, cube, workflow=HERE)
    np.testing.assert_allclose(open_cube(cube).w, 1.25 * open_cube(reference).w, rtol=2e-7)
    change(own_tank, ("frame_rate: 25.0", "frame_rate: 20.0"))
    run(own_tank, cube, workflow=HERE)
    assert not different(cube, reference)


def test_a_moment_of_one_camera_is_no_label(own_tank, cube):
    change(own_tank, ('cam1/img_{frame:05d}.tif"', 'cam1/img_{frame:05d}.tif", offset: 1'))
    with pytest.raises(StoreError, match=r"another recipe \(.*images.cam1"):
        run(own_tank, workflow=HERE)


def test_other_images_under_the_same_names_are_refused(own_tank, cube):
    path = own_tank.parent / "cam2" / "img_00008.tif"
    write_image(path, np.ascontiguousarray(read_image(path)[:, ::-1]))
    with pytest.raises(StoreError, match=r"begun with other images: cam2 frame 8 .*is not what it was"):
        run(own_tank, workflow=HERE)


def test_a_relabelling_that_was_cut_off_is_done_by_the_next_run(own_tank, cube, reference, monkeypatch):
    class Cut(Exception):
        pass

    def cut(*_):
        raise Cut

    change(own_tank, ("frame_rate: 20.0", "frame_rate: 25.0"))
    monkeypatch.setattr("wavefield.store.metadata._write_sealed", cut)
    with pytest.raises(Cut):
        run(own_tank, workflow=HERE)
    monkeypatch.undo()
    run(own_tank, workflow=HERE)
    np.testing.assert_allclose(xr.open_zarr(cube).w, 1.25 * open_cube(reference).w, rtol=2e-7)


def test_nothing_is_written_where_nothing_changed(own_tank, cube, monkeypatch):
    run(own_tank, workflow=HERE)  # the place of the file is a label as well
    monkeypatch.setattr("wavefield.store.relabel._write", lambda *_: pytest.fail("written"))
    run(own_tank, workflow=HERE)
