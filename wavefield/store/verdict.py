"""The verdict on a measurement: its remarks, and one line that sums them up.

A remark is one finding with its meaning and a remedy. Its weight is *note* (for information), *remark* (to be
considered) or *grave* (results are not usable).
"""

import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from wavefield.atomic_write import check_replaceable, write_text
from wavefield.errors import StoreError
from wavefield.file_access import refuse_pipe
from wavefield.store import beside
from wavefield.text import full_stop, one_line

Weight = Literal["note", "remark", "grave"]
Numbers = Mapping[str, Mapping[str, list[float]]]
WORDS = {"note": "sound", "remark": "sound with remarks", "grave": "not to be trusted"}


@dataclass(frozen=True)
class Remark:
    """One finding about a measurement, what it means for the results, and what to do."""

    subject: str  # What the remark is about: the name of a camera, "probes", "record", ...
    kind: str  # One word for scripts, such as "mirrored"
    weight: Weight  # note: for information; remark: to be considered; grave: results are not usable
    found: str  # What was found, with the number
    means: str = ""  # What it means for the result
    remedy: str = ""  # What to do
    values: Mapping[str, float | list[int]] = field(default_factory=dict)  # Numbers in `found`, for scripts

    @property
    def code(self) -> str:
        """The word by which `wavefield explain` finds this kind of remark: `kind` with "-" for spaces."""
        return re.sub(r"[^a-z0-9]+", "-", self.kind.lower()).strip("-")

    def __str__(self) -> str:
        parts = [part for part in (self.found, self.means, self.remedy) if part]
        text = " ".join(full_stop(part) for part in parts)
        return f"{self.subject}: {text} [{self.code}]"


@dataclass(frozen=True)
class Verdict:
    """All remarks on a measurement, and how well the cameras agreed at some frames."""

    remarks: Sequence[Remark] = ()  # The gravest first
    # By pair, such as "cam1-cam2": ``agreement`` (fraction of matched patches) and ``eps_y`` (epipolar error,
    # px), both lists with one number for each of `frames`
    pairs: Numbers = field(default_factory=dict)
    frames: Sequence[int] = ()  # Indices of the frames that were compared, from 0

    def __post_init__(self) -> None:
        gravest_first = sorted(self.remarks, key=lambda remark: -list(WORDS).index(remark.weight))
        object.__setattr__(self, "remarks", tuple(gravest_first))
        object.__setattr__(self, "frames", tuple(int(index) for index in self.frames))

    @property
    def weight(self) -> Weight:
        """Weight of the gravest remark; "note" without remarks."""
        return self.remarks[0].weight if self.remarks else "note"

    @property
    def line(self) -> str:
        """The verdict in one line, such as "sound" or "sound with remarks: cam1 focus"."""
        if self.weight == "note":
            return WORDS["note"]
        about = [f"{r.subject} {r.kind}" for r in self.remarks if r.weight != "note"]
        return f"{WORDS[self.weight]}: {', '.join(about)}"

    @property
    def exit_status(self) -> int:
        """Exit status of a command: 3 if a remark is more than a note, else 0."""
        return 0 if self.weight == "note" else 3

    def __str__(self) -> str:
        return "\n".join([f"verdict: {self.line}", *(f"  {remark}" for remark in self.remarks)])

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict and all remarks as plain data, as the option ``--json`` prints them."""
        return {
            "verdict": WORDS[self.weight],
            "line": self.line,
            "remarks": [asdict(remark) for remark in self.remarks],
            "pairs": self.pairs,
            "frames": list(self.frames),
        }

    def save(self, store: Path) -> None:
        """Write the verdict next to the cube `store`, as ``verdict.json`` for ``cube.zarr``.
        An earlier verdict is replaced. StoreError if a file of this name is not a verdict."""
        path = beside(store, "verdict", ".json")
        check_verdict(store)
        data = self.to_dict()
        text = json.dumps(data | {"checksum": _checksum(data)}, indent=1) + "\n"
        write_text(path, text, replace=True)


def read_verdict(store: str | Path) -> Verdict | None:
    """Return the verdict that a run wrote next to the cube `store`; None if there is no such file.
    StoreError if the file was changed or is damaged."""
    path = beside(Path(store), "verdict", ".json")
    try:
        refuse_pipe(path, StoreError)
        data = json.loads(path.read_text(encoding="utf-8"))
        if data.pop("checksum") != _checksum(data):
            raise ValueError("its checksum does not match")
        remarks = [Remark(**remark) for remark in data["remarks"]]
        return Verdict(remarks, data["pairs"], data.get("frames", ()))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except StoreError:
        raise
    except Exception as error:  # damaged bytes raise errors of many kinds
        raise StoreError(
            f"{path} is not a verdict written by wavefield, or is damaged ({one_line(error)[:200]}); move "
            "it, and `wavefield run EXPERIMENT` writes it again"
        ) from None


def check_verdict(store: Path) -> None:
    """Raise StoreError if the file name of the cube's verdict is taken by a file that is not a verdict."""
    path = beside(store, "verdict", ".json")
    try:
        known = read_verdict(store) is not None
    except StoreError:
        known = False
    check_replaceable(path, None, replace=known)


def _checksum(data: Mapping[str, object]) -> int:
    """Return the CRC-32 of a verdict given as plain data."""
    return zlib.crc32(json.dumps(data, sort_keys=True).encode())
