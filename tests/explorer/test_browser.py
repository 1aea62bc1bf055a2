"""Every control of the page, driven in a browser; drawings are compared with numpy."""

import numpy as np
import pytest
import xarray as xr
import yaml
from accessibility import accessibility_faults

from wavefield.explorer.map import arrows
from wavefield.explorer.node import spectrum
from wavefield.figures.display import limit, quality_kind

STEP = 2


@pytest.fixture
def fields(whole):
    return whole[1]


@pytest.fixture(autouse=True)
def usual(page):
    """Start every test with w on the map at step 2, without playback, and clicks that move the map."""
    page.set("play", "active", "false")
    page.set("views", "active", "0")
    page.set("drag", "value", "'move'")
    page.set("show", "value", "'w'")
    page.set("step", "value", str(STEP))
    page.wait(f"{shown('w')} && {at_step(STEP)}")


def model(name):
    return f"Bokeh.documents[0].get_model_by_name('{name}')"


def at_step(step):
    return f"{model('map')}.title.text.includes('t = {(step + 0.5) / 20:.3f} s')"


def shown(name):
    return f"{model('map')}.title.text.startsWith('{name}:')"


def arrived(page, what, where, near=0.02):
    """Wait until everything at the picked node is drawn; the link is written last."""
    link = f"(new URL(location).searchParams.get('{what}') ?? '').split(',').map(Number)"
    page.wait(f"{[float(v) for v in where]}.every((v, k) => Math.abs(v - ({link})[k]) < {near})")


def choose(page, select, value):
    """Select the option of a list whose visible label begins with a value."""
    options = page.page.locator(f"select[name={select}] option").all_inner_texts()
    label = next(option for option in options if option.split(":")[0] == value)
    page.page.locator(f"select[name={select}]").select_option(label=label)


def x_of(field, nx=20):
    return 0.05 * (np.arange(nx) - (nx - 1) / 2)


X, Y = x_of(None, 20), x_of(None, 16)


def test_the_map_is_the_step_of_the_cube(page, fields):
    np.testing.assert_allclose(page.image("map_image"), 100 * fields["w"][STEP], rtol=1e-6)
    assert page.column("map_image", "x")[0] == pytest.approx(X[0] - 0.025)
    assert page.column("map_image", "dh")[0] == pytest.approx(0.8)


@pytest.mark.parametrize(("key", "step"), [("ArrowRight", 3), ("ArrowLeft", 1), ("PageUp", 22), ("End", 159)])
def test_keys_step(page, fields, key, step):
    page.page.keyboard.press(key)
    page.wait(at_step(step))
    np.testing.assert_allclose(page.image("map_image"), 100 * fields["w"][step], rtol=1e-6)


def test_buttons_step_and_the_slider_too(page, fields):
    page.page.get_by_role("button", name="▶").click()
    page.wait(at_step(STEP + 1))
    page.page.get_by_role("button", name="◀").click()
    page.wait(at_step(STEP))
    handle = page.page.locator(".noUi-handle").first
    handle.focus()
    page.page.keyboard.press("ArrowRight")
    page.wait(at_step(STEP + 1))
    np.testing.assert_allclose(page.image("map_image"), 100 * fields["w"][STEP + 1], rtol=1e-6)
    page.page.keyboard.press("m")  # the slider keeps its own keys only
    page.wait(f"{model('drag')}.value == 'mask'")


def test_it_plays_and_stops(page, fields):
    page.page.get_by_role("button", name="Play").click()
    page.wait(f"{model('step')}.value >= 6")
    page.page.get_by_role("button", name="Pause").click()
    page.page.wait_for_timeout(600)
    step = page.get("step", "value")
    page.page.wait_for_timeout(400)
    assert page.get("step", "value") == step
    page.wait(at_step(step))
    np.testing.assert_allclose(page.image("map_image"), 100 * fields["w"][step], rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "factor"), [("z", 100), ("z_t", 100), ("u_std", 100), ("eps_y", 1000), ("eps_piv", 1)]
)
def test_any_variable_is_shown_in_its_unit(page, fields, name, factor):
    choose(page, "show", name)
    page.wait(shown(name))
    np.testing.assert_allclose(page.image("map_image"), factor * fields[name][STEP], rtol=1e-5)


