# The public names and their modules: read by type checkers, and by __init__.py, which imports on first use.
from wavefield.execution.workflow import Workflow
from wavefield.pipeline.catalog import run_catalog
from wavefield.pipeline.checking import check
from wavefield.pipeline.lazy import reconstruct
from wavefield.pipeline.opened_run import Run, open_run
from wavefield.pipeline.running import run
from wavefield.store.cube import open_cube
from wavefield.store.export import export
from wavefield.store.ledger import Status, status

__all__ = [
    "Run",
    "Status",
    "Workflow",
    "check",
    "export",
    "open_cube",
    "open_run",
    "reconstruct",
    "run",
    "run_catalog",
    "status",
]
