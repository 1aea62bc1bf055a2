"""What Dask's workers that we start load before anything else: what they need, and their settings."""

import signal

from distributed import Worker

from wavefield.execution.worker_settings import settle_worker


def dask_setup(worker: Worker) -> None:
    """Set the process of a worker; Dask calls it in its main thread."""
    settle_worker()
    if worker.nanny is None:  # Dask would write the chunk after the end of the run was reported
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
