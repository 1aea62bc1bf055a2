"""Runs from recordings whose files contain the times of their images."""

import numpy as np
from cube_cases import FRAMES, HERE, far_apart

from tests.series.test_series_recordings import write_seq
from wavefield.images import read_image
from wavefield.pipeline import check, open_cube, run

RATE = 20.0


def test_nothing_is_measured_across_images_that_all_cameras_dropped(own_tank, reference):
    folder = own_tank.parent
    kept = [n for n in range(FRAMES) if n not in (6, 7)]
    for number, name in enumerate(("cam1", "cam2", "cam3")):
        images = [read_image(folder / name / f"img_{n:05d}.tif") for n in kept]
        write_seq(folder / f"{name}.seq", 8, 1e9 + number + np.array(kept) / RATE, images, RATE)
    own_tank.write_text(own_tank.read_text().replace("/img_{frame:05d}.tif", ".seq"))
    assert "cam2: missing: frame 6-7" in str(check(own_tank, workflow=HERE))
    state = run(own_tank, workflow=HERE)
    assert state.failed_steps == (5, 6, 7)
    assert {bad.numbers for bad in state.bad_frames} == {(6, 7)}
    assert ("cam3", "missing frames") in {(r.subject, r.kind) for r in state.verdict.remarks}
    cube, good = open_cube(state.store).load(), open_cube(reference).load()
    np.testing.assert_array_equal(cube.time, good.time)
    # the sample steps beside the gap are others: of 16 cm of water each gives another spectrum
    for steps in (slice(0, 3), slice(11, 16)):
        assert far_apart(cube, good, steps, most=0.5) == []
