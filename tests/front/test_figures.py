"""Figures are functions of datasets: they draw the given fields, with labels and units."""

import numpy as np
import pytest
import xarray as xr
from figure_checks import text_faults
from matplotlib.figure import Figure

from wavefield import figures
from wavefield import waves as wv
from wavefield.grid import Grid
from wavefield.tank import paper_rig


def labels(figure: Figure) -> str:
    words = []
    for ax in [*figure.axes, *(bar for panel in figure.axes for bar in panel.child_axes)]:
        words += [ax.get_xlabel(), ax.get_ylabel(), ax.get_title(), ax.get_title(loc="left")]
        words += ax.get_legend_handles_labels()[1]
    return " | ".join(words)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("surface_3d", ["w (cm s⁻¹)", "x (m)", "t = 0.525 s"]),
        ("velocity_map", ["w (cm s⁻¹)", "y (m)"]),
        ("kinematics_maps", ["nonlinear term", "residual", "cm s⁻¹"]),
    ],
)
def test_pictures_of_one_step(cube, name, words):
    figure = getattr(figures, name)(cube.isel(time=10))
    assert text_faults(figure) == []
    for word in words:
        assert word in labels(figure)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("distributions", ["z (cm)", "dx = u dt", "Gaussian", "probability density (cm⁻¹)"]),
        ("coverage_map", ["fraction of time (%)", "filled from neighbours"]),
        ("fault_history", ["time (s)", "rejected by correlation"]),
        ("misfit_maps", ["rms eps_y (mm)", "rms eps' (px)"]),
        ("uncertainty_maps", ["z_std (mm)", "w_std (mm s⁻¹)"]),
    ],
)
def test_pictures_of_a_cube(cube, name, words):
    figure = getattr(figures, name)(cube)
    assert text_faults(figure) == []
    for word in words:
        assert word in labels(figure)


def test_colour_scale_of_a_signed_field_is_balanced_and_holes_stay_grey(cube):
    figure = figures.velocity_map(cube.isel(time=10))
    mesh = figure.axes[0].collections[0]
    low, high = mesh.get_clim()
    assert low == -high
    drawn = mesh.get_array()
    assert np.ma.count_masked(drawn) == int(np.isnan(cube.w.isel(time=10)).sum())


def test_map_has_y_upwards_and_nodes_at_cell_centres(cube):
    field = xr.zeros_like(cube.w.isel(time=0)).fillna(0.0)
    field[3, 5] = 1.0
    figure = figures.velocity_map(xr.Dataset(dict.fromkeys("uvw", field)))
    mesh = figure.axes[0].collections[0]
    corners = mesh.get_coordinates()
    row, column = np.argwhere(mesh.get_array().reshape(field.shape) == 100.0)[0]
    centre = corners[row : row + 2, column : column + 2].reshape(-1, 2).mean(axis=0)
    np.testing.assert_allclose(centre, [cube.x[5], cube.y[3]], atol=1e-12)


def test_errors_are_drawn_in_pixels(cube):
    errors = (0.02 * cube[["z", "u", "v", "w"]]).assign_attrs(frame_rate=20.0)
    figure = figures.error_distributions(errors, 1.8e-3)
    assert f"σ = {float(errors.z.std()) / 1.8e-3:.3g} px" in labels(figure)


def test_rig_is_drawn_with_its_cameras():
    rig, grid = paper_rig(), Grid((-1, 1), (-0.75, 0.75), 0.01)
    views = figures.rig_views(rig, grid)
    assert text_faults(views) == []
    text = labels(views)
    for name in rig:
        assert f"view of {name}" in text
    frames = {name: np.zeros(rig[name].size[::-1], "uint8") for name in rig}
    picture = figures.camera_frames(frames, rig, grid)
    assert "cam3, middle 10 cm" in labels(picture)


