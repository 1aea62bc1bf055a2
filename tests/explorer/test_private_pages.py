"""Pages are private: requests need the token and this machine, and texts of an experiment are not run."""

import http.client
import math
from html.parser import HTMLParser
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest
import xarray as xr
from bokeh.client import pull_session
from bokeh.document import Document
from bokeh.models import Div, HoverTool, Select, Title
from explorer_cases import create_cube, make_cube

from wavefield.errors import ExperimentError, StoreError
from wavefield.explorer.follow import FollowPage, follow_server
from wavefield.explorer.lights import StatusLight
from wavefield.explorer.live import FollowedSet, Follower
from wavefield.explorer.page import LookPage
from wavefield.explorer.parts import TABS, Place
from wavefield.explorer.record import LookSession
from wavefield.explorer.server import ServedPage, look
from wavefield.series import Experiment

POINTS = ["", "?step=3", "ws", "metadata", "autoload.js?bokeh-autoload-element=x", "static/js/bokeh.min.js",
          "nothing/../here"]  # fmt: skip
UPGRADE = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": "bokeh, token",
}  # fmt: skip
ELSEWHERE = {
    "no token": ("/{point}", {}),
    "another token": ("/{other}/{point}", {}),
    "a part of the token": ("/{part}/{point}", {}),
    "the token where it does not belong": ("/{point}?token={token}&{token}", {"Cookie": "token={token}"}),
    "another host": ("/{token}/{point}", {"Host": "evil.example:{port}"}),
    "a host that begins like this one": ("/{token}/{point}", {"Host": "localhost.evil.example"}),
    "a host with a user": ("/{token}/{point}", {"Host": "localhost:{port}@evil.example"}),
    "no host": ("/{token}/{point}", {"Host": ""}),
    "another origin": ("/{token}/{point}", {"Origin": "http://evil.example"}),
    "another port of this machine": ("/{token}/{point}", {"Origin": "http://localhost:1"}),
    "another name of this machine": ("/{token}/{point}", {"Origin": "http://127.0.0.1:{port}"}),
    "a page without an origin": ("/{token}/{point}", {"Origin": "null"}),
    "another scheme": ("/{token}/{point}", {"Origin": "https://localhost:{port}"}),
}


def experiment_file(folder, camera="cam1", name="live"):
    path = folder / "experiment.yaml"
    path.write_text(f'name: "{name}"\nframe_rate: 20\ncameras: {{"{camera}": "c/img_{{frame:05d}}.tif"}}\n')
    return path