def test_arrows_are_the_velocity_and_go_away(page, fields):
    u, v = fields["u"][STEP], fields["v"][STEP]
    shown = page.column("map_arrows", "x").reshape(-1, 7)
    fastest = limit(np.hypot(u, v), 98)
    xs, _, metres = arrows(u, v, X, Y, fastest)
    # the scale stays that of the first step shown: lengths agree up to one factor
    moved, expected = (a[:, 1] - a[:, 0] for a in (shown, xs.reshape(-1, 7)))
    assert np.corrcoef(moved, expected)[0, 1] > 0.9999
    page.page.keyboard.press("a")
    page.wait(f"{model('map_arrows')}.data.x.length == 0")
    page.page.keyboard.press("a")
    page.wait(f"{model('map_arrows')}.data.x.length > 0")
    assert metres > 0


def test_a_click_shows_everything_at_the_node(page, fields):
    j, i = 10, 13
    page.click("map", X[i] + 0.01, Y[j] - 0.01)
    page.wait(f"{model('node_words')}.text.includes('x 0.175 m, y 0.125 m')")
    arrived(page, "node", (X[i] + 0.01, Y[j] - 0.01))
    for name, factor in (("z", 100), ("u", 100), ("v", 100), ("w", 100)):
        np.testing.assert_allclose(
            page.column(f"node_{name}_series", "value"), factor * fields[name][:, j, i], atol=6e-3
        )
        low, high = page.column(f"node_{name}_series", "low"), page.column(f"node_{name}_series", "high")
        std = factor * fields[f"{name}_std"][:, j, i]
        np.testing.assert_allclose(0.5 * (high - low), std, rtol=0.02)
    kinds = page.column("node_quality", "kind")
    assert kinds.tolist() == [quality_kind(fields["quality"][:1, j, i])[0]]
    expected = spectrum(100 * fields["z"][:, j, i], 0.05)
    np.testing.assert_allclose(page.column("node_spectrum", "f"), expected.frequency, rtol=1e-6)
    np.testing.assert_allclose(page.column("node_spectrum", "e"), expected.density, rtol=0.05)
    page.set("node_which", "value", "'w'")
    expected = spectrum(100 * fields["w"][:, j, i], 0.05)
    page.wait(f"Math.abs({model('node_spectrum')}.data.e[3] / {expected.density[3]} - 1) < 0.1")


