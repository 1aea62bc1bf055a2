"""What keeps readers from a page: by axe-core where a Python package brings it, and by checks of our own."""

from importlib.resources import files
from importlib.util import find_spec

PACKAGES = ("axe_playwright_python", "axe_core_python")
_OWN = """() => {
  const faults = [], report = (words, one) => faults.push(`${words}: ${one.outerHTML.slice(0, 120)}`);
  const root = document.documentElement, all = (what) => [...document.querySelectorAll(what)];
  if (!root.lang) report("no language", root);
  if (!document.title) report("no title", root);
  if (all("main").length != 1 || all("h1").length != 1) report("not one main part and main heading", root);
  let before = 0;
  for (const one of all("h1, h2, h3, h4, h5, h6")) {
    const level = Number(one.tagName[1]);
    if (level > before + 1) report("a level of headings is left out", one);
    before = level;
  }
  for (const one of all("img")) if (!one.alt) report("no words for a picture", one);
  for (const one of all("input, select, textarea"))
    if (!one.labels.length && !one.ariaLabel) report("no label", one);
  for (const one of all("canvas")) if (!one.ariaLabel) report("no words for a picture", one);
  for (const one of all("th")) if (!one.scope || !one.textContent.trim()) report("a heading of a table", one);
  for (const one of all("a, button, summary")) if (!one.textContent.trim()) report("nothing to read", one);
  const ids = all("[id]").map((one) => one.id);
  for (const id of new Set(ids))
    if (ids.indexOf(id) != ids.lastIndexOf(id)) report("an id twice", document.getElementById(id));
  const numbers = (colour) => (colour.match(/[\\d.]+/g) || []).map(Number);
  const light = (rgb) => rgb.slice(0, 3).map((v) => v / 255)
    .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const ground = (one) => {
    for (; one; one = one.parentElement) {
      const colour = numbers(getComputedStyle(one).backgroundColor);
      if (colour.length == 3 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  for (const one of all("body *")) {
    const words = [...one.childNodes].some((node) => node.nodeType == 3 && node.data.trim());
    if (!words || one.closest("script, style, noscript") || !one.checkVisibility()) continue;
    const style = getComputedStyle(one), size = parseFloat(style.fontSize);
    const large = size >= 24 || (Number(style.fontWeight) >= 700 && size >= 18.66);
    const pair = [light(numbers(style.color)), light(ground(one))].sort((a, b) => b - a);
    const contrast = (pair[0] + 0.05) / (pair[1] + 0.05);
    if (contrast < (large ? 3 : 4.5)) report(`contrast ${contrast.toFixed(1)}`, one);
  }
  return faults;
}"""


def accessibility_faults(window) -> list[str]:
    """Faults of the page in a window of Playwright: serious and critical ones of axe-core, all of our own."""
    faults = list(window.evaluate(_OWN))
    package = next((name for name in PACKAGES if find_spec(name)), None)
    if package is not None:
        window.evaluate(files(package).joinpath("axe.min.js").read_text(encoding="utf-8"))
        found = window.evaluate("() => axe.run()")["violations"]
        serious = [one for one in found if one["impact"] in ("serious", "critical")]
        faults += [f"{one['id']}: {one['nodes'][0]['html'][:120]}" for one in serious]
    return faults
