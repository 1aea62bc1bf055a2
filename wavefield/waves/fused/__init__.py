"""The best elevation from stereo and from integrated velocity, as spectra and as a series."""
