"""The registry of what an analysis computes."""

import xarray as xr
from waves_cases import linear_cube, random_waves

import wavefield.waves as wv
from wavefield.variables import TABLE, Variable
from wavefield.waves import products
from wavefield.waves.products import WaveProduct, register


def test_a_registered_product_is_part_of_the_store(monkeypatch):
    known = {product.name: product for product in products.registered()}
    monkeypatch.setattr(products, "_REGISTRY", known)
    monkeypatch.setitem(TABLE, "peaks/largest", None)
    del TABLE["peaks/largest"]
    register(
        WaveProduct(
            "peaks",
            ("density_w", "depth"),
            lambda density, depth: xr.Dataset({"largest": density.max()}, attrs={"depth": depth}),
            group="peaks",
            variables=(Variable("largest", (), "", "largest density of w", group="peaks"),),
        )
    )
    waves = wv.analyze(linear_cube(random_waves(n=20), 64, 16, 20, dx=0.03), segment=32, depth=0.7)
    assert float(waves["peaks"].largest) > 0
    assert waves["peaks"].largest.attrs["long_name"] == "largest density of w"
    assert waves["peaks"].attrs["depth"] == 0.7
