"""Faults of cameras and records: delays, motion, blur, inconsistent cameras, missing or uneven frames."""
