"""How to process: where the work is done, and what differs from the experiment's own settings."""

import re
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr, field_validator

from wavefield.config_files import load
from wavefield.execution.cluster_settings import ClusterSettings


class Workflow(ClusterSettings):
    """A workflow file: cluster, resources, recipe.

    Examples
    --------
    >>> Workflow(cluster="local", workers=2, time_limit="1h 30m").time_limit_seconds
    5400.0
    """

    time_limit: str | None = Field(
        default=None, examples=["11h 50m"], description="stop cleanly after this time"
    )
    steps_per_block: int | None = Field(
        default=None, ge=1, examples=["64"], description="steps per task and shard"
    )
    packing: Literal["float32", "int16"] = Field(default="float32", description="how values are stored")
    settings: dict[str, Any] = Field(default_factory=dict, description="measurement settings that differ")
    _path: Path | None = PrivateAttr(default=None)

    @field_validator("time_limit", mode="before")
    @classmethod
    def _duration(cls, value: object) -> Any:
        if value is not None:
            parse_duration(str(value))
            return str(value)
        return value

    @classmethod
    def load(cls, path: str | Path) -> "Workflow":
        """Read a workflow file.

        Parameters
        ----------
        path : path
            YAML.

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
