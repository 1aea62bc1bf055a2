"""The registry of what an analysis computes."""

import pytest
import xarray as xr
from waves_cases import linear_cube, random_waves

import wavefield.waves as wv
from wavefield.errors import CubeError
from wavefield.variables import TABLE, Variable
from wavefield.waves import products
from wavefield.waves.products import Noted, WaveProduct, compute_ready, register


def refused():
    raise CubeError("the record is too short")


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


def test_products_are_computed_in_the_order_of_their_inputs_and_left_out_where_one_is_missing():
    waiting = [
        WaveProduct("sum", ("double", "one"), lambda a, b: a + b),
        WaveProduct("double", ("one",), lambda a: 2 * a, cost=1),
        WaveProduct("nothing", ("one",), lambda a: Noted(None, ["nothing is there"])),
        WaveProduct("rests_on_nothing", ("nothing",), str),
        WaveProduct("short", (), refused, without="No result"),
        WaveProduct("later", ("sums",), str),
    ]
    values = {"one": 1}
    notes = compute_ready(waiting, values)
    assert values == {"one": 1, "double": 2, "sum": 3}
    assert notes["nothing"] == ["nothing is there"]
    assert notes["short"] == ["No result: the record is too short."]
    assert [product.name for product in waiting] == ["rests_on_nothing", "later"]


def test_an_unknown_option_of_the_analysis_is_named():
    with pytest.raises(TypeError, match="segments"):
        wv.analyze(xr.Dataset(), segments=8)