def test_pairs_of_cameras_are_compared_in_pixels():
    from wavefield.reports.accuracy import pair_differences, pair_misfits, pair_rows

    pixel, centres = 1.8e-3, np.linspace(-4.95, 4.95, 100)
    errors = (  # quantity, cameras, units, rms
        ("eps_y", "3-1", "m", 0.5e-3),
        ("eps_piv", "1-2-3", "pixel", 0.2),
        ("z", "3-1 minus 3-2", "m", 0.9e-3),
        ("z_recombined", "1-2", "m", 0.09e-3),
        ("dz", "3-2 minus 1-2", "m", 0.36e-3),
    )
    quantities, cameras, units, rms = zip(*errors)
    normal = np.exp(-(centres**2) / 2) / np.sqrt(2 * np.pi)
    found = xr.Dataset(
        {"rms": ("error", list(rms)), "beyond": ("error", [0.01] * 5)}
        | {"density": (("error", "bin"), [normal] * 5)},
        {"bin": centres, "quantity": ("error", list(quantities)), "cameras": ("error", list(cameras))}
        | {"units": ("error", list(units))},
        {"pixel_size": pixel, "steps": [0, 4]},
    )
    text = labels(pair_misfits(found))
    assert "3-1, rms 0.5 mm" in text
    assert "1-2-3, rms 0.2 px" in text
    curve = pair_misfits(found).axes[0].lines[0]
    assert np.trapezoid(curve.get_ydata(), curve.get_xdata()) == pytest.approx(1.0, abs=1e-3)
    text = labels(pair_differences(found))
    assert "3-1 minus 3-2, rms 0.5 px" in text
    assert "1-2 recombined minus direct, rms 0.05 px" in text
    assert "3-2 minus 1-2, rms 0.2 px" in text
    assert ("(z 3-1 − z 3-2) / √2", "0.064", "0.35", "1.0 %", "0.057 cm") in pair_rows(found)
    assert ("displacements differ (eps'), 1-2-3", "", "0.2", "1.0 %", "0.34 to 0.37 px") in pair_rows(found)


@pytest.fixture(scope="module")
def waves(cube):
    from wavefield.waves import analyze

    return analyze(cube)


@pytest.mark.parametrize(
    ("name", "groups", "words"),
    [
        ("komega_map", ["spectra", "dispersion"], ["ω / 2π (Hz)", "linear dispersion relation"]),
        ("wavevector_map", ["spectra", "dispersion"], ["kx / 2π (m⁻¹)", "Hz"]),
        ("wavenumber_spectra", ["spectra"], ["E(k) (m³ s⁻² rad⁻¹)", "(u − U)·∇z"]),
        ("elevation_spectra", ["spectra"], ["E$^z$(ω) (m² s rad⁻¹)", "stereo z", "integrated w", "fusion"]),
        ("directions", ["direction"], ["direction of travel (degrees from x)"]),
        ("coherence_curves", ["coherence"], ["z_t with w − u·∇z", "chance (5 %)"]),
    ],
)
def test_pictures_of_the_waves(waves, name, groups, words):
    figure = getattr(figures, name)(*(waves[group].to_dataset() for group in groups))
    assert text_faults(figure) == []
    for word in words:
        assert word in labels(figure)


def test_pictures_of_crests_and_increments():
    rng = np.random.default_rng(0)
    axes = {"time": np.arange(512) * 0.05, "y": np.arange(16) * 0.05, "x": np.arange(20) * 0.05}
    phase = 40 * axes["x"] - 20 * axes["time"][:, None, None] + 6.28 * rng.random((16, 1))
    at, wave = ("time", "y", "x"), 0.01 * np.cos(phase) + 0.002 * rng.standard_normal((512, 16, 20))
    cube = xr.Dataset(
        {n: (at, wave.astype("f4"), {"units": "m" if n == "z" else "m s-1"}) for n in ("z", "u", "v", "w")},
        axes,
    )
    drawn = {
        "Tayfun": figures.crest_curves(wv.crest_statistics(cube)),
        "flatness S₄ / S₂²": figures.flatness_curves(wv.structure_functions(cube.u)),
    }
    for word, figure in drawn.items():
        assert text_faults(figure) == []
        assert word in labels(figure)


def test_dispersion_curve_of_the_map_is_exact(waves):
    figure = figures.komega_map(waves["spectra"].to_dataset(), waves["dispersion"].to_dataset())
    named = {line.get_label(): line for line in figure.axes[0].lines}
    curve = named["linear dispersion relation"].get_xydata()
    k, hertz = curve[len(curve) // 3]
    exact = np.sqrt((9.81 * 2 * np.pi * k + 7.28e-5 * (2 * np.pi * k) ** 3) * np.tanh(2 * np.pi * k * 0.7))
    assert hertz == pytest.approx(exact / (2 * np.pi), rel=2e-3)
