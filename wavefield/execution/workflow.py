"""The workflow file: cluster, workers, memory, and settings that replace those of the experiment."""

import re
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr, field_validator, model_validator

from wavefield.config_files import ConfigSection, load

_LEAST_MEMORY = 500_000_000  # bytes per worker; its libraries alone take a third of this


class Between(ConfigSection):
    """Range of the number of workers: the minimum is requested at once, more while chunks wait."""

    minimum: int = Field(ge=1, examples=["2"], description="workers requested at once")
    maximum: int = Field(ge=1, examples=["40"], description="upper limit, requested while work is waiting")

    @model_validator(mode="after")
    def _ordered(self) -> "Between":
        if self.maximum < self.minimum:
            raise ValueError("the maximum of workers is below their minimum")
        return self


class Workflow(ConfigSection):
    """A workflow file: where and with which resources to run, and settings that replace the experiment's.

    Examples
    --------
    >>> workflow = Workflow(cluster="local", workers=2, memory="2 GB", time_limit="1h 30m")
    >>> workflow.memory_bytes, workflow.time_limit_seconds
    (2000000000, 5400.0)
    """

    cluster: Literal["none", "local", "slurm", "address"] = Field(
        default="local",
        examples=["local"],
        description="none: this process; local: processes of this machine; slurm: jobs; address: a running "
        "Dask scheduler",
    )
    workers: int | Literal["auto"] | Between = Field(
        default="auto",
        examples=["4", "{minimum: 2, maximum: 40}"],
        description="worker processes; auto: one per core",
    )
    memory: str | None = Field(
        default=None, examples=["2 GB"], description="limit of a worker; above it, the worker is replaced"
    )
    address: str | None = Field(
        default=None, examples=["tcp://host:8786"], description="address of a running scheduler"
    )
    slurm: dict[str, Any] = Field(
        default_factory=dict,
        examples=["{queue: cpu, walltime: '04:00:00'}"],
        description="keywords of dask_jobqueue.SLURMCluster",
    )
    time_limit: str | None = Field(
        default=None, examples=["11h 50m"], description="stop cleanly after this time"
    )
    steps_per_block: int | None = Field(
        default=None, ge=1, examples=["64"], description="steps that a worker measures and stores together"
    )
    packing: Literal["float32", "int16"] = Field(default="float32", description="type of stored values")
    settings: dict[str, Any] = Field(
        default_factory=dict, description="measurement settings that differ from the experiment's"
    )
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
        if value is not None:
            from dask.utils import format_bytes, parse_bytes

            if parse_bytes(value) < _LEAST_MEMORY:
                raise ValueError(
                    f"memory of {format_bytes(parse_bytes(value))} per worker is too little; "
                    "give 1 GB or more"
                )
        return value

    @field_validator("time_limit", mode="before")
    @classmethod
    def _duration(cls, value: object) -> Any:
        if value is not None:
            parse_duration(str(value))
        return None if value is None else str(value)

    @model_validator(mode="after")
    def _address_given(self) -> "Workflow":
        if self.cluster == "address" and not self.address:
            raise ValueError(
                "cluster: address needs the scheduler's address, for example address: tcp://host:8786"
            )
        return self

    @classmethod
    def load(cls, path: str | Path) -> "Workflow":
        """Read a workflow file; ExperimentError, with the line and the remedy, if it is missing or wrong."""
        out = load(cls, Path(path))
        out._path = Path(path)
        return out

    @property
    def path(self) -> Path | None:
        """The file that this workflow was read from; None if it was not read from a file."""
        return self._path

    @property
    def memory_bytes(self) -> int | None:
        """Memory limit per worker, bytes; None without a limit."""
        if not self.memory:
            return None
        from dask.utils import parse_bytes

        return int(parse_bytes(self.memory))

    @property
    def time_limit_seconds(self) -> float | None:
        """Time after which the run stops itself, s; None without a limit."""
        return parse_duration(self.time_limit) if self.time_limit else None


def parse_duration(text: str) -> float:
    """Return a duration, s, from text: "3h 50m", "03:50:00" or a number of seconds; else ValueError."""
    import pandas as pd  # takes half a second to import

    try:
        seconds = float(text)
    except ValueError:
        try:
            seconds = pd.Timedelta(re.sub(r"d\b", "D", text)).total_seconds()  # pandas deprecates d
        except ValueError:
            seconds = 0.0
    if not 0.0 < seconds < float("inf"):
        raise ValueError(f"{text!r} is not a duration; write it as 3h 50m or 03:50:00")
    return seconds
