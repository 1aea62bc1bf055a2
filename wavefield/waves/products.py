"""The registry of what an analysis computes: a product is one file that registers what it needs and gives.

`wavefield.waves.analysis` starts from the values of `GIVEN`, runs every product whose inputs are there,
and puts those that name a group into the wave store. A new product is one module of this room (or one that a
user imports before the analysis), with for example

    register(WaveProduct("skewness", ("density_w", "depth"), skewness_group, group="statistics"))
"""

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from wavefield.errors import CubeError
from wavefield.variables import Variable
from wavefield.variables import register as register_variables

# values that every analysis has, before it computes products
GIVEN = {
    "cube": "the fields z, z_t, u, v, w, m and m/s",
    "complete_cube": "the cube as it was given, with all its variables and attributes",
    "each": "what does work on workers, or None",
    "depth": "of the water, m",
    "gamma": "surface tension over density, m3/s2",
    "gain": "of the matching windows, or None",
    "probes": "wave probes, or None",
    "filled": "what filled nodes add to E(omega) of z and w at most, by name",
    "given_current": "of the water, m/s, used where the fit is refused, or None",
    "map_frequencies": "of the maps E(ky, kx), Hz",
    "welch": "the record, its segments and rings",
    "mean_current": "means of u and v, and their standard uncertainties, m/s",
    "pairs": "fields whose cross spectra the pass over the cube has summed",
    # from the pass over the cube: products without these are computed, and their errors raised, before it
    "ring_sums": "powers and products over rings, and planes",
    "scale": "rough mean and standard deviation of each field",
    "survey_sums": "powers and counts of values about these",
    "balance_rows": "of the kinematic balance",
    "point_series": "w at points far apart, (time, points)",
}


@dataclass(frozen=True)
class WaveProduct:
    """One result of an analysis: the function that computes it, and the names of its inputs."""

    name: str
    inputs: tuple[str, ...]  # names of given values or of other products
    # Function of the inputs, in their order. It gives a value, None if there is none, or either with notes
    # (`Noted`). A product is left out where one of the products among its inputs has no value
    compute: Callable[..., Any]
    group: str = ""  # of the wave store that its variables belong to; empty: other products use the value
    variables: tuple[Variable, ...] = ()  # rows that the table of `wavefield.variables` lacks
    pairs: tuple[tuple[str, str], ...] = ()  # fields whose cross spectra the pass has to sum
    planes: tuple[
        str, ...
    ] = ()  # fields, or pairs "a*b", that the pass has to sum without averaging over angle
    without: str = ""  # beginning of the note where the record does not allow it; empty: the analysis fails
    cost: int = 0  # 0: quick; others are computed on workers, the largest first


class Noted(NamedTuple):
    """A value with notes for the user."""

    value: Any
    notes: Sequence[str]


_REGISTRY: dict[str, WaveProduct] = {}


def register(*products: WaveProduct) -> None:
    """Add products to the registry."""
    for product in products:
        if product.name in GIVEN or _REGISTRY.setdefault(product.name, product) != product:
            raise ValueError(f"there is a product or a given value {product.name!r} already")
        register_variables(*product.variables)


def registered() -> list[WaveProduct]:
    """All products of this room, and those that were registered before."""
    package = importlib.import_module(__package__)
    for module in pkgutil.walk_packages(package.__path__, f"{__package__}."):
        importlib.import_module(module.name)
    return list(_REGISTRY.values())


def compute_ready(
    waiting: list[WaveProduct], values: dict[str, object], each: Callable[..., Iterable[Any]] | None = None
) -> dict[str, Sequence[str]]:
    """Compute all products whose inputs are available, add them to the values, return their notes."""
    notes: dict[str, Sequence[str]] = {}
    while ready := [product for product in waiting if all(name in values for name in product.inputs)]:
        # all that is quick first, so that as many as possible of the others are computed side by side
        batch = [product for product in ready if not product.cost] or sorted(ready, key=lambda p: -p.cost)
        work = map if each is None or not batch[0].cost else each
        jobs = [(p.compute, [values[name] for name in p.inputs], p.without) for p in batch]
        for product, (value, product_notes) in zip(batch, work(_computed, jobs)):
            waiting.remove(product)
            notes[product.name] = product_notes
            if value is not None:
                values[product.name] = value
    return notes


def _computed(job: tuple[Callable[..., Any], Sequence[object], str]) -> Noted:
    compute, inputs, without = job
    with np.errstate(all="ignore"):
        try:
            value = compute(*inputs)
        except CubeError as error:
            if not without:
                raise
            return Noted(None, [f"{without}: {error}."])
    return value if isinstance(value, Noted) else Noted(value, [])
