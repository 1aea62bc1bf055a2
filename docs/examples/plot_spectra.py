"""
Spectra and the dispersion relation
===================================

What ``wavefield analyze`` writes, group by group. Two seconds of a record are little: a hundred peak periods
are a good record.
"""

import xarray as xr

from wavefield import figures

waves = xr.open_datatree("wavefield-demo/waves.zarr", engine="zarr", consolidated=False)
spectra, dispersion = waves["spectra"].to_dataset(), waves["dispersion"].to_dataset()
figures.komega_map(spectra, dispersion)

# %%
# Over the direction of travel; the circle is the dispersion relation.
figures.wavevector_map(spectra, dispersion)

# %%
figures.wavenumber_spectra(spectra)

# %%
# The elevation by each method.
figures.elevation_spectra(spectra)
