"""Find faults of cameras and of records: delayed, moved or blurred cameras, and missing or uneven frames."""