@pytest.fixture(scope="module", params=["look", "follow"])
def server(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("private")
    if request.param == "look":
        make_cube(folder / "cube.zarr")
        page = look(folder / "cube.zarr")
    else:
        follower = Follower(Experiment.load(experiment_file(folder)))
        page = ServedPage(lambda: follow_server(follower, 0))
    page.folder = folder
    yield page
    page.stop()


def ask(page, path, headers=None, method="GET"):
    """Return the status and body of a request; the body of a websocket is not awaited."""
    address = urlsplit(page.url)
    one = http.client.HTTPConnection("127.0.0.1", address.port, timeout=60)
    one.putrequest(method, path, skip_host=True)
    headers = {"Host": address.netloc} | (headers or {})
    for name, value in headers.items():
        one.putheader(name, value)
    one.endheaders()
    answer = one.getresponse()
    body = b"" if answer.status == 101 else answer.read()
    one.close()
    return answer.status, body


@pytest.mark.parametrize("case", ELSEWHERE)
def test_requests_that_are_not_of_the_page_are_refused_at_every_address(server, case):
    address = urlsplit(server.url)
    token = address.path.strip("/")
    path, headers = ELSEWHERE[case]
    values = {"token": token, "part": token[:-1], "other": token[::-1], "port": address.port}
    filled = {name: value.format(**values) for name, value in headers.items()}
    before = sorted(p.name for p in server.folder.iterdir())
    for point in POINTS:
        more = UPGRADE if point == "ws" else {}
        for method in ("GET",) if more else ("GET", "POST"):
            status, body = ask(server, path.format(point=point, **values), more | filled, method)
            refused = status == 403 and b"whole address" in body
            assert refused or (status, body) == (400, b""), (point, method, status, body[:200])
    assert sorted(p.name for p in server.folder.iterdir()) == before


def test_requests_of_the_page_are_answered_through_a_tunnel_too(server):
    home = urlsplit(server.url).path
    for host in (urlsplit(server.url).netloc, "localhost:16006", "127.0.0.1:80", "localhost"):
        own = {"Host": host, "Origin": f"http://{host}"}
        assert ask(server, home + "static/js/bokeh.min.js", own)[0] == 200, host
        assert ask(server, home + "ws", UPGRADE | own)[0] == 101, host
    assert ask(server, home, own)[0] == 200
    session = pull_session(url=server.url)
    assert session.document.roots
    session.close()


def test_tokens_differ_and_are_long(tmp_path):
    make_cube(tmp_path / "cube.zarr")
    pages = [look(tmp_path / "cube.zarr") for _ in range(2)]
    tokens = {urlsplit(page.url).path for page in pages}
    assert len(tokens) == 2
    assert min(map(len, tokens)) > 40  # 256 bits
    for page in pages:
        assert page.url in page._repr_html_()  # the frame of a notebook
        page.stop()


# -- what a browser may ask for ----------------------------------------------------------------------------


@pytest.fixture
def own(tmp_path):
    """The page of a cube with its experiment file, and that file."""
    path = experiment_file(tmp_path)
    make_cube(tmp_path / "cube.zarr", experiment_file="experiment.yaml", rig={})
    page, document = LookPage(LookSession(tmp_path / "cube.zarr"), Place()), Document()
    page.attach(document)
    return page, document, path


@pytest.mark.parametrize("text", [None, "# p1 0.1 0.1\ntime,p1\n0,zero\n"])
def test_probes_that_cannot_be_read_are_reported(tmp_path, text):
    path = experiment_file(tmp_path)
    path.write_text(path.read_text() + "probes: gauges.csv\n")
    if text is not None:
        (tmp_path / "gauges.csv").write_text(text)
    make_cube(tmp_path / "cube.zarr", experiment_file="experiment.yaml")
    page = LookPage(LookSession(tmp_path / "cube.zarr"), Place())
    page.attach(Document())
    assert "gauges.csv" in page.state.text


def test_any_value_that_is_not_offered_is_another_one(own):
    page, document, _ = own
    for tab in TABS:
        page.change(tab=tab)
        page.redraw()
    for choice in document.select({"type": Select}):
        choice.value = "../../etc/passwd"
    for step in (-7, 10**9):
        page.controls["step"].value = step
        assert 0 <= page.place.step < page.session.record.layout.steps
    page.redraw()
    assert page.place.show in page.session.record.names
    assert page.entered("drag") == "move"


def test_corners_become_lines_of_the_experiment_file_and_the_page_writes_nothing(own):
    page, _, path = own
    before = {file: file.stat().st_mtime_ns for file in path.parent.rglob("*")}
    for corner in ((math.nan, 0), (0, math.inf), (0, 0), (0.1, 0), (0, 0.12345)):
        assert "polygon" not in page.masks().words.text
        page.masks().add("water", corner)
    lines = page.masks().words.text.split("<pre>")[1].split("</pre>")[0]
    path.write_text(path.read_text() + lines)
    assert Experiment.load(path).mask["water"][0].polygon == [(0, 0), (0.1, 0), (0, 0.1235)]
    after = {file: file.stat().st_mtime_ns for file in path.parent.rglob("*")}
    assert {file for file in after if after[file] != before.get(file)} == {path}


# -- texts of an experiment --------------------------------------------------------------------------------


def mark(name):
    return f"<img src=x onerror=hit('{name}')>"


LOOK = ("folder", "experiment file", "camera", "mask", "frame message", "probe", "preview", "waves")
FOLLOW = ("light", "watch", "trouble")


class Tags(HTMLParser):
    """All tags of a text, with their attributes."""

    def __init__(self, text):
        super().__init__()
        self.tags = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))


def texts(document):
    """Return all that a document shows, as HTML and as plain text."""
    divs = list(document.select({"type": Div}))
    html = [div.text for div in divs if not div.render_as_text]
    plain = [div.text for div in divs if div.render_as_text]
    plain += [title.text for title in document.select({"type": Title})]
    plain += [str(option) for choice in document.select({"type": Select}) for option in choice.options]
    plain += [str(tool.tooltips) for tool in document.select({"type": HoverTool})]
    assert all(div.disable_math for div in divs)
    return html, plain


