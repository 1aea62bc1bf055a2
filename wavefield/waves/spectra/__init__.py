"""Spectra and cross spectra of fields over (time, y, x)."""
