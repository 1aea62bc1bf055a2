"""Read the progress of a run from its cube: steps done and failed, and frames with faults."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wavefield.store import beside
from wavefield.store.layout import FINISHED
from wavefield.store.read import find_store, open_group, read_array, read_layout
from wavefield.store.verdict import Verdict, read_verdict
from wavefield.text import short_path, spell_ranges
from wavefield.variables import FrameFault, FrameStatus

_WORDS = {
    FrameFault.MISSING: "missing",
    FrameFault.UNREADABLE: "corrupt or truncated",
    FrameFault.WRONG_SIZE: "of another size or type",
    FrameFault.BLANK: "blank",
    FrameFault.REPEATED: "the same image as the frame before",
    FrameFault.RANGE: "the water moved beyond the search range",
}


@dataclass(frozen=True)
class BadFrames:
    """Frames of one camera that have the same fault."""

    camera: str  # Name of the camera
    fault: FrameFault  # Kind of fault
    numbers: tuple[int, ...]  # Frame numbers

    def __str__(self) -> str:
        return f"{self.camera}: {_WORDS[self.fault]}: frame {spell_ranges(self.numbers)}"


@dataclass(frozen=True)
class Status:
    """Progress of a run, as its cube records it in `frame_status` and `frame_fault`.

    Parameters
    ----------
    store : path
        The cube.
    experiment : str
        Name of the experiment.
    recipe_hash : str
        Hash of the cube's recipe, the record of all inputs (settings, rig, grid, names of images, ...).
    steps : int
        Number of steps of the whole run.
    done, faulty, failed : int
        Numbers of steps that were measured from good frames (`done`), were measured although a frame was bad,
        and could not be measured. `done` includes steps without values next to lost or late frames.
    failed_steps : tuple of int
        Number of the first frame of each failed step.
    bad_frames : tuple of BadFrames
        Frames that were bad.
    verdict : Verdict or None
        Remarks on the cube, which a run writes to a file at its end; None if there is no such file.
    lacks_verdict : bool
        Whether this file is missing although the run has ended.
    """

    store: Path
    experiment: str
    recipe_hash: str
    steps: int
    done: int
    faulty: int
    failed: int
    failed_steps: tuple[int, ...]
    bad_frames: tuple[BadFrames, ...]
    verdict: Verdict | None = None
    lacks_verdict: bool = False

    @property
    def exit_status(self) -> int:
        """Exit status of a command: 1 if all steps failed, else 3 or 0.
        It is 3 if a remark is more than a note, or if the run ended without a file of the verdict."""
        if self.failed and self.failed == self.steps:
            return 1
        return self.verdict.exit_status if self.verdict else 3 if self.lacks_verdict else 0

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, `complete` and `left` as plain data; ``wavefield status --json`` prints them."""
        out = asdict(self) | {"store": str(self.store), "complete": self.complete, "left": self.left}
        out["bad_frames"] = [
            {"camera": b.camera, "fault": b.fault.name.lower(), "numbers": list(b.numbers)}
            for b in self.bad_frames
        ]
        return out | {"verdict": self.verdict.to_dict() if self.verdict else None}

    @property
    def complete(self) -> bool:
        """Whether every step was tried, failed ones included."""
        return self.left == 0

    @property
    def left(self) -> int:
        """Number of steps that were not tried yet."""
        return self.steps - self.done - self.faulty - self.failed

    def __str__(self) -> str:
        tried = self.steps - self.left
        lines = [f"verdict: {self.verdict.line}"] if self.verdict and self.complete else []
        if self.lacks_verdict:
            file = beside(self.store, "verdict", ".json")
            lines.append(f"verdict: none, {file} is missing: copy it as well, or run the same command again")
        lines += [
            f"{short_path(self.store)}: {self.experiment}, recipe {self.recipe_hash}",
            f"  {tried} of {self.steps} steps ({100 * tried // self.steps} %)"
            + ("" if self.complete else "; run the same command again to go on"),
        ]
        if self.faulty:
            lines.append(f"  {self.faulty} steps measured although some of their frames are bad")
        if self.failed:
            lines.append(f"  {self.failed} steps failed, from frame {spell_ranges(self.failed_steps)}")
        lines += [f"  {bad}" for bad in self.bad_frames]
        if any(bad.fault is FrameFault.RANGE for bad in self.bad_frames):
            lines.append(
                "  give wider search ranges (settings: piv.search_x and search_y in px, z_range in m) and "
                "run into another cube"
            )
        if any(bad.fault is not FrameFault.RANGE for bad in self.bad_frames):
            lines.append("  copy bad frames again and run the same command: their steps are measured again")
        if self.verdict and self.complete:
            lines += [f"  {remark}" for remark in self.verdict.remarks]
        return "\n".join(lines)


def status(store: str | Path) -> Status:
    """Return the progress of a run: steps done and failed, bad frames, and the verdict.

    Parameters
    ----------
    store : path
        Cube written by `run`, finished or not, or a folder that holds one.

    Returns
    -------
    Status
        Numbers of steps, the bad frames, and the verdict (remarks on the cube).

    Raises
    ------
    StoreError
        If the store does not exist or is not a cube.

    Examples
    --------
    >>> import wavefield as wf
    >>> found = wf.status("cube.zarr")
    >>> found.steps, found.done, found.left, found.complete
    (10, 10, 0, True)
    """
    path = find_store(store)
    group = open_group(path)
    layout = read_layout(group)
    ledger, faults = (read_array(group, path, name) for name in ("frame_status", "frame_fault"))
    bad = []
    for camera, codes in zip(layout.cameras, faults):
        for code in np.unique(codes[codes > 0]):
            numbers = layout.first_frame + np.flatnonzero(codes == code)
            bad.append(BadFrames(camera, FrameFault(int(code)), tuple(numbers.tolist())))
    ended = bool(group.attrs.get(FINISHED))  # read before the verdict, which a run writes first
    verdict = read_verdict(path)
    failed = np.flatnonzero(ledger == FrameStatus.FAILED)
    return Status(
        store=path,
        experiment=str(group.attrs["experiment"]),
        recipe_hash=str(group.attrs["recipe_hash"]),
        steps=layout.steps,
        done=int(np.isin(ledger, (FrameStatus.DONE, FrameStatus.DISCONTINUOUS)).sum()),
        faulty=int(np.count_nonzero(ledger == FrameStatus.DONE_WITH_FAULTS)),
        failed=failed.size,
        failed_steps=tuple((layout.first_frame + failed).tolist()),
        bad_frames=tuple(bad),
        verdict=verdict,
        lacks_verdict=verdict is None and ended,
    )


def unfinished_note(store: str | Path) -> str:
    """Return a warning, as text, if steps of a cube are not yet measured or have failed; else ""."""
    found = status(store)
    if found.complete and not found.failed:
        return ""
    parts = [f"{found.left} are not measured yet"] if found.left else []
    parts += [f"{found.failed} could not be measured"] if found.failed else []
    remedy = "; finish it with `wavefield run`" if found.left else ""
    return f"of the {found.steps} steps of {found.store}, {' and '.join(parts)}: they are missing{remedy}"
