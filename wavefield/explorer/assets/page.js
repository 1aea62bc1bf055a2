// Keys of the page; widgets keep their own keys.
const find = (name) => window.Bokeh && Bokeh.documents.length ? Bokeh.documents[0].get_model_by_name(name) : null
const step = (by) => {
  const slider = find("step")
  if (slider) slider.value = Math.max(slider.start, Math.min(slider.end, slider.value + by))
}
// Bokeh gives the handles of its sliders and the buttons of its spinners no names, which screen readers need.
const nameControls = (root) => {
  for (const handle of root.querySelectorAll("[role=slider]:not([aria-label])"))
    handle.setAttribute("aria-label", root.querySelector(".bk-slider-title")?.textContent || "value")
  for (const button of root.querySelectorAll(".bk-spin-btn:not([aria-label])"))
    button.setAttribute("aria-label", button.matches(".bk-spin-btn-up") ? "increase" : "decrease")
  for (const element of root.querySelectorAll("*")) if (element.shadowRoot) nameControls(element.shadowRoot)
}
setInterval(() => nameControls(document), 1000)
const keys = {
  ArrowRight: () => step(1), ArrowLeft: () => step(-1), PageUp: () => step(20), PageDown: () => step(-20),
  Home: () => { find("step").value = find("step").start }, End: () => { find("step").value = find("step").end },
  " ": () => { find("play").active = !find("play").active },
  p: () => { find("drag").value = "move" }, m: () => { find("drag").value = "mask" },
  a: () => { find("overlay").value = find("overlay").value == "nothing" ? "arrows" : "nothing" },
  1: () => { find("views").active = 0 }, 2: () => { find("views").active = 1 },
  3: () => { find("views").active = 2 },
}
document.addEventListener("keydown", (event) => {
  const target = event.composedPath()[0]
  const within = (names) => Boolean(target.matches && target.matches(names))
  const typing = within("input, select, textarea")
  const sliding = within("[role=slider], .noUi-handle") && /^(Arrow|Page|Home|End)/.test(event.key)
  if (event.ctrlKey || event.altKey || event.metaKey || !keys[event.key] || !find("step")) return
  if (typing || sliding || (event.key == " " && within("button, a"))) return
  event.preventDefault()
  keys[event.key]()
})
