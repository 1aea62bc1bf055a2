"""Variables of a cube whose errors name the file."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from wavefield.store.layout import named_damage


class _NamedArray(BackendArray):
    """A lazy array of a store; what goes wrong when it is read is a `StoreError` with its path."""

    def __init__(self, path: Path, variable: xr.Variable) -> None:
        self.path, self.variable = path, variable
        self.shape, self.dtype = variable.shape, variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> np.ndarray:
        support = indexing.IndexingSupport.OUTER
        out: np.ndarray = indexing.explicit_indexing_adapter(key, self.shape, support, self._read)
        return out

    def _read(self, key: tuple[Any, ...]) -> np.ndarray:
        with named_damage(self.path):
            return np.asarray(self.variable[key].values)


def named_variable(path: Path, variable: xr.Variable) -> xr.Variable:
    """The same lazy variable; errors on reading it name the path of its array."""
    data = indexing.LazilyIndexedArray(_NamedArray(path, variable))
    return xr.Variable(variable.dims, data, variable.attrs, variable.encoding)
