"""Faults of cameras and records: delay, motion, blur, outlier cameras, inconsistent pairs."""
