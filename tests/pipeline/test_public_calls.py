"""What a user asks before and after a run: check, status, export, catalogs, workflow files."""

import re

import intake
import numpy as np
import pytest
from cube_cases import HERE

from wavefield.commands.cli import main
from wavefield.errors import ExperimentError, StoreError
from wavefield.images import read_image, write_image
from wavefield.pipeline import Workflow, check, run, run_catalog, status
from wavefield.pipeline.catalog import catalog_add, find_experiment
from wavefield.store.ledger import BadFrames
from wavefield.variables import CUBE_FIELDS, FrameFault, FrameStatus


def test_check_reports_what_a_run_will_take(tank, reference):
    found = check(tank, workflow=HERE)
    assert found.problems == ()
    assert found.steps == 16
    assert [(c.name, c.frames, c.size) for c in found.cameras] == [
        ("cam1", 17, (123, 123)),
        ("cam2", 17, (123, 123)),
        ("cam3", 17, (292, 207)),
    ]
    assert found.coverage == 1.0
    assert found.measured > 0.9
    stored = sum(
        file.stat().st_size
        for name in CUBE_FIELDS
        for file in (reference / name / "c").rglob("*")
        if file.is_file()
    )
    assert 0.5 * stored < found.cost.disk < 2 * stored
    assert 0.001 < found.cost.step_seconds < 10
    assert 1e8 < found.cost.memory < 3e9
    text = str(found)
    for words in (
        "17 frames of 292 x 207 px, uint8",
        "grid: x -0.04 to 0.04 m",
        "9 x 13 nodes",
        "100 % of the nodes",
    ):
        assert words in text
    assert "a run will take" in text


def test_check_names_what_is_missing_and_does_not_stop_there(own_tank):
    folder = own_tank.parent
    for n in (3, 4, 9):
        (folder / "cam1" / f"img_{n:05d}.tif").unlink()
    (folder / "cam2" / "img_00005.tif").write_bytes(b"")
    found = check(own_tank, workflow=HERE)
    assert [camera.bad for camera in found.cameras] == [
        (BadFrames("cam1", FrameFault.MISSING, (3, 4, 9)),),
        (BadFrames("cam2", FrameFault.UNREADABLE, (5,)),),
        (),
    ]
    assert "cam1: 14 frames" in str(found)
    assert "cam1: missing: frame 3-4, 9" in str(found)
    (folder / "rig.yaml").unlink()
    found = check(own_tank, workflow=HERE)
    assert found.problems
    assert "not ready: " in str(found)
    assert "rig.yaml" in str(found)
    assert found.cost is None
    assert not (folder / "cube.zarr").exists()


def test_check_distinguishes_uniform_images_from_truncated_ones(own_tank):
    folder = own_tank.parent
    for path in (folder / "cam3").glob("*.tif"):
        write_image(path.with_suffix(".png"), read_image(path))
        path.unlink()
    own_tank.write_text(own_tank.read_text().replace("cam3/img_{frame:05d}.tif", "cam3/img_{frame:05d}.png"))
    for n in (2, 3, 6):
        write_image(folder / "cam3" / f"img_{n:05d}.png", np.zeros((207, 292), np.uint8))
    write_image(folder / "cam3" / "img_00008.png", np.eye(100, dtype=np.uint8))
    whole = folder / "cam3" / "img_00011.png"
    whole.write_bytes(whole.read_bytes()[:1000])
    camera = check(own_tank, workflow=HERE).cameras[2]
    assert {bad.fault: bad.numbers for bad in camera.bad} == {
        FrameFault.UNREADABLE: (11,),
        FrameFault.BLANK: (2, 3, 6),
        FrameFault.WRONG_SIZE: (8,),
    }


def test_check_counts_frames_as_run_does_and_names_their_files(own_tank):
    own_tank.write_text(own_tank.read_text().replace('.tif"}', '.tif", offset: 100}'))
    (own_tank.parent / "cam1" / "img_00003.tif").unlink()
    for n in (14, 15, 16):
        (own_tank.parent / "cam2" / f"img_{n:05d}.tif").unlink()
    found = check(own_tank, workflow=HERE)
    assert "cam1: missing: frame 103" in str(found.cameras[0])
    assert "; not used: 3 after the record" in str(found.cameras[0])
    assert found.steps == 13
    assert found.cameras[1].bad == ()  # no gaps are invented at the ends
    state = run(own_tank, workflow=HERE)
    assert [str(bad) for bad in state.bad_frames] == ["cam1: missing: frame 103"]
    assert state.steps == 13


def test_status_of_a_whole_cube(reference):
    state = status(reference)
    assert state.complete
    assert (state.done, state.faulty, state.failed, state.left) == (16, 0, 0, 0)
    assert "16 of 16 steps (100 %)" in str(state)
    with pytest.raises(StoreError, match="no such store"):
        status("nowhere.zarr")


@pytest.fixture
def catalog(own_tank, tmp_path):
    """Two runs: the small tank, and the same under another name."""
    other = own_tank.with_name("other.yaml")
    other.write_text(own_tank.read_text().replace("small-tank", "other-tank") + "frames: {last: 5}\n")
    own_tank.write_text(own_tank.read_text() + "frames: {last: 7}\n")
    path = tmp_path / "lab" / "tanks.yaml"
    assert catalog_add(path, own_tank) == "small-tank"
    assert catalog_add(path, other) == "other-tank"
    return path


