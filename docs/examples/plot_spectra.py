"""
Spectra and the dispersion relation
===================================

Results of ``wavefield analyze``. This record lasts two seconds; a good one contains a hundred peak periods.
"""

import xarray as xr

from wavefield import figures

waves = xr.open_datatree("wavefield-demo/waves.zarr", engine="zarr", consolidated=False)
spectra, dispersion = waves["spectra"].to_dataset(), waves["dispersion"].to_dataset()
figures.komega_map(spectra, dispersion)

# %%
# Spectrum over the wave vector; the circle is the dispersion relation.
figures.wavevector_map(spectra, dispersion)

# %%
figures.wavenumber_spectra(spectra)

# %%
# The elevation spectrum from each method.
figures.elevation_spectra(spectra)
