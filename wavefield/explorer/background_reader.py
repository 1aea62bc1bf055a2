"""What takes seconds to read from a cube: in a thread of its own, the newest request first."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial
from typing import Generic, TypeVar

from bokeh.document import Document

from wavefield.errors import StoreError

_REPORT_S = 0.5  # seconds between reports of progress
_KEPT = 8  # results in memory
Request = TypeVar("Request", bound=Hashable)
Result = TypeVar("Result")


class BackgroundReader(Generic[Request, Result]):
    """Results of a function of the newest request; the last ones are kept."""

    def __init__(
        self,
        read: Callable[[Request, Callable[[float], None]], Result],
        on_progress: Callable[[str], None],
        on_error: Callable[[str], None],
        on_end: Callable[[], None],
    ) -> None:
        """Take the function of a request and a report of its progress, and three that the document calls."""
        self._read, self._on_progress, self._on_error, self._on_end = read, on_progress, on_error, on_end
        self._requested: Request | None = None
        self._kept: OrderedDict[Request, Result | None] = OrderedDict()
        self._reading = False

    def get(self, request: Request, document: Document | None) -> Result | None:
        """The result of a request; None until it is read, and where it cannot be."""
        self._requested = request
        if request not in self._kept and not self._reading and document is not None:
            self._reading = True
            threading.Thread(target=self._work, args=(document,), daemon=True, name="reader").start()
        return self._kept.get(request)

    def _work(self, document: Document) -> None:
        """Read what is requested, and again if the request has changed meanwhile."""
        last_report = time.monotonic()

        def progress(done: float) -> None:
            nonlocal last_report
            if time.monotonic() - last_report > _REPORT_S:
                last_report = time.monotonic()
                document.add_next_tick_callback(partial(self._report, f"reading: {100 * done:.0f} %"))

        while (request := self._requested) is not None and request not in self._kept:
            try:
                self._kept[request] = self._read(request, progress)
            except StoreError as error:
                self._kept[request] = None
                document.add_next_tick_callback(partial(self._on_error, str(error)))
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._reading = False
        document.add_next_tick_callback(self._on_end)

    def _report(self, words: str) -> None:
        if self._reading:
            self._on_progress(words)