def test_a_cameras_frame_shows_the_nodes_where_it_sees_them(page, fields, tank_rig, whole):
    from wavefield.images import read_image

    page.page.keyboard.press("2")
    page.wait(f"{model('camera_image')}.data.image.length == 1 && {model('camera_nodes')}.data.X.length > 0")
    name = page.get("camera", "value")
    image = read_image(whole[0].parent / name / f"img_{STEP:05d}.tif").astype(float)
    drawn = page.image("camera_image")
    factor = image.shape[0] // drawn.shape[0]
    if factor == 1:
        assert np.corrcoef(drawn.ravel(), image.ravel())[0, 1] > 0.999
    x, y = np.meshgrid(X, Y)
    at = {n: fields[n][STEP].astype(float) for n in ("z", "u", "v", "w")}
    X_px, Y_px = tank_rig[name].project(
        x - at["u"] / 40, y - at["v"] / 40, np.nan_to_num(at["z"]) - at["w"] / 40
    )
    inside = np.isfinite(X_px) & (X_px >= 0) & (X_px <= tank_rig[name].size[0] - 1)
    inside &= (Y_px >= 0) & (Y_px <= tank_rig[name].size[1] - 1)
    np.testing.assert_allclose(page.column("camera_nodes", "X"), X_px[inside], atol=0.01)
    np.testing.assert_allclose(page.column("camera_nodes", "Y"), Y_px[inside], atol=0.01)
    wide, high = page.page.evaluate(
        f"(() => {{ const v = {model('camera_view')}; "
        "return [(v.x_range.end - v.x_range.start) / v.inner_width,"
        " (v.y_range.start - v.y_range.end) / v.inner_height] })()"
    )
    assert wide == pytest.approx(high, rel=1e-6)  # pixels are square
    j, i = np.argwhere(inside)[inside.sum() // 2]
    page.click("camera_view", float(X_px[j, i]), float(Y_px[j, i]))
    page.wait(f"Math.abs({model('map_node')}.data.x[0] - {X[i]}) < 1e-6")
    page.wait(f"Math.abs({model('camera_node')}.data.X[0] - {X_px[j, i]}) < 2")
    page.set("step", "value", "100")  # whose frame is not there
    page.wait(f"{model('camera_words')}.text.includes('is missing')")


def test_waves_have_a_ruler_for_the_dispersion_relation(page, whole):
    from wavefield.explorer.waves import log_density

    waves = xr.open_datatree(whole[0].parent / "waves.zarr", engine="zarr", chunks={})
    page.page.keyboard.press("3")
    page.wait(f"{model('wave_image')}.data.image.length == 1 && {model('wave_ruler')}.data.k.length > 0")
    name = page.get("wave_variable", "value")
    energy = waves["spectra"].E.sel(quantity=name).transpose("omega", "k").values
    np.testing.assert_allclose(page.image("wave_image"), log_density(energy), atol=1e-5)
    page.set("wave_current", "value", "0.3")
    page.set("wave_depth", "value", "0.1")
    k = 2 * np.pi * page.column("wave_ruler", "k")

    def relation(k):
        gamma = 0.0728 / 1000
        return (np.sqrt((9.81 * k + gamma * k**3) * np.tanh(0.1 * k)) + 0.3 * k) / (2 * np.pi)

    for at in (20, 399):  # depth is felt by long waves, current by short ones
        page.wait(f"Math.abs({model('wave_ruler')}.data.f[{at}] / {relation(k[at])} - 1) < 1e-6")
    np.testing.assert_allclose(page.column("wave_ruler", "f"), relation(k), rtol=1e-6)
    stored = waves["spectra"].omega_map.values / (2 * np.pi)
    page.click(
        "wave_spectrum",
        0.5 * float(page.page.evaluate(f"{model('wave_spectrum')}.x_range.end")),
        float(stored[2]),
    )
    page.wait(f"{model('wave_map')}.title.text.includes('at {stored[2]:.3g} Hz')")
    plane = waves["spectra"].E_kxky.sel(quantity_map=name).isel(omega_map=2).transpose("ky", "kx").values
    np.testing.assert_allclose(page.image("wave_plane"), log_density(plane), atol=1e-5)


def test_the_link_shows_the_same_view_again(page, chrome, fields):
    page.set("show", "value", "'z'")
    page.click("map", X[4], Y[5])
    page.set("step", "value", "31")
    page.wait(f"{at_step(31)} && new URL(location).searchParams.get('step') == '31'")
    url = page.page.url
    other = type(page)(chrome.new_page(viewport={"width": 1000, "height": 700}))
    other.open(url)
    other.wait(f"{shown('z')} && {at_step(31)}")
    np.testing.assert_allclose(other.image("map_image"), 100 * fields["z"][31], rtol=1e-6)
    assert other.column("map_node", "x")[0] == pytest.approx(X[4], abs=0.01)
    other.page.close()
    assert other.errors == []


def test_it_fits_a_phone(chrome, served):
    from browser import Browser

    screen = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "device_scale_factor": 3}
    phone = Browser(chrome.new_context(**screen).new_page())
    phone.open(served.url + "?node=0.1,0.1")
    assert phone.page.evaluate("[innerWidth, document.documentElement.scrollWidth]") == [390, 390]
    phone.page.context.close()
    assert phone.errors == []
    assert phone.outside == []


@pytest.mark.parametrize("query", ["", "?tab=waves", "?tab=cameras"])
def test_screen_readers_and_weak_eyes_can_use_it(chrome, served, query):
    from browser import Browser

    window = Browser(chrome.new_page(viewport={"width": 1400, "height": 900}))
    window.page.goto(served.url + query)
    window.wait(f"{model('node_z_series')}.data.t.length > 0 && {model('verdict_words')}")
    for tab in ("Mask", "Node"):
        window.page.locator(".bk-tab").get_by_text(tab, exact=True).click()
        window.page.wait_for_timeout(1200)  # names are given every second
        assert accessibility_faults(window.page) == []
    window.page.close()
    assert window.errors == []


def test_a_node_at_a_probe_is_shown_with_its_series(chrome, served, fields):
    from browser import Browser

    window = Browser(chrome.new_page(viewport={"width": 1400, "height": 900}))
    window.open(served.url + "?node=0.125,0.125", "node_probe_series")
    probe = window.column("node_probe_series", "value")
    t = window.column("node_probe_series", "t")
    np.testing.assert_allclose(probe, np.sin(2 * np.pi * 1.1 * t), atol=1e-3)
    bottom = window.page.evaluate(
        f"(() => {{ const v = Bokeh.index.find_one({model('map')});"
        " return v.frame.bbox.bottom + v.el.getBoundingClientRect().y })()"
    )
    assert 700 < bottom < 900  # the map fills the window
    window.page.close()
    assert window.errors == []