class Frames:
    """The frames of a camera, none of which can be read."""

    shape, first, mask = (30, 40), 0, None

    def read(self, index):
        return SimpleNamespace(image=None, message=mark("frame message"))

    def covered(self, index):
        return None

    def __len__(self):
        return 100


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Return all that both pages show of an experiment whose texts are all tags with a script."""
    html, plain = [], []
    folder = tmp_path_factory.mktemp("marks") / mark("folder").replace("/", "")
    folder.mkdir()
    create_cube(folder / "cube.zarr", experiment=mark("experiment"), experiment_file=mark("experiment file"))

    def collect(document):
        for into, found in zip((html, plain), texts(document)):
            into += found

    def page_of(**parts):
        session = LookSession(folder / "cube.zarr")
        vars(session.run).update(parts)
        page, document = LookPage(session, Place(node=(0.0, 0.0))), Document()
        page.attach(document)
        for tab in TABS:
            page.change(tab=tab)
            page.redraw()
            collect(document)
        return page, document

    page, document = page_of()
    page.masks().add("water", (0, 0))
    for corner in ((1, 0), (0, 1), (2, 2)):
        page.masks().add("water", corner)
        page.masks().add(mark("mask"), corner)
    collect(document)
    page.session.record.preview.trouble = mark("preview")
    page._show_head()
    collect(document)
    at = {"probe_x": ("probe", [0.0]), "probe_y": ("probe", [0.0])}
    probes = xr.Dataset(
        {"elevation": (("time", "probe"), np.zeros((4, 1)))},
        {"time": np.arange(4.0), "probe": [mark("probe")]} | at,
    )
    page, document = page_of(frames={mark("camera"): Frames()}, probes=probes)
    plain += map(str, page.map.sources["probes"].data["name"])
    page.change(tab="cameras")
    page.redraw()
    collect(document)

    class Damaged:
        waves_path = folder

        def __getattr__(self, name):
            raise StoreError(mark("waves"))

    page.session.run = Damaged()
    page.waves().show(page.place)
    collect(document)

    follower = Follower(Experiment.load(experiment_file(folder)))
    follow, document = FollowPage(follower), Document()
    follower.watch.trouble["cam1"] = mark("watch")
    follow.attach(document)
    collect(document)
    lights = tuple(StatusLight("focus", mark("light"), state, mark("light")) for state in ("bad", "doubtful"))
    follower.latest = FollowedSet(1, {}, {}, lights, 0.0, 1, 0, mark("trouble"))
    follower.count = 1
    for shown_lights in (lights, lights[1:]):
        follower.latest = FollowedSet(1, {}, {}, shown_lights, 0.0, 1, 0, mark("trouble"))
        follow.refresh()
        collect(document)
    return html, plain


def test_no_text_of_an_experiment_becomes_a_tag(shown):
    html, _ = shown
    for text in html:
        for tag, attributes in Tags(text).tags:
            assert tag not in ("img", "iframe", "object", "svg"), text
            assert not [name for name in attributes if name.startswith("on")], text


@pytest.mark.parametrize("name", [*LOOK, *FOLLOW])
def test_the_texts_do_reach_the_page(shown, name):
    """Without this the test above would prove nothing."""
    html, plain = shown
    text = f"onerror=hit('{name}')"
    seen = [*plain, *(part.replace("&#39;", "'").replace("&lt;", "<") for part in html)]
    assert any(text in part for part in seen)


def test_names_that_could_become_tags_are_refused(tmp_path):
    for names in ({"camera": mark("camera").replace("'", "")}, {"name": mark("name")}):
        with pytest.raises(ExperimentError, match="cannot be part of a file's name"):
            Experiment.load(experiment_file(tmp_path, **names))


def test_the_name_of_an_experiment_is_escaped_in_the_page(tmp_path):
    create_cube(tmp_path / "cube.zarr", experiment=mark("experiment"))
    page = look(tmp_path / "cube.zarr")
    status, body = ask(page, urlsplit(page.url).path)
    page.stop()
    assert status == 200
    assert body.count(b"&lt;img src=x onerror=hit(&#39;experiment&#39;)&gt;") >= 2  # title and heading
    assert b"<img" not in body
