"""Registry of the results that an analysis computes, called products.

Each product names its inputs and the function that computes it. `wavefield.waves.analysis` starts from the
values in `GIVEN` and computes every product as soon as its inputs are known. Products that name a group are
written to the wave store. To add a product, write a module in this folder (or import your own module before
the analysis) that calls, for example,

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

# values that the analysis provides, each with its meaning
GIVEN = {
    "cube": "the fields z, z_t, u, v, w, m and m/s",
    "complete_cube": "the cube as the user gave it, with all its variables and attributes",
    "each": "map function that computes on the workers, or None",
    "depth": "water depth, m",
    "gamma": "surface tension over density, m3/s2",
    "gain": "amplitude gain of the matching windows, or None",
    "probes": "wave probes, or None",
    "filled": "upper limit of E(omega) added by interpolated nodes, for z and w",
    "given_current": "current, m/s, that is used if the fit is refused, or None",
    "welch": "the record, its Welch segments and the rings of its k plane",
    "mean_current": "means of u and v, and their standard uncertainties, m/s",
    "pairs": "pairs of fields whose cross spectra were summed",
    # results of the pass over the whole cube; products that need none are computed first, to fail early
    "ring_sums": "powers and cross products, summed over rings and over single cells of the k plane",
    "scale": "rough mean and standard deviation of each field",
    "survey_sums": "sums of powers, and histograms, of the fields in units of `scale`",
    "balance_rows": "rms of the terms of the kinematic condition at some steps",
    "point_series": "w at distant points, (time, points)",
}


@dataclass(frozen=True)
class WaveProduct:
    """One result of an analysis (a product): its name, the function that computes it, and its inputs."""

    name: str
    inputs: tuple[str, ...]  # names in `GIVEN`, or of other products
    # called with the inputs in order if all have values; returns a value, None or a `Noted`
    compute: Callable[..., Any]
    group: str = ""  # group of the wave store; empty if only other products use the value
    variables: tuple[Variable, ...] = ()  # its variables that are not in the table of `wavefield.variables`
    pairs: tuple[tuple[str, str], ...] = ()  # pairs of fields whose cross spectra it needs
    planes: tuple[str, ...] = ()  # fields, or pairs "a*b", that it needs for single cells of the k plane
    without: str = ""  # first words of the note if `compute` raises CubeError; empty: the analysis fails
    cost: int = 0  # 0: computed at once; others on the workers, the largest first


class Noted(NamedTuple):
    """The value of a product (None if the data do not allow one), with notes for the user."""

    value: Any
    notes: Sequence[str]


_REGISTRY: dict[str, WaveProduct] = {}


def register(*products: WaveProduct) -> None:
    """Add products and their variables to the registry; raise ValueError if a name is taken."""
    for product in products:
        if product.name in GIVEN or _REGISTRY.setdefault(product.name, product) != product:
            raise ValueError(f"there is a product or a given value {product.name!r} already")
        register_variables(*product.variables)


def registered() -> list[WaveProduct]:
    """Import all modules of `wavefield.waves`, and return every product that they registered."""
    package = importlib.import_module(__package__)
    for module in pkgutil.walk_packages(package.__path__, f"{__package__}."):
        importlib.import_module(module.name)
    return list(_REGISTRY.values())


def compute_ready(
    waiting: list[WaveProduct], values: dict[str, object], each: Callable[..., Iterable[Any]] | None = None
) -> dict[str, Sequence[str]]:
    """Compute all products in `waiting` whose inputs are known or become known; return notes by product name.
    Each computed product is removed from `waiting`, and its value is added to `values`. `each(work, items)`
    runs costly products on workers."""
    notes: dict[str, Sequence[str]] = {}
    while ready := [product for product in waiting if all(name in values for name in product.inputs)]:
        # quick products first, so that as many as possible of the others can run in parallel
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
    """Call the function of a product; `job` holds `compute`, its inputs and `without` (see `WaveProduct`).
    On CubeError, return a note made of `without` and the message; if `without` is empty, raise."""
    compute, inputs, without = job
    with np.errstate(all="ignore"):
        try:
            value = compute(*inputs)
        except CubeError as error:
            if not without:
                raise
            return Noted(None, [f"{without}: {error}."])
    return value if isinstance(value, Noted) else Noted(value, [])
