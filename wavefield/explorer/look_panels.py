"""The panels of `wavefield look` in two groups of tabs: views of a step, and what is picked on them."""

from collections.abc import Callable

from bokeh.models import Select

from wavefield.errors import WavefieldError
from wavefield.explorer.area_panel import AreaPanel
from wavefield.explorer.camera_panel import CameraPanel
from wavefield.explorer.line_panel import LinePanel
from wavefield.explorer.map_panel import MapPanel
from wavefield.explorer.mask_panel import MaskPanel
from wavefield.explorer.node_panel import NodePanel
from wavefield.explorer.place import TABS, Place
from wavefield.explorer.plot_parts import LazyPanel, chosen, make_tabs
from wavefield.explorer.save_panel import SavePanel
from wavefield.explorer.session import LookSession
from wavefield.explorer.surface_panel import SurfacePanel
from wavefield.explorer.wave_panel import WavePanel
from wavefield.series.masks import WATER, footprints

PICKED = ("node", "line", "area", "save", "mask")  # tabs of what is picked


class LookPanels:
    """All panels of one page."""

    def __init__(
        self,
        session: LookSession,
        place: Place,
        drag: Select,
        picked: Callable[[str, tuple[float, ...]], None],
        took_corner: Callable[[str, tuple[float, float]], bool],
        masks_changed: Callable[[], None],
    ) -> None:
        self._session = session
        record, probes, run = session.record, None, session.run
        self.trouble = ""  # why the probes of the experiment are not shown
        try:
            probes = run.probes
            if probes is None and run.experiment is not None and run.experiment.probes is not None:
                self.trouble = run.reason("probes")
        except WavefieldError as error:
            self.trouble = f"no probes: {error}"
        self.map = MapPanel(record, drag, picked)
        if probes is not None:
            names = [str(name) for name in probes.probe.values]
            self.map.mark_probes(names, probes.probe_x.values, probes.probe_y.values)
        self.surface = LazyPanel(lambda: SurfacePanel(record))
        self.cameras = CameraPanel(session, picked, took_corner)
        self.waves = LazyPanel(lambda: WavePanel(session))
        self.node = NodePanel(record, probes)
        self.line = LazyPanel(lambda: LinePanel(record))
        self.area = LazyPanel(lambda: AreaPanel(record))
        self.save = SavePanel()
        self.masks = MaskPanel(session, masks_changed)
        bodies = self.map.figure, self.surface.body, self.cameras.layout, self.waves.body
        titles = [tab.capitalize() for tab in TABS]
        self.views = make_tabs("views", TABS.index(place.tab), list(zip(titles, bodies)))
        picked_bodies = (
            self.node.layout, self.line.body, self.area.body, self.save.layout, self.masks.layout,
        )  # fmt: skip
        first = "line" if place.line else "area" if place.area else "node"
        titles = ["Node", "Line", "Rectangle", "Save", "Mask"]
        self.picked = make_tabs("picked", PICKED.index(first), list(zip(titles, picked_bodies)))

    def open_picked(self, kind: str) -> None:
        """Open the tab of one of `PICKED`."""
        self.picked.active = PICKED.index(kind)

    def limits(self, place: Place) -> tuple[float, float]:
        """Limits of the colour scale, in the displayed unit."""
        return place.limits or self.map.fitted(place.coloured)

    def show_view(self, place: Place) -> None:
        """Show a place in the open view; the map is always drawn."""
        if place.tab == "surface":
            self.surface().show(place, self.limits(place))
        elif place.tab == "cameras":
            self.cameras.show(place)
            self._show_corners()
        elif place.tab == "waves":
            self.waves().show()

    def show_picked(self, place: Place) -> None:
        """Show what is picked, in the open tab."""
        kind = PICKED[int(self.picked.active)]
        if kind == "node":
            self.node.show(place)
        elif kind == "line":
            self.line().show(place, self.limits(place))
        elif kind == "area":
            self.area().show(place)
        elif kind == "save":
            self.save.show(place)

    def show_step(self, place: Place) -> None:
        """Show another step of what is picked: the series at the node stay."""
        if PICKED[int(self.picked.active)] == "node":
            self.node.show_step(place)
        else:
            self.show_picked(place)

    def show_masks(self) -> None:
        """Draw the corners that are clicked, and the masks of the experiment file."""
        self.map.sources["mask"].data = self.masks.closed_line(WATER)
        self._show_corners()
        experiment = self._session.run.experiment
        lines = footprints(experiment.mask) if experiment is not None else ()
        xs, ys = ([[corner[k] for corner in line] for line in lines] for k in (0, 1))
        self.map.sources["masks"].data = {"xs": xs, "ys": ys}

    def _show_corners(self) -> None:
        self.cameras.sources["mask"].data = self.masks.closed_line(chosen(self.cameras.camera))
