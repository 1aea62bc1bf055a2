"""Runs: the same cube whatever the chunks, resumed after anything, never mixed, nothing lost."""

import os
import shutil
import signal
import subprocess
from contextlib import suppress

import numpy as np
import pytest
import tifffile
import xarray as xr
import zarr
from cube_cases import FRAMES, HERE, different, far_apart

from wavefield.commands.cli import main
from wavefield.errors import RunStopped, StoreError
from wavefield.execution.run_files import locked
from wavefield.measurement import sample_steps
from wavefield.pipeline import Workflow, chunk, open_cube, run, status
from wavefield.store import write_cube
from wavefield.store.cube import open_stored
from wavefield.store.layout import PACKING
from wavefield.store.verify import verify
from wavefield.variables import CUBE_FIELDS, FrameFault, FrameStatus, Quality, validate
from wavefield.waves.record import find_record

STEPS = FRAMES - 1


def chunks_of(size, **more):
    return Workflow(cluster="none", steps_per_block=size, **more)


@pytest.fixture
def measured(monkeypatch):
    """First steps of the chunks that are measured."""
    starts = []

    def counting(chunk, geometry, frame_rate, model):
        starts.append(chunk.start)
        return real(chunk, geometry, frame_rate, model)

    real = chunk.measure_chunk
    monkeypatch.setattr(chunk, "measure_chunk", counting)
    return starts


def stop_after(steps):
    """A progress function that interrupts the run, as Ctrl-C would."""

    def progress(done, total, sentence):
        if done >= steps:
            raise KeyboardInterrupt

    return progress


def test_a_cube_explains_itself(reference):
    cube = open_cube(reference)
    validate(cube, *CUBE_FIELDS, "frame_status", "time", "x", "y")
    assert cube.sizes["time"] == STEPS
    np.testing.assert_allclose(cube.time, (np.arange(STEPS) + 0.5) / 20.0)
    assert cube.attrs["frame_rate"] == 20.0
    assert cube.attrs["water_depth"] == 0.7
    recipe = cube.wavefield.recipe
    assert recipe["rig"]["cam3"]["size"] == [292, 207]
    assert recipe["grid"]["step"] == 0.01
    assert "piv" in recipe["settings"]
    assert recipe["software"]["numpy"] == np.__version__
    assert len(cube.attrs["recipe_hash"]) == 16
    assert (cube.frame_status == FrameStatus.DONE).all()
    assert float(np.isfinite(cube.z).mean()) > 0.95
    assert (cube.quality[0].values & Quality.TWO_FRAME_MEAN).all()  # the first step has no frame before it


def test_values_do_not_depend_on_the_size_of_blocks(tank, reference, tmp_path):
    run(tank, out=tmp_path / "cube.zarr", workflow=chunks_of(7))  # the reference is one chunk
    assert different(tmp_path / "cube.zarr", reference) == []


def test_packing_rounds_as_documented(tank, reference, tmp_path):
    run(tank, out=tmp_path / "cube.zarr", workflow=chunks_of(8, packing="int16"))
    packed, plain = open_cube(tmp_path / "cube.zarr").load(), open_cube(reference).load()
    for name, scale in PACKING.items():
        assert packed[name].dtype == "float32"
        np.testing.assert_array_equal(
            np.isnan(packed[name]), np.isnan(plain[name]) | (abs(plain[name]) > 32767 * scale)
        )
        error = abs(packed[name] - plain[name]).max()
        assert error <= 0.5001 * scale + 1e-6 * abs(plain[name]).max()
    assert zarr.open_group(tmp_path / "cube.zarr", mode="r")["z"].dtype == "int16"


