"""What all pages of one server share: the cube, its preview in memory, and what belongs to it."""

import threading
from dataclasses import dataclass, replace
from pathlib import Path

import xarray as xr

from wavefield.explorer.cube_record import CubeRecord
from wavefield.pipeline import Run
from wavefield.store.store_paths import beside
from wavefield.variables import CUBE_DIMS


@dataclass
class LookSession:
    """A cube that is shown, finished or not."""

    record: CubeRecord
    run: Run  # its rig, experiment, images, waves and probes

    @classmethod
    def open(cls, path: str | Path, waves: str | Path | None = None) -> "LookSession":
        """Open a cube, also one of which a part is damaged or absent: the pages show the others."""
        record = CubeRecord(path)
        attrs = dict(record.group.attrs)
        axes = xr.Dataset(coords={name: getattr(record, name) for name in CUBE_DIMS}, attrs=attrs)
        waves_path = Path(waves) if waves is not None else beside(record.path, "waves", ".zarr")
        return cls(record, Run(axes, record.path, waves_path))

    def reopen(self) -> None:
        """Forget what belongs to the cube, to read it again when it is next used: it has changed."""
        self.run = replace(self.run)

    def load(self) -> threading.Thread:
        """Read the preview in the background."""
        thread = threading.Thread(target=self.record.preview.load, daemon=True, name="preview")
        thread.start()
        return thread
