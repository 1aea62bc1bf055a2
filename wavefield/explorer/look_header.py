"""The head of the page of `wavefield look`: how far the run is, significant height, verdict."""

import re
from html import escape

import numpy as np
from bokeh.layouts import row
from jinja2 import Environment
from markupsafe import Markup

from wavefield.errors import WavefieldError
from wavefield.explorer.plot_parts import alert, number, words_of
from wavefield.explorer.selections import decode
from wavefield.explorer.session import LookSession
from wavefield.store.verdict import WORDS, read_verdict
from wavefield.text import spell_time

_COLOURS = {"note": "#00664b", "remark": "#7a5200", "grave": "#a83d00"}
_CODE = re.compile(r"`([^`]+)`")
_VERDICT = Environment(autoescape=True).from_string(
    """<details><summary>Verdict: <b style="color: {{ colour }}">{{ words }}</b>
{%- if count %} ({{ count }}){% endif %}</summary><ul style="margin: 2px 0; padding-left: 18px">
{% for remark in remarks %}<li>{{ remark }}</li>{% endfor %}</ul></details>"""
)


class LookHeader:
    """State of the run and of the preview; significant height; verdict with its remarks."""

    def __init__(self, session: LookSession) -> None:
        self._session = session
        self.trouble = ""  # why something of the experiment is not shown
        self._error = ""  # of the last drawing, as HTML
        self.state = words_of("state_words", html=True)
        self.verdict = words_of("verdict_words", html=True)
        for words in (self.state, self.verdict):
            words.sizing_mode = None  # as wide as the text
        wrap = {"flex-wrap": "wrap", "column-gap": "24px"}
        self.layout = row(self.state, self.verdict, name="state", sizing_mode="stretch_width", styles=wrap)

    def report(self, error: WavefieldError) -> None:
        """Show an error of a drawing, until another one succeeds."""
        self._error = alert(error)
        self.show()

    def forget_error(self) -> None:
        """What is shown is drawn anew."""
        if self._error:
            self._error = ""
            self.show()

    def show(self) -> None:
        """Show how far the run and the reading of its preview are, and the significant height."""
        record, preview = self._session.record, self._session.record.preview
        done, steps = record.steps_done, record.layout.steps
        words = f"{steps} steps at {record.frame_rate:g} Hz, {spell_time(steps / record.frame_rate)}"
        if done < steps:
            words += f"; measured so far: {done} ({100 * done // steps} %)"
        if not preview.complete:
            percent = 100 * int(preview.loaded.sum()) // max(int(preview.measured.sum()), 1)
            words += f"; reading the preview for series: {percent} %"
        elif height := self._significant_height():  # none of a light sheet, which is flat
            words += f"; <b>Hs {number(100 * height)} cm</b>"
        for trouble in filter(None, (preview.trouble, self.trouble)):
            words += f"; {escape(trouble, quote=False)}"
        self.state.text = f"{self._error} {words}".strip()

    def _significant_height(self) -> float | None:
        """That of the analysis, metres, or else four standard deviations of z in the preview."""
        session = self._session
        if "run" not in vars(session):  # not read yet
            return None
        try:
            found = session.run.wave_group("statistics")
        except WavefieldError:  # the panel of the waves reports it
            found = None
        if found is not None and "significant_height" in found:
            return float(found.significant_height)
        preview = session.record.preview
        if "z" not in preview.thin.names:
            return None
        z = decode(preview.stored("z"), preview.scale("z"))
        return 4 * float(np.nanstd(z)) if np.isfinite(z).any() else None

    def show_verdict(self) -> None:
        """Show the verdict that the run left, with its remarks folded."""
        try:
            found = read_verdict(self._session.record.path)
        except WavefieldError as error:
            self.verdict.text = alert(error)
            return
        if found is None:
            self.verdict.text = ""
            return
        count = sum(remark.weight != "note" for remark in found.remarks)
        self.verdict.text = _VERDICT.render(
            colour=_COLOURS[found.weight], words=WORDS[found.weight], count=count,
            remarks=[
                Markup(_CODE.sub(r"<code>\1</code>", escape(str(remark), quote=False)))
                for remark in found.remarks
            ],
        )  # fmt: skip
