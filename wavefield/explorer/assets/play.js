// Plays steps. It requests a step when the one before it has arrived, so that requests do not pile up.
const next = () => {
  if (!play.active) return
  const wait = Math.max(0, 80 - (performance.now() - (play._asked ?? 0)))
  setTimeout(() => {
    if (!play.active) return
    play._asked = performance.now()
    step.value = step.value >= step.end ? step.start : step.value + 1
  }, wait)
}
if (cb_obj === play) { play.label = play.active ? "Pause" : "Play"; next() }
else if (play.active) requestAnimationFrame(next)