def test_texts_of_an_experiment_run_no_script(chrome, tmp_path):
    from browser import Browser
    from explorer_cases import create_cube

    from wavefield.explorer.server import look

    tag = "<img src=x onerror=hit()>"
    folder = tmp_path / tag
    folder.mkdir()
    create_cube(folder / "cube.zarr", experiment=tag, experiment_file=tag)
    served = look(folder / "cube.zarr")
    window = Browser(chrome.new_page())
    window.page.add_init_script("window.hits = 0; window.hit = () => { window.hits += 1 }")
    window.open(served.url)
    window.page.keyboard.press("3")
    window.wait(f"{model('wave_words')}.text.includes('onerror=hit()')")
    window.page.keyboard.press("2")
    window.wait(f"{model('camera_words')}.text.includes('onerror=hit()')")
    window.page.get_by_text("no images").wait_for()
    assert window.page.evaluate("window.hits") == 0
    assert window.page.evaluate("document.querySelectorAll('img[src=x]').length") == 0
    window.page.close()
    served.stop()
    assert window.errors == []


def test_a_lost_connection_is_reported_and_the_page_stays(chrome, whole):
    from browser import Browser

    from wavefield.explorer.server import look

    served = look(whole[0])
    window = Browser(chrome.new_page())
    window.open(served.url)
    served.stop()
    window.page.get_by_role("alert").filter(has_text="connection").wait_for(state="visible", timeout=20_000)
    assert window.image("map_image").shape == (16, 20)
    window.page.close()


def test_a_cube_that_is_being_written_is_followed(chrome, tmp_path):
    from browser import Browser
    from explorer_cases import create_cube, write_cube_block

    from wavefield.explorer.server import look

    path = tmp_path / "cube.zarr"
    create_cube(path)
    write_cube_block(path, 0)
    served = look(path)
    window = Browser(chrome.new_page())
    window.open(served.url + "?step=50&node=0.1,0.1")
    window.wait(f"{model('map')}.title.text.includes('not measured yet')")
    window.page.get_by_text("measured so far: 40 (33 %)").wait_for()
    written = write_cube_block(path, 40)
    window.page.get_by_text("measured so far: 80 (66 %)").wait_for(timeout=20_000)
    window.wait(
        f"{model('map_image')}.data.image[0][100] != null && !isNaN({model('map_image')}.data.image[0][100])"
    )
    np.testing.assert_allclose(window.image("map_image"), 100 * written["w"][10], rtol=1e-6)
    window.page.keyboard.press("3")
    window.wait(f"{model('wave_words')}.text.includes('no waves yet')")
    window.page.keyboard.press("2")
    window.wait(f"{model('camera_words')}.text.includes('no images')")
    window.page.close()
    served.stop()
    assert window.errors == []


def test_masks_are_drawn_with_the_mouse(page):
    page.page.keyboard.press("m")
    page.wait(f"{model('drag')}.value == 'mask'")
    corners = [(-0.3, -0.2), (0.2, -0.25), (0.1, 0.2), (-0.4, 0.3)]
    for number, corner in enumerate(corners, 1):
        page.click("map", *corner)
        page.wait(f"{model('map_mask')}.data.x.length == {number + 1}")
    page.page.get_by_role("button", name="Remove the last corner").click()
    page.wait(f"{model('map_mask')}.data.x.length == 4")
    page.page.keyboard.press("2")
    page.wait(f"{model('views')}.active == 1 && {model('camera_image')}.data.image.length == 1")
    for number, pixel in enumerate(((20, 20), (80, 25), (50, 70)), 1):
        page.click("camera_view", *pixel)
        page.wait(f"{model('camera_mask')}.data.x.length == {number + 1}")
    page.wait(f"{model('mask_words')}.text.includes('polygon')")
    mask = yaml.safe_load(page.page.locator("pre").inner_text())["mask"]
    np.testing.assert_allclose(mask["water"][0]["polygon"], corners[:3], atol=0.01)
    np.testing.assert_allclose(mask["cam1"][0]["polygon"], [(20, 20), (80, 25), (50, 70)], atol=2)
    page.page.get_by_role("button", name="Clear").click()
    page.wait(f"{model('map_mask')}.data.x.length == 0")
