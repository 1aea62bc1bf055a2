"""Pages of cubes that no run wrote: Datasets, and stores that xarray wrote."""

import re

import numpy as np
import pytest
import xarray as xr

import wavefield as wf
from wavefield import figures
from wavefield.errors import CubeError
from wavefield.pipeline.foreign_cube import store_or_fields, stored_cube


@pytest.fixture(scope="module")
def cube():
    """A sea of free waves in 0.4 m of water, of a model."""
    rng = np.random.default_rng(3)
    axes = {"time": 1 + np.arange(160) * 0.05, "y": np.arange(20) * 0.05, "x": np.arange(24) * 0.05}
    k, angle = rng.uniform(8, 30, 40), rng.uniform(-np.pi, np.pi, 40)
    kx, ky, omega = k * np.cos(angle), k * np.sin(angle), wf.waves.dispersion(k, 0.4)
    a = 0.1 / k**1.5 * np.exp(2j * np.pi * rng.random(40))
    space = np.exp(1j * (kx[:, None, None] * axes["x"] + ky[:, None, None] * axes["y"][:, None]))
    turned = a * np.exp(-1j * np.outer(axes["time"], omega))

    def field(gain):
        values = np.tensordot(turned * gain, space, 1).real
        return xr.DataArray(values.astype("f4"), axes, ("time", "y", "x"))

    along = omega / np.tanh(0.4 * k) / k
    z, w, u, v = (field(gain) for gain in (1.0, -1j * omega, kx * along, ky * along))
    return wf.cube(z, u, v, w, velocity="instantaneous", depth=0.4)


def pictures(page):
    return len(re.findall("<img", page.read_text(encoding="utf-8")))


def test_report_and_look_take_a_dataset(cube, tmp_path):
    page = wf.report(cube, tmp_path / "report.html")
    assert pictures(page) >= 4
    shown = wf.look(cube)
    assert shown.url.startswith("http://localhost")
    shown.stop()


def test_paper_takes_a_cropped_cube_that_xarray_wrote(cube, tmp_path):
    path = tmp_path / "cropped.zarr"
    cropped = cube.isel(time=slice(16, None), x=slice(2, None))
    cropped.to_zarr(path, consolidated=False)
    page = wf.paper(path)
    assert page == tmp_path / "cropped_paper.html"
    assert pictures(page) >= 9
    assert "Ratio of the nonlinear term" in page.read_text(encoding="utf-8")
    with stored_cube(path) as store:
        kept = wf.open_cube(store)
        np.testing.assert_allclose(kept.z, cropped.z, atol=1e-7)
        assert (float(kept.water_depth), int(kept.path_frames)) == (0.4, 1)
        assert float(kept.time[0]) == pytest.approx(float(cropped.time[0]), abs=0.026)
        # what a run wrote is read where it is; what was changed since is not taken for it
        assert store_or_fields(kept)[1] is None
        assert store_or_fields(kept.assign(z=2 * kept.z))[1] is not None
        assert store_or_fields(kept.isel(x=slice(3, None)))[1] is not None
    assert not store.exists()


def test_a_cube_without_a_field_is_refused_by_name(cube, tmp_path):
    with pytest.raises(CubeError, match="no v, w"):
        wf.report(cube.drop_vars(["v", "w"]), tmp_path / "report.html")


def test_the_ratio_of_a_linear_sea_is_drawn_with_its_interval(cube):
    ratio = wf.nonlinear_ratio(cube)
    inner = ratio.isel(k=slice(2, 5))
    assert bool((inner.low_nonlinear_ratio_k < 1).all())
    assert bool((inner.high_nonlinear_ratio_k > 1).all())
    figure = figures.nonlinear_ratio_curves(ratio)
    assert [len(ax.collections) for ax in figure.axes] == [1, 1]


def test_the_reference_names_estimators_and_figures_that_exist():
    from pathlib import Path

    text = (Path(__file__).parents[2] / "docs" / "reference.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(wf\.[\w.]+)`.*? \| (.*) \|$", text, re.MULTILINE)
    assert len(rows) >= 17
    for estimator, drawn in rows:
        place = wf
        for part in estimator.split(".")[1:]:
            place = getattr(place, part)
        assert all(hasattr(figures, name) for name in re.findall(r"`(\w+)`", drawn))
