"""How to process: where the work is done, and what differs from the experiment's own settings."""

import re
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr, field_validator, model_validator

from wavefield.config_files import ConfigSection, load

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


class Workflow(ConfigSection):
    """A workflow file: cluster, resources, recipe.

    Examples
    --------
    >>> Workflow(cluster="local", workers=2, memory="2 GB").memory_bytes
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
    time_limit: str | None = Field(
        default=None, examples=["11h 50m"], description="stop cleanly after this time"
    )
    steps_per_block: int | None = Field(
        default=None, ge=1, examples=["64"], description="steps per task and shard"
    )
    packing: Literal["float32", "int16"] = Field(default="float32", description="how values are stored")
    settings: dict[str, Any] = Field(default_factory=dict, description="measurement settings that differ")
    _path: Path | None = PrivateAttr(default=None)

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

    @field_validator("time_limit", mode="before")
    @classmethod
    def _duration(cls, value: object) -> Any:
        if value is not None:
            parse_duration(str(value))
            return str(value)
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
    def _address_given(self) -> "Workflow":
        if self.cluster == "dask" and not self.deploy:
            raise ValueError(
                "cluster: dask needs the class that deploys it, for example deploy: distributed.SSHCluster"
            )
        if self.cluster == "address" and not self.address:
            raise ValueError(
                "cluster: address needs the scheduler's address, for example address: tcp://host:8786"
            )
        return self

    @classmethod
    def load(cls, path: str | Path) -> "Workflow":
        """Read a workflow file.

        Parameters
        ----------
        path : path
            YAML.

        Returns
        -------
        Workflow

        Raises
        ------
        ExperimentError
            If it is missing or wrong; the message names the line and the remedy.
        """
        out = load(cls, Path(path))
        out._path = Path(path)
        return out

    @property
    def path(self) -> Path | None:
        """The file this workflow was read from, if it was."""
        return self._path

    @property
    def memory_bytes(self) -> int | None:
        """Memory limit per worker, bytes."""
        if not self.memory:
            return None
        from dask.utils import parse_bytes

        return int(parse_bytes(self.memory))

    @property
    def time_limit_seconds(self) -> float | None:
        """Time after which the run stops itself, s."""
        return parse_duration(self.time_limit) if self.time_limit else None


_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


def parse_duration(text: str) -> float:
    """Seconds of a duration as people and Slurm write it.

    Examples
    --------
    >>> parse_duration("3h 50m"), parse_duration("04:00:00"), parse_duration("600")
    (13800.0, 14400.0, 600.0)
    """
    text = text.strip().lower()
    if re.fullmatch(r"\d+(:\d\d){1,2}", text):
        parts = [float(part) for part in text.split(":")]
        return sum(part * unit for part, unit in zip(reversed(parts), (1.0, 60.0, 3600.0)))
    if re.fullmatch(r"\d+(\.\d+)?", text):
        return float(text)
    found = re.findall(r"(\d+(?:\.\d+)?)\s*([smhd])[a-z]*", text)
    if not found or re.sub(r"\d+(\.\d+)?\s*[smhd][a-z]*\s*", "", text):
        raise ValueError(f"{text!r} is not a duration; write it as 3h 50m or 03:50:00")
    return sum(float(number) * _UNITS[unit] for number, unit in found)
