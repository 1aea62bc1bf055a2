"""What is learned from sample frames of a record: how much of what is learned is waves."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.fft
from measurement_cases import around

from wavefield.grid import Grid
from wavefield.matching import Prior, displacement_area
from wavefield.matching.matching_gain import FOOTPRINT_VARIANCE, footprint
from wavefield.matching.matching_kernels import BLOCK
from wavefield.matching.prior import wavenumbers
from wavefield.measurement import GridGeometry, Model, Settings, learn, measure
from wavefield.measurement.field_samples import FieldSamples
from wavefield.measurement.flow import FlowEstimate
from wavefield.measurement.learn import _mean_flow, _shown
from wavefield.measurement.map_elevation import ElevationEstimate
from wavefield.tank import Scene, Tank


def test_water_at_rest_has_no_waves_and_its_uncertainty_is_that_of_noise(model):
    scene = Scene.load("rest").with_(rig={"crop": 0.22}, frames=6, surface={"brightness": 110.0})
    tank = Tank(scene)
    images = [tank.render(k) for k in range(6)]
    grid = Grid(x=(-0.18, 0.18), y=(-0.14, 0.14), step=0.01)
    still = GridGeometry(tank.rig, grid)
    record = learn([(images[k], images[k + 1]) for k in (1, 3)], still)
    assert record is not None
    assert record.elevation.waves < 0.5
    assert max(prior.waves for _, prior in record.displacement) < 0.3
    frames = {name: [image[name] for image in images] for name in tank.rig}
    found = measure(around(frames), still, 20.0, Model(still, record))
    inside = np.s_[0, 6:-6, 6:-6]
    ratio = np.abs([found[name][inside] / found[f"{name}_std"][inside] for name in "uvw"])
    assert 0.5 < np.mean(ratio < 1) < 0.98  # in so small a field weak waves of few blocks cannot be excluded
    assert np.mean(ratio > 3) < 0.02
    sea = model.record
    assert [sea.elevation.waves, *(prior.waves for _, prior in sea.displacement)] == [1.0] * 4


class FewBeads:
    """An elevation in units of the noise of a block, seen by three blocks in ten."""

    bare, area = 1.0, FOOTPRINT_VARIANCE

    def __init__(self, seed, law):
        rng = np.random.default_rng(seed)
        shape = 84, 90
        self.seen = rng.random(shape) < 0.3
        self.information = 0.3
        kx, ky = wavenumbers(shape)
        waves = rng.standard_normal(shape) * np.sqrt(law(np.hypot(kx, ky)))
        averaged = scipy.fft.idctn(waves * footprint(kx, ky, self.area), norm="ortho")
        self.field = (averaged + rng.standard_normal(shape)).astype(np.float32)[None]

    def estimate(self, modes):
        a = self.seen.astype(np.float32)
        nothing = np.zeros((1, *modes.shape), np.float32)
        waves = modes.solve(a[None], a * self.field, nothing, 1e-3, nothing, modes.factor(a))
        return ElevationEstimate(waves, nothing, (), a, 0.0, a > 1)

    def noise(self, modes):
        return None


def test_short_waves_between_few_beads_are_expected_as_high_as_they_are():
    def law(k):
        return 30.0 * np.exp(-3.0 * k)

    k = np.linspace(0.3, 0.8, 6)
    with ThreadPoolExecutor(1) as pool:
        flat = Prior.isotropic((0.0, np.pi), (10.0, 10.0), 0.3)
        samples = FieldSamples([FewBeads(seed, law) for seed in range(4)], flat, pool)
        prior = samples.prior
        for _ in range(3):
            prior = samples.better(samples.open(prior))
    found = prior.spectrum(k, 0.0 * k)[0] / law(k)
    expected = found * prior.expected(k, 0.0 * k)[0]
    assert np.exp(np.mean(np.log(found))) < 0.7
    assert 0.8 < np.exp(np.mean(np.log(expected))) < 1.25


@pytest.mark.parametrize("seed", range(3))
def test_the_mean_flow_of_a_sample_step_is_that_of_the_cameras_together(seed):
    rig = Scene.load("demo").with_(rig={"crop": 0.4}).build_rig()
    geometry = GridGeometry(rig, Grid((-0.2, 0.2), (-0.15, 0.15), 0.05), Settings())
    flow = np.random.default_rng(seed).normal(0, 0.02, 3)
    found = {}
    for name in geometry.velocity_cameras:
        sight = geometry.sights[name]
        x, y, z = (np.full(geometry.grid.shape, v) for v in (*geometry.middle, 0.0))
        moved = np.einsum("...ij,j->...i", sight.camera.jacobian(x, y, z), flow)
        valid = np.random.default_rng(1).random(x.shape) < 0.8
        noise = np.where(valid, 0.0, 30.0)
        found[name] = SimpleNamespace(u=moved[..., 0] + noise, v=moved[..., 1] - noise, valid=valid)
    dx, dy = _mean_flow(SimpleNamespace(displacements=found), geometry)
    assert (dx, dy) == pytest.approx(flow[:2], abs=1e-4)
    nothing = SimpleNamespace(displacements=dict(list(found.items())[:1]))
    assert _mean_flow(nothing, geometry) == (0.0, 0.0), "one camera determines no flow"


@pytest.mark.parametrize("bare", [1.0, 0.5])
def test_information_at_the_nodes_is_learned_of_either_component(bare):
    rig = Scene.load("demo").build_rig()
    geometry = GridGeometry(rig, Grid((-0.1, 0.2), (-0.15, 0.05), 0.05), Settings())
    prior = Prior.isotropic((0.04, 3.1), (1.0, 1e-3), 2.0)
    for name in geometry.velocity_cameras:
        camera = geometry.sights[name].camera
        shape = geometry.sights[name].lattice.shape
        found = FlowEstimate(*[None] * 4, np.indices(shape)[::-1].astype(np.float32), None)
        sample = SimpleNamespace(field=found.each, bare=bare, estimate=lambda modes, found=found: found)
        fields = SimpleNamespace(samples=[sample] * 2, pool=SimpleNamespace(map=map))
        X, Y = camera.project(geometry.x, geometry.y, 0.0)
        expected = [(p.mean() - 2.0) / BLOCK / prior.information / bare for p in (X, Y)]
        assert _shown(fields, prior, geometry, name) == pytest.approx(expected, rel=0.03)


def test_short_waves_of_two_cameras_are_not_taken_for_noise():
    """Waves that a field loses are noise to its scores, and more noise takes more waves, to the last one."""
    grid = {"x": (-0.28, 0.28), "y": (-0.21, 0.21), "step": 0.01}
    sea = {"kind": "random", "rms": 0.00124, "spectrum": {"kind": "jonswap", "peak": 4.6, "enhancement": 1.6}}
    sea |= {"direction": 112.0, "spread": 0.0, "shortest": 0.04, "period": 2.0}
    tank = Tank(
        Scene.load("two_cameras").with_(rig={"scale": 0.72, "crop": 0.31}, grid=grid, sea=sea, frames=4)
    )
    images = [tank.render(number) for number in range(4)]
    geometry = GridGeometry(tank.rig, Grid(**grid))
    record = learn([(images[0], images[1]), (images[2], images[3])], geometry)
    assert record is not None
    k = 2 * np.pi / 0.073 * BLOCK * geometry.pixel  # of the peak, rad per block
    assert record.elevation.signal_to_noise(np.array([k]), np.zeros(1)).mean() > 5.0


def test_displacements_are_those_of_areas_as_large_as_the_beads_images():
    grid = {"x": (-0.15, 0.15), "y": (-0.12, 0.12), "step": 0.01}
    areas = []
    for blur in (0.5, 1.6):
        scene = Scene.load("demo").with_(rig={"crop": 0.2}, grid=grid, light={"blur": blur}, frames=2)
        tank = Tank(scene)
        geometry = GridGeometry(tank.rig, Grid(**grid))
        record = learn([(tank.render(0), tank.render(1))], geometry)
        assert record is not None
        for name, prior in record.displacement:
            width = record.width(name) / geometry.sights[name].binning
            assert prior.area == displacement_area(width)
        areas.append(min(prior.area for _, prior in record.displacement))
    assert areas[1] > areas[0] + 0.5
