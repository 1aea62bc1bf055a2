// What axe-core calls serious, as far as it concerns a page of figures and widgets: names of controls, contrast of
// texts, language, title, landmarks, one heading, viewport. Returns what is wrong.
() => {
  const found = [], all = []
  const walk = (root) => {
    for (const e of root.querySelectorAll("*")) {
      all.push(e)
      if (e.shadowRoot) walk(e.shadowRoot)
    }
  }
  const seen = (e) => e.checkVisibility() && e.getBoundingClientRect().width > 0
  const label = (e) => e.id && e.getRootNode().querySelector(`label[for="${e.id}"]`)
  const named = (e) =>
    e.getAttribute("aria-label") || e.title || (!e.matches("select") && e.textContent.trim()) ||
    label(e)?.textContent.trim() || e.closest("label")?.textContent.trim()
  const rgb = (text) => {
    const parts = text.match(/[\d.]+/g).map(Number)
    return parts.length > 3 && parts[3] == 0 ? null : parts.slice(0, 3)
  }
  const background = (e) => {
    for (; e; e = e.parentElement ?? e.getRootNode().host) {
      const colour = rgb(getComputedStyle(e).backgroundColor)
      if (colour) return colour
    }
    return [255, 255, 255]
  }
  const light = (colour) => {
    const [r, g, b] = colour.map((v) => (v <= 10 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4))
    return 0.2126 * r + 0.7152 * g + 0.0722 * b
  }
  walk(document)
  for (const e of all.filter(seen)) {
    const control = "input, select, button, a[href], summary, [role=slider], [role=button]"
    if (e.matches(control) && !named(e)) found.push(`no name: ${e.outerHTML.slice(0, 90)}`)
    const text = [...e.childNodes].some((n) => n.nodeType == 3 && n.textContent.trim().length > 1)
    if (!text || e.matches("style, script, option, :disabled")) continue
    const [a, b] = [light(rgb(getComputedStyle(e).color) ?? [0, 0, 0]), light(background(e))].sort((p, q) => p - q)
    if ((b + 0.05) / (a + 0.05) < 4.5) found.push(`contrast: ${e.textContent.trim().slice(0, 60)}`)
  }
  if (!document.documentElement.lang) found.push("no language")
  if (!document.title) found.push("no title")
  for (const name of ["main", "h1", "header"])
    if (document.querySelectorAll(name).length != 1) found.push(`not one ${name}`)
  if (!document.querySelector("meta[name=viewport]")) found.push("no viewport")
  return found
}
