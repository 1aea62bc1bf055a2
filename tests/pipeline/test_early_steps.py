"""A preview: some steps of the whole record first, for `look`, and nothing of it in the cube."""

import shutil

import numpy as np
import pytest
from cube_cases import FRAMES, HERE, different

from wavefield.errors import RunStopped
from wavefield.explorer.cube_record import CubeRecord
from wavefield.pipeline import Workflow, early, open_cube, run
from wavefield.store.early_preview import early_every, early_steps, early_thinning, read_early
from wavefield.store.preview import open_preview, preview_path
from wavefield.store.read import open_group

STEPS = FRAMES - 1


@pytest.fixture(autouse=True)
def every_third(monkeypatch):
    """Time for every third step, whatever the speed of this machine."""
    monkeypatch.setattr(early, "_choose_every", lambda prepared, left, until: 3)


def stop_in_preview(after):
    def progress(done, total, sentence):
        if sentence == "preview" and done >= after:
            raise KeyboardInterrupt

    return progress


def stop_after_preview(done, total, sentence):
    if sentence != "preview" and done > 0:
        raise KeyboardInterrupt


def stored(path):
    group = open_group(path)
    preview = open_preview(path, group)
    return {step: read_early(preview, step) for step in early_steps(path, preview)}


def interrupted(tank, path, progress, workflow=HERE):
    with pytest.raises(RunStopped):
        run(tank, path, workflow=workflow, preview=True, progress=progress)
    return stored(path)


def test_a_cube_with_a_preview_is_the_cube_without_one_and_no_early_step_is_left(tank, reference, tmp_path):
    path = tmp_path / "cube.zarr"
    calls = []
    found = run(tank, path, workflow=HERE, preview=True, progress=lambda *call: calls.append(call))
    assert found.complete
    assert different(path, reference) == []
    assert [call for call in calls if call[2] == "preview"] == [
        (k + 1, -(-STEPS // 3), "preview") for k in range(-(-STEPS // 3))
    ]
    assert stored(path) == {}
    assert calls[-(-STEPS // 3)][:2] == (0, STEPS)  # the run reports at once that it begins
    assert early_every(open_preview(path, open_group(path))) == 0
    assert not (preview_path(path) / "early").exists()


def test_early_steps_are_near_the_steps_of_the_cube_and_never_in_it(tank, reference, tmp_path):
    path = tmp_path / "cube.zarr"
    found = interrupted(tank, path, stop_in_preview(-(-STEPS // 3)))
    assert sorted(found) == list(range(0, STEPS, 3))
    assert (open_cube(path).frame_status == 0).all()
    assert np.isnan(open_cube(path).z).all()
    thin = early_thinning(open_group(path))
    assert thin.every == 1  # as the preview of so small a cube
    cube = open_cube(reference).load()
    for name in "zuvw":
        k, size = thin.names.index(name), float(np.sqrt(np.nanmean(cube[name].values ** 2)))
        for step, values in found.items():
            at = values[k].astype(float)
            at[at == -32768] = np.nan
            error = at * thin.scales[k] - cube[name][step].values
            assert np.isfinite(error).mean() > 0.9
            assert np.nanmedian(np.abs(error)) < 0.1 * size, (name, step)


def test_a_preview_that_was_killed_goes_on_with_the_same_values(tank, tmp_path, monkeypatch):
    whole = interrupted(tank, tmp_path / "whole.zarr", stop_in_preview(-(-STEPS // 3)))
    path = tmp_path / "cube.zarr"
    first = interrupted(tank, path, stop_in_preview(1))
    assert list(first) == [0]
    monkeypatch.setattr(early, "_choose_every", None)  # chosen once
    workers = Workflow(cluster="local", workers=2, dashboard=None)
    resumed = interrupted(tank, path, stop_in_preview(-(-STEPS // 3) - 1), workers)
    assert resumed.keys() == whole.keys()
    assert all(np.array_equal(resumed[step], whole[step]) for step in whole)


def test_a_page_shows_early_steps_until_their_chunk_is_measured(tank, reference, tmp_path):
    path = tmp_path / "cube.zarr"
    interrupted(tank, path, stop_after_preview, Workflow(cluster="none", steps_per_block=2))
    record = CubeRecord(path)
    assert record.preview.more_early()
    record.preview.load()
    assert not record.preview.more_early()
    assert np.flatnonzero(record.ledger).tolist() == [0, 1]
    assert record.preview.early_step(0) is None
    assert record.preview.early_step(2) == 3
    assert np.isfinite(record.preview.early_field("w", 3)).any()
    assert np.isnan(record.field("w", 3)).all()
    j, i = (n // 2 for n in record.preview.stored("z").shape[:2])
    finite = np.isfinite(record.preview.series("z", j, i))
    assert finite.tolist() == [k < 2 or k % 3 == 0 for k in range(STEPS)]
    assert record.preview.shown_steps(slice(0, 4)).tolist() == [0, 1, 3, 3]
    run(tank, path, workflow=HERE, preview=True)
    record.refresh()
    record.preview.load()
    assert record.preview.early_step(3) is None
    complete = CubeRecord(reference)
    complete.preview.load()
    assert np.array_equal(record.preview.fields, complete.preview.fields)


def test_damaged_early_steps_are_left_out_and_a_removed_preview_is_made_anew(tank, tmp_path):
    path = tmp_path / "cube.zarr"
    interrupted(tank, path, stop_in_preview(3))
    file = preview_path(path) / "early/c/0/0/0/0"
    file.write_bytes(bytes(b ^ 1 for b in file.read_bytes()))
    assert read_early(open_preview(path, open_group(path)), 0) is None
    record = CubeRecord(path)
    record.preview.load()
    assert 0 not in record.preview.early
    shutil.rmtree(preview_path(path))
    assert len(interrupted(tank, path, stop_in_preview(3))) == 3


def test_no_preview_where_the_run_takes_no_longer(tank, tmp_path, monkeypatch):
    monkeypatch.setattr(early, "_choose_every", lambda prepared, left, until: 1)
    calls = []

    def stop(*call):
        calls.append(call)
        raise KeyboardInterrupt

    assert interrupted(tank, tmp_path / "cube.zarr", stop) == {}
    assert "1 chunks to measure" in calls[0][2]  # no call of a preview before


@pytest.mark.parametrize("count", [1, 2, 3, 7, 8, 100])
def test_every_beginning_of_the_order_is_spread_over_the_record(count):
    order = early.bisecting(count)
    assert sorted(order) == list(range(count))
    for part in range(1, count + 1):
        gaps = np.diff(sorted([*order[:part], count]))
        assert gaps.max() <= 2 * -(-count // part)