def test_a_run_goes_beside_its_experiment_reports_is_logged_and_smooths_if_asked(own_tank):
    own_tank.write_text(own_tank.read_text() + "smooth: true\n")
    reported = []
    state = run(own_tank, workflow=chunks_of(8), progress=lambda *args: reported.append(args))
    cube = own_tank.parent / "cube.zarr"
    assert state.store == cube
    assert state.complete
    assert [done for done, _, _ in reported][-1] == STEPS
    assert any("left" in sentence for _, _, sentence in reported)
    log = (own_tank.parent / "cube.log").read_text()
    assert f"{STEPS} of {STEPS} steps" in log
    assert state.recipe_hash in log
    assert main(["-q", "smooth", str(cube), "-o", str(cube.with_name("again.zarr"))]) == 0
    stored, again = (xr.open_zarr(cube.with_name(name)).load() for name in ("smooth.zarr", "again.zarr"))
    assert "smoothed" in stored.attrs
    assert stored.z_std.notnull().any()
    assert stored.drop_attrs().identical(again.drop_attrs())
    with open_cube(cube) as measured_cube:
        assert (stored.u_std <= measured_cube.u_std).where(measured_cube.u_std.notnull()).mean() == 1


def test_an_interrupted_run_goes_on_with_what_is_missing(tank, reference, tmp_path, measured):
    out = tmp_path / "cube.zarr"
    with pytest.raises(RunStopped, match=f"stopped after 8 of {STEPS} steps; nothing is lost"):
        run(tank, out=out, workflow=chunks_of(4), progress=stop_after(8))
    assert status(out).left == STEPS - 8
    assert "run the same command again" in str(status(out))
    assert np.isnan(open_cube(out).z[8:]).all()
    run(tank, out=out, workflow=chunks_of(4))
    assert measured == [0, 4, 8, 12]
    assert different(out, reference) == []
    run(tank, out=out, workflow=chunks_of(4))
    assert measured == [0, 4, 8, 12]


def test_a_signal_stops_as_ctrl_c_does(tank, tmp_path):
    def progress(done, total, sentence):
        if done >= 4:
            os.kill(os.getpid(), signal.SIGUSR1)

    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(RunStopped, match="stopped by SIGUSR1 after 4 of"):
        run(tank, out=tmp_path / "cube.zarr", workflow=chunks_of(4), progress=progress)
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_time_limit_stops_the_run(tank, tmp_path, monkeypatch):
    def alarm_rings(chunk, geometry, frame_rate, model):
        left.append(signal.getitimer(signal.ITIMER_REAL)[0])
        signal.raise_signal(signal.SIGALRM)

    left = []
    monkeypatch.setattr(chunk, "measure_chunk", alarm_rings)
    with pytest.raises(RunStopped, match="stopped by its time limit after 0 of"):
        run(tank, out=tmp_path / "cube.zarr", workflow=chunks_of(4, time_limit="1h"))
    assert 0 < left[0] <= 3600
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


