"""What Dask's workers that we start load before anything else: what they need, and their settings."""

import signal
from typing import Any

from wavefield.execution.worker_settings import settle_worker


def dask_setup(worker: Any) -> None:
    """Set the process of a worker; Dask calls it in its main thread."""
    settle_worker()
    if worker.nanny is None:  # Dask would write the chunk after the end of the run was reported
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