def test_stock_intake_opens_frames_and_cubes_of_every_run(catalog, tmp_path):
    for state in run_catalog(catalog, workflow=HERE):
        assert state.complete
    cat = intake.open_catalog(str(catalog))
    assert list(cat) == ["frames", "cube", "waves"]
    for name, steps in (("small-tank", 7), ("other-tank", 5)):
        frames = cat(run=name)["frames"].read()
        assert frames.cam3.image.shape == (steps + 1, 207, 292)
        assert frames.attrs["experiment"] == name
        cube = cat(run=name)["cube"].read()
        assert cube.sizes["time"] == steps
        assert cube.attrs["experiment"] == name
        assert (cube.frame_status == FrameStatus.DONE).all()
    away = tmp_path / "away"
    (catalog.parent.parent / "tank").rename(away)
    path = catalog.with_suffix("") / "small-tank" / "experiment.yaml"
    path.unlink()
    path.write_text((away / "experiment.yaml").read_text())
    assert (
        len(find_experiment(catalog, {"run": "small-tank", "location": str(away)}).open_frames()["cam1"]) == 8
    )
    with pytest.raises(ValueError, match="validate"):
        cat(run="nobody")["frames"]


def test_a_changed_recipe_goes_beside_the_old(catalog):
    (first,) = run_catalog(catalog, ["other-tank"], workflow=HERE)
    changed = Workflow(cluster="none", settings={"eps_limit": 2.5})
    (second,) = run_catalog(catalog, ["other-tank"], workflow=changed)
    assert first.store != second.store
    assert status(first.store).complete
    cat = intake.open_catalog(str(catalog))
    recipes = cat.user_parameters["recipe"].options
    assert recipes == ["latest", first.recipe_hash[:8], second.recipe_hash[:8]]
    found = {r: cat(run="other-tank", recipe=r)["cube"].read().attrs["recipe_hash"] for r in recipes}
    assert found["latest"] == found[recipes[2]] == second.recipe_hash
    assert found[recipes[1]] == first.recipe_hash
    (again,) = run_catalog(catalog, ["other-tank"], workflow=changed)
    assert again.store == second.store
    assert intake.open_catalog(str(catalog)).user_parameters["recipe"].options == recipes


def test_catalog_mistakes_are_named(catalog, own_tank, tmp_path):
    assert catalog_add(catalog, own_tank) == "small-tank"  # twice does no harm
    with pytest.raises(ExperimentError, match="has no run 'run99'; it has small-tank, other-tank"):
        run_catalog(catalog, ["run99"], workflow=HERE)
    with pytest.raises(ExperimentError, match="has no parameter 'place'; it has run, recipe, location"):
        run_catalog(catalog, ["other-tank"], workflow=HERE, parameters={"place": "here"})
    with pytest.raises(ExperimentError, match="one store cannot hold 2 runs"):
        run_catalog(catalog, out=tmp_path / "cube.zarr", workflow=HERE)
    elsewhere = tmp_path / "elsewhere" / "experiment.yaml"
    elsewhere.parent.mkdir()
    elsewhere.write_text(own_tank.read_text())
    with pytest.raises(ExperimentError, match="already has another run 'small-tank'"):
        catalog_add(catalog, elsewhere)
    assert catalog_add(catalog, elsewhere, "small-tank-b") == "small-tank-b"
    with pytest.raises(ExperimentError, match="no parameter `run`"):
        catalog_add(own_tank, own_tank)


def test_a_campaign_is_checked_measured_verified_analysed_and_compared(catalog, capsys, undrawn):
    lab, here = str(catalog), ["--workflow", str(catalog.with_name("here.yaml"))]
    catalog.with_name("here.yaml").write_text("cluster: none\n")
    printed = capsys.readouterr
    assert main(["-q", "check", lab, "other-tank", *here]) == 0
    assert "other-tank (1 of 1)" in (out := printed().out)
    assert "other-tank: sound" in out
    assert main(["-q", "verify", lab]) == 1
    assert "small-tank is not measured yet; run: wavefield run CATALOG small-tank" in printed().err
    assert main(["run", lab, *here]) == 0
    assert "Measuring other-tank (2 of 2)" in printed().err
    assert main(["-q", "verify", lab]) == 0
    assert "5 of 5 steps are done, and none of them is damaged" in printed().out
    assert main(["-q", "analyze", lab, "--segment", "8"]) == 1  # 7 and 5 steps
    assert printed().err.count("segment") >= 2
    assert main(["-q", "report", lab]) == 0
    page = catalog.with_suffix(".html").read_text()
    assert "2 of 2 runs measured" in page
    assert page.count(">sound<") == 2
    link = re.search(r'href="(tanks/small-tank/[0-9a-f]{8}|tanks/small-tank/latest)/report.html"', page)
    assert link
    assert (catalog.parent / link[0][6:-1]).exists()
    assert main(["-q", "verify", str(catalog.with_name("here.yaml")), "small-tank"]) == 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("cluster: local\nworker: 3", "line 2: worker is not a known key; did you mean 'workers'?"),
        ("memory: much", "line 1: memory"),
        ("cluster: address", "needs the scheduler's address, for example address: tcp://host:8786"),
        ("steps_per_block: 0", "line 1: steps_per_block should be greater than or equal to 1"),
    ],
)
def test_mistakes_in_a_workflow_are_named(tmp_path, text, expected):
    path = tmp_path / "workflow.yaml"
    path.write_text(text + "\n")
    with pytest.raises(ExperimentError) as caught:
        Workflow.load(path)
    assert expected in str(caught.value)


@pytest.mark.parametrize("text", ["11h 50m", "3 hours", "600", "04:00:00", "1d 2h"])
def test_time_limits_are_durations(text):
    assert Workflow(time_limit=text).time_limit_seconds > 0
