"""A small cube with the schema of the real one, from an exact linear sea."""

import pytest
import xarray as xr
from cube_cases import linear_sea


@pytest.fixture(scope="session")
def cube() -> xr.Dataset:
    return linear_sea()
