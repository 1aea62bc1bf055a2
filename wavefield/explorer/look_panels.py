"""The panels of `wavefield look` in two groups of tabs: views of a step, and what is picked on them."""

from typing import TYPE_CHECKING, Any

from bokeh.models import Select

from wavefield.explorer.area_panel import AreaPanel
from wavefield.explorer.line_panel import LinePanel
from wavefield.explorer.map_panel import MapPanel
from wavefield.explorer.node_panel import NodePanel
from wavefield.explorer.place import TABS, Place
from wavefield.explorer.plot_parts import LazyPanel, PanelEvents, chosen, make_tabs
from wavefield.explorer.save_panel import SavePanel
from wavefield.explorer.session import LookSession
from wavefield.explorer.surface_panel import SurfacePanel

if TYPE_CHECKING:  # slow to import, with OpenCV and the experiment's files: when their tabs are opened
    import xarray as xr

    from wavefield.explorer.camera_panel import CameraPanel
    from wavefield.explorer.mask_panel import MaskPanel
    from wavefield.explorer.wave_panel import WavePanel

PICKED = ("node", "line", "area", "save", "mask")  # tabs of what is picked


class LookPanels:
    """All panels of one page."""

    def __init__(self, session: LookSession, place: Place, drag: Select, events: PanelEvents) -> None:
        self._session, self._events = session, events
        record = session.record
        self.map, self.node = MapPanel(record, drag, events.picked), NodePanel(record)
        self.cameras = LazyPanel(self._make_cameras)
        self.waves = LazyPanel(self._make_waves)
        self.masks = LazyPanel(self._make_masks)
        self._views: dict[str, LazyPanel[Any]] = {  # but for the map
            "surface": LazyPanel(lambda: SurfacePanel(record, self._step_limits)),
            "cameras": self.cameras,
            "waves": self.waves,
        }
        self._picked: dict[str, LazyPanel[Any]] = {  # but for the node
            "line": LazyPanel(lambda: LinePanel(record, self._step_limits)),
            "area": LazyPanel(lambda: AreaPanel(record)),
            "save": LazyPanel(SavePanel),
            "mask": self.masks,
        }
        bodies = self.map.figure, *(panel.body for panel in self._views.values())
        titles = [tab.capitalize() for tab in TABS]
        self.views = make_tabs("views", TABS.index(place.tab), titles, bodies)
        bodies = self.node.layout, *(panel.body for panel in self._picked.values())
        first = "line" if place.line else "area" if place.area else "node"
        titles = ["Node", "Line", "Rectangle", "Save", "Mask"]
        self.picked = make_tabs("picked", PICKED.index(first), titles, bodies)

    def _make_cameras(self) -> "CameraPanel":
        from wavefield.explorer.camera_panel import CameraPanel

        return CameraPanel(self._session, self._events)

    def _make_waves(self) -> "WavePanel":
        from wavefield.explorer.wave_panel import WavePanel

        return WavePanel(self._session)

    def _make_masks(self) -> "MaskPanel":
        from wavefield.explorer.mask_panel import MaskPanel

        return MaskPanel(self._session, self._events.masks_changed)

    def open_picked(self, kind: str) -> None:
        """Open the tab of one of `PICKED`."""
        self.picked.active = PICKED.index(kind)

    def limits(self, place: Place) -> tuple[float, float]:
        """Limits of the colour scale, in the displayed unit."""
        return place.limits or self.map.fitted(place)

    def show_view(self, place: Place) -> None:
        """Show a place in the open view; the map is always drawn."""
        if place.tab in self._views:
            self._views[place.tab]().show(place)
            self._show_corners()

    def _step_limits(self, place: Place) -> tuple[float, float]:
        """Limits of the colour scale in the panels that show a step, without average and logarithm."""
        of_step = place.of_step()
        if of_step == place:
            return self.limits(place)
        return self.map.fitted_to(of_step, self._session.record.field(of_step.show, place.step))

    def show_picked(self, place: Place) -> None:
        """Show what is picked, in the open tab."""
        kind = PICKED[int(self.picked.active)]
        (self.node if kind == "node" else self._picked[kind]()).show(place)

    def show_step(self, place: Place) -> None:
        """Show another step of what is picked: the series at the node stay."""
        if PICKED[int(self.picked.active)] == "node":
            self.node.show_step(place)
        else:
            self.show_picked(place)

    def show_probes(self, probes: "xr.Dataset") -> None:
        """Draw the probes of the experiment on the map, and compare the node with the nearest."""
        names = [str(name) for name in probes.probe.values]
        self.map.mark_probes(names, probes.probe_x.values, probes.probe_y.values)
        self.node.probes = probes

    def show_masks(self) -> None:
        """Draw the corners that are clicked, and the masks of the experiment file."""
        from wavefield.series.masks import WATER, footprints

        if self.masks.made:
            self.map.sources["mask"].data = self.masks().closed_line(WATER)
            self._show_corners()
        experiment = self._session.run.experiment
        lines = footprints(experiment.mask) if experiment is not None else ()
        xs, ys = ([[corner[k] for corner in line] for line in lines] for k in (0, 1))
        self.map.sources["masks"].data = {"xs": xs, "ys": ys}

    def _show_corners(self) -> None:
        if self.cameras.made and self.masks.made:
            cameras = self.cameras()
            cameras.sources["mask"].data = self.masks().closed_line(chosen(cameras.camera))
