"""Imported first, and only, by the process that workers are forked from: BLAS reads the environment once."""

import os

from wavefield.execution.worker_settings import THREAD_VARIABLES

os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
