"""What all pages of one server share: the cube, its preview in memory, and what belongs to it."""

import threading
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from wavefield.explorer.cube_record import CubeRecord
from wavefield.store.store_paths import beside
from wavefield.variables import CUBE_DIMS

if TYPE_CHECKING:
    from wavefield.pipeline import Run


class LookSession:
    """A cube that is shown, finished or not, also one of which a part is damaged or absent."""

    def __init__(self, path: str | Path, waves: str | Path | None = None) -> None:
        self.record = CubeRecord(path)
        usual = beside(self.record.path, "waves", ".zarr")
        self.waves_path = Path(waves) if waves is not None else usual

    @cached_property
    def run(self) -> "Run":
        """Rig, experiment, images, waves and probes of the cube; slow to import, so after the first map."""
        import xarray as xr

        from wavefield.pipeline import Run

        attrs = dict(self.record.group.attrs)
        axes = xr.Dataset(coords={name: getattr(self.record, name) for name in CUBE_DIMS}, attrs=attrs)
        return Run(axes, self.record.path, self.waves_path)

    def reopen(self) -> None:
        """Forget what belongs to the cube, to read it again when it is next used: it has changed."""
        self.run = replace(self.run)

    def load(self) -> threading.Thread:
        """Read the preview in the background."""
        thread = threading.Thread(target=self.record.preview.load, daemon=True, name="preview")
        thread.start()
        return thread
