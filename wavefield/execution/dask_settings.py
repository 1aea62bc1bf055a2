"""Dask's configuration for a run, and TLS for what it opens to the network."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import dask

from wavefield.errors import ExperimentError
from wavefield.execution.cluster_settings import ClusterSettings

# Blocks are independent and a worker may die for reasons of its own, so be patient with both. Tasks take
# minutes, so check them less often than every few ms: for two workers that takes 15 % of a core.
_DASK: dict[str, Any] = {
    "array": {"query-planning": False},
    "distributed": {
        "scheduler": {
            "allowed-failures": 10,
            "worker-ttl": "300s",
            "active-memory-manager": {"start": False},
        },
        "worker": {
            "memory": {
                "target": False,
                "spill": False,
                "pause": 0.9,
                "terminate": 0.95,
                "monitor-interval": "500ms",
            },
            "profile": {"enabled": False},
        },
        "comm": {"timeouts": {"connect": "60s", "tcp": "60s"}},
        "admin": {
            "tick": {"interval": "1s", "cycle": "5s", "limit": "60s"},
            "system-monitor": {"interval": "2s", "disk": False, "gil": {"enabled": False}},
        },
    },
}
_PROFILE = {"distributed": {"worker": {"profile": {"enabled": True}}}}  # a report is made from it


def dask_settings(workflow: ClusterSettings) -> dict[str, Any]:
    """Dask's configuration for a run."""
    profile = _PROFILE if workflow.performance_report else {}
    merged: dict[str, Any] = dask.config.merge(_DASK, profile, workflow.dask)
    return merged


def dashboard_address(workflow: ClusterSettings) -> str:
    """Where the scheduler answers browsers: on the loopback, unless the workflow names another host."""
    host, _, port = (workflow.dashboard or ":0").rpartition(":")
    return f"{host or '127.0.0.1'}:{port}"


def of_jobqueue(workflow: ClusterSettings) -> bool:
    """Whether a class of dask-jobqueue deploys the cluster: PBSCluster, LSFCluster and others."""
    return (workflow.deploy or "").startswith("dask_jobqueue.")


def needs_tls(workflow: ClusterSettings) -> bool:
    """Whether client, scheduler and workers communicate through TLS, with credentials made for this run."""
    if workflow.security == "auto":
        open_ports = workflow.deploy == "distributed.SSHCluster" or of_jobqueue(workflow)
        return workflow.cluster == "slurm" or open_ports
    return workflow.security == "tls"


@contextmanager
def temporary_credentials(folder: Path) -> Iterator[dict[str, Any]]:
    """Make credentials for one run, which nobody but their owner can read."""
    from distributed import Security

    try:
        security = Security.temporary()
    except ImportError:
        raise ExperimentError(
            "security: tls needs cryptography: `pip install cryptography`, or state `security: none` in the "
            "workflow where nobody else is on the network"
        ) from None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        place = tempfile.TemporaryDirectory(prefix=".tls-", dir=folder)
    except OSError as error:
        raise ExperimentError(
            f"{folder}: the credentials of the run cannot be written there ({error.strerror}); make room or "
            "name another store with -o"
        ) from None
    with place as name:
        tls: dict[str, Any] = {}
        for role in ("scheduler", "worker", "client"):
            texts = security.get_tls_config_for_role(role)
            ca, cert, key = (
                _write_secret(Path(name) / f"{role}.{part}.pem", texts[part])
                for part in ("ca_file", "cert", "key")
            )
            tls |= {"ca-file": ca, role: {"cert": cert, "key": key}}
        comm = {"default-scheme": "tls", "require-encryption": True, "tls": tls}
        yield {"distributed": {"comm": comm}}


def _write_secret(path: Path, text: str) -> str:
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
        stream.write(text)
    return str(path)


@contextmanager
def configured(configuration: dict[str, object]) -> Iterator[None]:
    """Use a configuration of Dask for a while; the environment, which its nannies change, is restored."""
    import distributed  # noqa: F401  its defaults join the configuration on import: before that is put aside

    before, environment = dask.config.config.copy(), dict(os.environ)
    merged = dask.config.merge(dask.config.config, configuration)
    _replace(merged)
    try:
        yield
    finally:
        _replace(before)
        for name in os.environ.keys() - environment.keys():
            del os.environ[name]
        os.environ.update(environment)


def _replace(configuration: dict[str, object]) -> None:
    with dask.config.config_lock:
        dask.config.config.clear()
        dask.config.config.update(configuration)
