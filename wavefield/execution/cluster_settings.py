"""Where work runs: the part of a workflow file that does not concern the measurement."""

import re
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from wavefield.config_files import ConfigSection

# the only ones that `deploy` imports from: a workflow file names no other code
CLUSTER_PACKAGES = (
    "distributed", "dask_jobqueue", "dask_kubernetes", "dask_gateway", "dask_cloudprovider", "dask_yarn",
    "coiled",
)  # fmt: skip


class Between(ConfigSection):
    """From how many to how many workers: more are asked for while chunks wait, and given back at the end."""

    minimum: int = Field(ge=1, examples=["2"], description="workers to ask for at once")
    maximum: int = Field(ge=1, examples=["40"], description="most workers")

    @model_validator(mode="after")
    def _ordered(self) -> "Between":
        if self.maximum < self.minimum:
            raise ValueError("the maximum of workers is below their minimum")
        return self


class ClusterSettings(ConfigSection):
    """Kind of cluster, its resources, and how it is reached.

    Examples
    --------
    >>> ClusterSettings(cluster="local", workers=2, memory="2 GB").memory_bytes
    2000000000
    """

    cluster: Literal["none", "local", "slurm", "address", "dask"] = Field(
        default="local",
        examples=["local"],
        description="none: this process; local: processes of this machine; slurm: jobs; address: a "
        "scheduler; dask: any class that deploys Dask",
    )
    workers: int | Literal["auto"] | Between = Field(
        default="auto",
        examples=["4", "{minimum: 2, maximum: 40}"],
        description="worker processes; auto: one per core",
    )
    memory: str | None = Field(default=None, examples=["2 GB"], description="limit per worker")
    address: str | None = Field(
        default=None, examples=["tcp://host:8786"], description="of a running scheduler"
    )
    slurm: dict[str, Any] = Field(
        default_factory=dict,
        examples=["{queue: cpu, walltime: '04:00:00'}"],
        description="keywords of SLURMCluster",
    )
    deploy: str | None = Field(
        default=None, examples=["distributed.SSHCluster"], description="the class for cluster: dask"
    )
    options: dict[str, Any] = Field(
        default_factory=dict, examples=["{hosts: [node1, node1, node2]}"], description="its keywords"
    )
    security: Literal["auto", "tls", "none"] = Field(
        default="auto",
        examples=["tls"],
        description="tls: encrypted, with credentials made for each run; auto: where ports are open beyond "
        "this machine",
    )
    dask: dict[str, Any] = Field(default_factory=dict, description="Dask configuration that differs")
    dashboard: str | None = Field(
        default=None,
        examples=['":8787"'],
        description="port of Dask's dashboard, seen from this machine only, unless a host is named before it",
    )
    performance_report: str | None = Field(
        default=None, examples=["report.html"], description="write Dask's report"
    )

    @field_validator("workers")
    @classmethod
    def _some(cls, value: object) -> Any:
        if isinstance(value, int) and value < 1:
            raise ValueError("workers must be 1 or more, or auto")
        return value

    @field_validator("memory")
    @classmethod
    def _size(cls, value: str | None) -> str | None:
        if value is None:
            return value
        from dask.utils import format_bytes, parse_bytes

        if parse_bytes(value) < 100_000_000:
            raise ValueError(
                f"memory of {format_bytes(parse_bytes(value))} per worker is too little; give 1 GB or more"
            )
        return value

    @field_validator("dashboard")
    @classmethod
    def _port(cls, value: str | None) -> str | None:
        if value is not None and not re.fullmatch(r".*:\d+", value):
            raise ValueError(f"{value!r} is not an address of a dashboard; write it as ':8787'")
        return value

    @field_validator("deploy")
    @classmethod
    def _class_of_clusters(cls, value: str | None) -> str | None:
        if value is not None:
            package, name = value.partition(".")[0], value.rpartition(".")[2]
            if package not in CLUSTER_PACKAGES or not re.fullmatch(r"[A-Za-z]\w*Cluster", name):
                raise ValueError(
                    f"{value!r} is no class of clusters; give one of {', '.join(CLUSTER_PACKAGES)}, such as "
                    "distributed.SSHCluster"
                )
        return value

    @model_validator(mode="after")
    def _address_given(self) -> "ClusterSettings":
        if self.cluster == "dask" and not self.deploy:
            raise ValueError(
                "cluster: dask needs the class that deploys it, for example deploy: distributed.SSHCluster"
            )
        if self.cluster == "address" and not self.address:
            raise ValueError(
                "cluster: address needs the scheduler's address, for example address: tcp://host:8786"
            )
        return self

    @property
    def memory_bytes(self) -> int | None:
        """Memory limit per worker, bytes."""
        if not self.memory:
            return None
        from dask.utils import parse_bytes

        return int(parse_bytes(self.memory))
