"""Imported once, by the process that workers are forked from: what all of them need.

It is never imported by the caller: it sets the environment before BLAS reads it.
"""

import os

from wavefield.execution.worker_settings import THREAD_VARIABLES

os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))

import wavefield.measurement.measure
import wavefield.pipeline.chunk_worker  # noqa: F401
