// Projects the surface: from `field` and the angles in `view` to quadrilaterals, the farthest first.
const angles = {turn: view.data.turn[0], tilt: view.data.tilt[0]}
if (cb_obj.event_name == "panstart") { view.tags = [angles.turn, angles.tilt]; return }
if (cb_obj.event_name == "pan") {
  const [turn, tilt] = view.tags
  view.data = {turn: [turn + cb_obj.delta_x / 160],
               tilt: [Math.max(0.1, Math.min(1.45, tilt - cb_obj.delta_y / 160))]}
  return // the change of `view` draws
}
if (!field.data.x.length) return
const x = field.data.x[0], y = field.data.y[0], height = field.data.height[0], value = field.data.value[0]
const ct = Math.cos(angles.turn), st = Math.sin(angles.turn)
const ci = Math.cos(angles.tilt), si = Math.sin(angles.tilt)
const nx = x.length, ny = y.length
const across = new Float64Array(nx * ny), up = new Float64Array(nx * ny)
for (let j = 0; j < ny; j++) for (let i = 0; i < nx; i++) {
  const n = j * nx + i
  across[n] = ct * x[i] - st * y[j]
  up[n] = (st * x[i] + ct * y[j]) * si + height[n] * ci // NaN where nothing was measured
}
const cells = []
for (let j = 0; j + 1 < ny; j++) for (let i = 0; i + 1 < nx; i++) {
  const n = j * nx + i
  if (isFinite(up[n] + up[n + 1] + up[n + nx] + up[n + nx + 1])) cells.push([st * x[i] + ct * y[j], n])
}
cells.sort((a, b) => b[0] - a[0])
const xs = [], ys = [], values = []
for (const [, n] of cells) {
  xs.push([across[n], across[n + 1], across[n + nx + 1], across[n + nx]])
  ys.push([up[n], up[n + 1], up[n + nx + 1], up[n + nx]])
  values.push(value[n])
}
quads.data = {xs: xs, ys: ys, value: values}
const x0 = x[0], x1 = x[nx - 1], y0 = y[0], y1 = y[ny - 1]
const at = (a, b) => [ct * a - st * b, (st * a + ct * b) * si]
const corners = [at(x0, y0), at(x1, y0), at(x1, y1), at(x0, y1), at(x0, y0)]
frame.data = {x: corners.map((p) => p[0]), y: corners.map((p) => p[1])}
const ends = [at(0, y0 * 1.18), at(x1 * 1.16, 0)]
words.data = {x: ends.map((p) => p[0]), y: ends.map((p) => p[1]),
              text: [`x, ${(x1 - x0).toPrecision(3)} m`, `y, ${(y1 - y0).toPrecision(3)} m`]}
