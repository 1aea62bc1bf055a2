"""Accuracy and speed: what the README claims, measured."""

import os

# one thread each: CPU times are those of the work, and both cores stay free for whoever runs two of them
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