def test_a_block_is_not_done_before_all_its_data_are_there(tank, reference, tmp_path, monkeypatch):
    out = tmp_path / "cube.zarr"

    def dying(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(write_cube, "in_16_bits", dying)
    with pytest.raises(RunStopped):
        run(tank, out=out, workflow=chunks_of(8, packing="int16"))
    assert status(out).left == STEPS
    shutil.rmtree(out)
    with pytest.raises(RunStopped):
        run(tank, out=out, workflow=chunks_of(8), progress=stop_after(8))
    (out / "z" / "c" / "1" / "0").mkdir(parents=True)
    (out / "z" / "c" / "1" / "0" / f"0.{4 * 'deadbeef'}.partial").write_bytes(b"half a shard")
    run(tank, out=out, workflow=chunks_of(8))
    assert different(out, reference) == []
    assert not list(out.rglob("*.partial"))


def test_two_recipes_are_not_mixed(tank, tmp_path):
    out = tmp_path / "cube.zarr"
    with pytest.raises(RunStopped):
        run(tank, out=out, workflow=chunks_of(4), progress=stop_after(4))
    before = status(out)
    with pytest.raises(
        StoreError, match=r"another recipe \(settings.eps_limit: 3.0 there, 4.0 here\); write to another"
    ):
        run(tank, out=out, workflow=chunks_of(4, settings={"eps_limit": 4.0}))
    assert status(out) == before


def test_two_runs_do_not_write_one_store(tank, tmp_path):
    out = tmp_path / "cube.zarr"
    with locked(out), pytest.raises(StoreError, match="another run is writing"):
        run(tank, out=out, workflow=HERE)
    assert not out.exists()


def truncate(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def dim(path):
    """Black but for three dead pixels."""
    image = np.zeros_like(tifffile.imread(path))
    image[[3, 40, 70], [9, 50, 20]] = 200
    tifffile.imwrite(path, image)


def repeat(path):
    """The image of the frame before it, as recorders leave it when they lose one."""
    path.write_bytes((path.parent / f"img_{int(path.stem[4:]) - 1:05d}.tif").read_bytes())


def test_a_bad_frame_is_marked_and_the_rest_is_right(own_tank, reference):
    dim(own_tank.parent / "cam2" / "img_00005.tif")
    truncate(own_tank.parent / "cam2" / "img_00011.tif")
    state = run(own_tank, workflow=chunks_of(4))
    cube, good = open_cube(state.store).load(), open_cube(reference).load()
    touched = [4, 5, 10, 11]  # the two steps of each frame
    assert list(np.flatnonzero(cube.frame_status != FrameStatus.DONE)) == touched
    assert (cube.quality[touched].values & Quality.FEWER_CAMERAS).all()
    # the two steps on either side of these have a bad frame beside them
    for steps in (slice(0, 2), slice(14, 16)):
        assert far_apart(cube, good, steps) == []
    reported = {(b.camera, b.fault): b.numbers for b in state.bad_frames}
    assert reported == {("cam2", FrameFault.BLANK): (5,), ("cam2", FrameFault.UNREADABLE): (11,)}
    assert "cam2: " in str(state)
    assert "frame 5" in str(state)
    assert "frame 11" in str(state)
    assert "cam2 frame" in (own_tank.parent / "cube.log").read_text()
    run(own_tank, workflow=chunks_of(4))
    assert "measuring" not in (own_tank.parent / "cube.log").read_text(), "bad frames are still bad"


def test_a_frame_repeated_in_one_camera_leaves_the_other_steps_as_certain_as_they_are(own_tank, reference):
    number = sample_steps(16)[1]
    repeat(own_tank.parent / "cam1" / f"img_{number:05d}.tif")
    cube, good = open_cube(run(own_tank, workflow=chunks_of(8)).store).load(), open_cube(reference).load()
    apart = np.abs(np.arange(16) - (number - 0.5)) > 3
    for name in ("z_std", "u_std", "v_std", "w_std"):
        ratio = (cube[name] / good[name]).isel(time=apart).where(good.wavefield.flagged("measured"))
        assert 0.7 < float(ratio.median()) < 1.5, name


def test_steps_over_a_frame_lost_in_most_cameras_are_left_out_of_the_opened_cube(own_tank):
    lost, last = 5, FRAMES - 1  # few steps have only good frames around them
    for camera in ("cam1", "cam3"):
        files = sorted((own_tank.parent / camera).glob("*.tif"))
        for name, source in zip(files[lost:last], files[lost + 1 :]):
            shutil.move(source, name)
    found = run(own_tank, workflow=chunks_of(3))
    assert "record frame times" in found.verdict.line
    cube = open_cube(found.store).load()
    left_out = np.flatnonzero(cube.frame_status == FrameStatus.DISCONTINUOUS)
    assert left_out.tolist() == [2, 3, 4, 5, 6], "their six frames lie on both sides"
    for name in CUBE_FIELDS:
        missing = cube[name] == 0 if name == "quality" else cube[name].isnull()
        assert missing.isel(time=left_out).all()
        assert not missing.drop_isel(time=left_out).all()
    assert find_record(cube).runs == find_record(open_stored(found.store)).runs == ((0, 2), (7, 15))
    for stock in (xr.open_zarr(found.store), xr.open_dataset(found.store, engine="wavefield")):
        assert (stock.frame_status == cube.frame_status).all(), "as in the store"
        assert stock.z.isel(time=left_out).isnull().all()
    assert verify(found.store).sound


def test_repeated_frames_of_all_cameras_leave_no_values_whatever_the_chunks(own_tank, tmp_path):
    for camera in ("cam1", "cam2", "cam3"):
        repeat(own_tank.parent / camera / "img_00006.tif")  # the first frame that the chunk from step 8 uses
    state = run(own_tank, workflow=chunks_of(4))
    assert state.failed_steps == (5, 6)
    assert {bad.fault for bad in state.bad_frames} == {FrameFault.REPEATED}
    other = run(own_tank, tmp_path / "other.zarr", workflow=chunks_of(8))
    assert different(other.store, state.store) == []


def test_a_frame_that_was_copied_again_is_measured(own_tank, reference, measured):
    frames = [own_tank.parent / "cam1" / f"img_{n:05d}.tif" for n in (8, 13)]
    whole = [frame.read_bytes() for frame in frames]
    for frame in frames:
        frame.unlink()
    state = run(own_tank, workflow=chunks_of(4))
    assert state.bad_frames[0].numbers == (8, 13)
    frames[0].write_bytes(whole[0])
    measured.clear()
    state = run(own_tank, workflow=chunks_of(4))
    assert measured == [4, 8]
    assert state.bad_frames[0].numbers == (13,)
    frames[1].write_bytes(whole[1])
    state = run(own_tank, workflow=chunks_of(4))
    assert not state.bad_frames
    assert different(state.store, reference) == []


def test_steps_without_enough_cameras_fail_and_are_reported(own_tank):
    for camera in ("cam1", "cam2"):
        (own_tank.parent / camera / "img_00002.tif").unlink()
    state = run(own_tank, workflow=HERE)
    assert state.failed == 2
    assert state.failed_steps == (1, 2)
    assert "2 steps failed, from frame 1-2" in str(state)
    assert np.isnan(open_cube(state.store).z[1:3]).all()


def test_a_measurement_that_breaks_is_reported_and_tried_again(tank, reference, tmp_path, monkeypatch):
    out = tmp_path / "cube.zarr"

    def breaking(chunk, geometry, frame_rate, model):
        if chunk.start == 4:
            raise ZeroDivisionError("deep inside")
        return real(chunk, geometry, frame_rate, model)

    real = chunk.measure_chunk
    with monkeypatch.context() as patch:
        patch.setattr(chunk, "measure_chunk", breaking)
        with pytest.raises(
            StoreError, match=r"1 of 4 chunks failed, the first \(steps 4 to 7\) with ZeroDivisionError"
        ):
            run(tank, out=out, workflow=chunks_of(4))
    assert status(out).left == 4
    assert "deep inside" in (tmp_path / "cube.log").read_text()
    run(tank, out=out, workflow=chunks_of(4))
    assert different(out, reference) == []


def test_when_every_block_breaks_the_run_gives_up(tank, tmp_path, monkeypatch):
    calls = []

    def breaking(chunk, geometry, frame_rate, model):
        calls.append(chunk.start)
        raise ZeroDivisionError("always")

    monkeypatch.setattr(chunk, "measure_chunk", breaking)
    with pytest.raises(StoreError, match="always"):
        run(tank, out=tmp_path / "cube.zarr", workflow=chunks_of(1))
    assert len(calls) == 3


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1000 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = os.name == "posix" and hasattr(os, "geteuid") and os.geteuid() == 0
    if mounted:
        command = ["mount", "-t", "tmpfs", "-o", "size=1000k", "tmpfs", str(place)]
        mounted = (
            shutil.which("mount") is not None and subprocess.run(command, capture_output=True).returncode == 0
        )
    if not mounted:
        pytest.skip("needs the right to mount a small file system")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def fill(disk):
    """Leave no byte free."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as stream, suppress(OSError):
        while True:
            stream.write(bytes(512))
    return filler


def test_a_full_disk_is_one_sentence_and_nothing_is_lost(tank, reference, small_disk):
    out = small_disk / "cube.zarr"
    with pytest.raises(RunStopped):
        run(tank, out=out, workflow=chunks_of(4), progress=stop_after(4))
    filler = fill(small_disk)
    with pytest.raises(
        StoreError, match=r"the disk that holds .* is full.*; nothing that was written is lost"
    ) as caught:
        run(tank, out=out, workflow=chunks_of(4))
    assert "\n" not in str(caught.value)
    assert status(out).left == STEPS - 4
    assert different(out, reference, slice(0, 4)) == []
    filler.unlink()
    run(tank, out=out, workflow=chunks_of(4))
    assert different(out, reference) == []
