"use strict";
(function () {
  const text = (id) => document.getElementById(id).textContent;
  const d = JSON.parse(text("field-description")), field = {};
  // bytes (time, y, x) of an element: differences along x and y, compressed, in base 64
  async function load(name, nx, ny) {
    const packed = Uint8Array.from(atob(text("field-" + name)), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const out = new Uint8Array(await new Response(stream).arrayBuffer());
    for (let i = 0; i < out.length; i++) if (Math.floor(i / nx) % ny) out[i] += out[i - nx];
    for (let i = 0; i < out.length; i++) if (i % nx) out[i] += out[i - 1];
    field[name] = out;
  }
  const missing = [217, 217, 217], ink = "#1b1f24";
  const paint = (code) => (code ? d.colours[code] : missing);
  const nodes = d.nx * d.ny, a = d.arrows, arrowCount = a.x.length * a.y.length;
  const map = document.getElementById("map"), relief = document.getElementById("relief");
  const slider = document.getElementById("moment"), clock = document.getElementById("clock");
  const font = (size) => size + "px system-ui, sans-serif";
  slider.max = d.time.length - 1;

  const round = (v) => Number(v.toPrecision(2)).toString();
  const label = (v) => Number(v.toPrecision(6)).toString().replace("-", "\u2212");
  function ticks(lo, hi, count) {
    const raw = (hi - lo) / count, power = Math.pow(10, Math.floor(Math.log10(raw)));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
    const out = [];
    for (let v = Math.ceil(lo / step - 1e-9) * step; v <= hi + 1e-9 * step; v += step) out.push(Math.abs(v) < 1e-9 * step ? 0 : v);
    return out;
  }
  // ends of the map: half a cell beyond the outer nodes
  const cell = (ends, n) => (ends[1] - ends[0]) / Math.max(n - 1, 1) / 2;
  const beyond = (ends, n) => [ends[0] - cell(ends, n), ends[1] + cell(ends, n)];

  function bar(c, x, y, w, h) {
    const end = d.ends.w;
    for (let i = 0; i < h; i++) {
      c.fillStyle = `rgb(${d.colours[Math.round(255 * (1 - i / (h - 1)))]})`;
      c.fillRect(x, y + i, w, 1.5);
    }
    c.strokeStyle = "#333"; c.lineWidth = 1; c.strokeRect(x, y, w, h);
    c.fillStyle = ink; c.font = font(20); c.textAlign = "left"; c.textBaseline = "middle";
    for (const v of ticks(-end, end, 6)) {
      const yy = y + h * (end - v) / (2 * end);
      c.fillRect(x + w, yy, 5, 1.5); c.fillText(label(v), x + w + 9, yy);
    }
    c.textAlign = "right"; c.fillText("w (cm/s)", Math.min(x + w + 60, c.canvas.width - 4), y - 18);
  }

  const small = document.createElement("canvas");
  small.width = d.nx; small.height = d.ny;
  function drawMap(step) {
    const c = map.getContext("2d"), W = map.width, H = map.height;
    c.fillStyle = "#fff"; c.fillRect(0, 0, W, H);
    const s = small.getContext("2d"), image = s.createImageData(d.nx, d.ny);
    for (let j = 0; j < d.ny; j++) for (let i = 0; i < d.nx; i++) {
      const at = 4 * ((d.ny - 1 - j) * d.nx + i);
      image.data.set([...paint(field.w[step * nodes + j * d.nx + i]), 255], at);
    }
    s.putImageData(image, 0, 0);
    const left = 84, top = 54, right = 118, bottom = 74;
    const [x0, x1] = beyond(d.x, d.nx), [y1, y2] = beyond(d.y, d.ny), wide = x1 - x0, high = y2 - y1;
    const scale = Math.min((W - left - right) / wide, (H - top - bottom) / high);
    const w = wide * scale, h = high * scale, y0 = top + (H - top - bottom - h) / 2;
    c.drawImage(small, left, y0, w, h);
    c.strokeStyle = "#333"; c.lineWidth = 1.5; c.strokeRect(left, y0, w, h);
    const px = (x) => left + (x - x0) * scale, py = (y) => y0 + h - (y - y1) * scale;
    c.fillStyle = ink; c.font = font(20);
    c.textAlign = "center"; c.textBaseline = "top";
    for (const v of ticks(x0, x1, 5)) { c.fillRect(px(v) - .75, y0 + h, 1.5, 6); c.fillText(label(v), px(v), y0 + h + 9); }
    c.fillText("x (m)", left + w / 2, y0 + h + 36);
    c.textAlign = "right"; c.textBaseline = "middle";
    for (const v of ticks(y1, y2, 5)) { c.fillRect(left - 6, py(v) - .75, 6, 1.5); c.fillText(label(v), left - 10, py(v)); }
    c.save(); c.translate(18, y0 + h / 2); c.rotate(-Math.PI / 2); c.textAlign = "center"; c.fillText("y (m)", 0, 0); c.restore();
    bar(c, left + w + 22, y0, 20, h);
    const grow = a.length * scale / a.fastest, top1 = a.fastest * 1.3;
    const arrow = (x, y, u, v) => {
      const dx = u * grow, dy = -v * grow, n = Math.hypot(dx, dy);
      if (n < 1.5) return;
      const head = Math.min(9, 0.45 * n), ex = dx / n, ey = dy / n;
      c.beginPath(); c.moveTo(x, y); c.lineTo(x + dx, y + dy);
      c.moveTo(x + dx - head * (ex - .45 * ey), y + dy - head * (ey + .45 * ex));
      c.lineTo(x + dx, y + dy);
      c.lineTo(x + dx - head * (ex + .45 * ey), y + dy - head * (ey - .45 * ex));
      c.stroke();
    };
    c.strokeStyle = "#000"; c.lineWidth = 1.7;
    c.save(); c.beginPath(); c.rect(left, y0, w, h); c.clip();
    for (let j = 0; j < a.y.length; j++) for (let i = 0; i < a.x.length; i++) {
      const at = step * arrowCount + j * a.x.length + i, u = field.u[at], v = field.v[at];
      if (u && v) arrow(px(a.x[i]), py(a.y[j]), (u - 128) / 127 * top1, (v - 128) / 127 * top1);
    }
    c.restore();
    const speed = Number(a.fastest.toPrecision(1));
    arrow(left + 4, y0 - 22, speed, 0);
    c.textAlign = "left"; c.fillStyle = ink;
    c.fillText(round(speed) + " cm/s", left + 14 + speed * grow, y0 - 22);
  }

  const stride = Math.max(1, Math.ceil(Math.max(d.nx, d.ny) / 90));
  function drawRelief(step) {
    const c = relief.getContext("2d"), W = relief.width, H = relief.height, half = d.ends.z;
    c.fillStyle = "#fff"; c.fillRect(0, 0, W, H);
    const cols = [], rows = [];
    for (let i = 0; i < d.nx; i += stride) cols.push(i);
    for (let j = 0; j < d.ny; j += stride) rows.push(j);
    const wide = d.x[1] - d.x[0], high = d.y[1] - d.y[0], size = Math.hypot(wide, high);
    const scale = 0.9 * (W - 30) / size, lift = 0.10 * size / half;  // the scale's end is a tenth of the diagonal
    const ct = Math.cos(-0.7), st = Math.sin(-0.7), ci = Math.cos(0.62), si = Math.sin(0.62);
    const project = (x, y, z) => {
      const p = ct * x - st * y, q = st * x + ct * y;
      return [W / 2 + scale * p, H / 2 - scale * (q * si + z * ci), q];
    };
    const at = (i, j) => step * nodes + j * d.nx + i;
    const point = (i, j) => {
      const code = field.z[at(i, j)];
      if (!code) return null;
      return project(wide * (i / (d.nx - 1) - 0.5), high * (j / (d.ny - 1) - 0.5), lift * half * (code - 128) / 127);
    };
    const edge = [[-.5, -.5], [.5, -.5], [.5, .5], [-.5, .5]].map(([x, y]) => project(x * wide, y * high, 0));
    c.strokeStyle = "#8b949e"; c.lineWidth = 1.2; c.setLineDash([5, 4]);
    c.beginPath(); edge.forEach((p, i) => (i ? c.lineTo(p[0], p[1]) : c.moveTo(p[0], p[1]))); c.closePath(); c.stroke(); c.setLineDash([]);
    const grid = rows.map((j) => cols.map((i) => point(i, j)));
    const quads = [];
    for (let j = 0; j + 1 < rows.length; j++) for (let i = 0; i + 1 < cols.length; i++) {
      const p = grid[j][i], q = grid[j][i + 1], r = grid[j + 1][i + 1], s = grid[j + 1][i];
      if (!p || !q || !r || !s) continue;
      const here = field.z[at(cols[i], rows[j])];
      const slope = field.z[at(cols[i + 1], rows[j])] - field.z[at(cols[i], rows[j + 1])];
      const light = 0.88 + 0.12 * Math.max(-1, Math.min(1, slope / (10 * stride)));
      if (here) quads.push([p[2] + r[2], p, q, r, s, field.w[at(cols[i], rows[j])], light]);
    }
    quads.sort((one, other) => other[0] - one[0]);
    for (const [, p, q, r, s, code, light] of quads) {
      c.fillStyle = c.strokeStyle = `rgb(${paint(code).map((v) => v * light | 0)})`;
      c.lineWidth = 0.8; c.beginPath();
      c.moveTo(p[0], p[1]); c.lineTo(q[0], q[1]); c.lineTo(r[0], r[1]); c.lineTo(s[0], s[1]); c.closePath(); c.fill(); c.stroke();
    }
    c.fillStyle = ink; c.font = font(20); c.textAlign = "center"; c.textBaseline = "middle";
    const middle = project(0, 0, 0);
    const mark = (x, y, words) => {  // beside an edge, outwards by more than half of the text
      const p = project(x, y, 0), out = [p[0] - middle[0], p[1] - middle[1]], far = Math.hypot(...out) || 1;
      const gap = 14 + (Math.abs(out[0]) * c.measureText(words).width / 2 + Math.abs(out[1]) * 10) / far;
      c.fillText(words, p[0] + gap * out[0] / far, p[1] + (gap + 8) * out[1] / far);
    };
    mark(0, -0.5 * high, `x, ${label(Number(wide.toPrecision(3)))} m`);
    mark(0.5 * wide, 0, `y, ${label(Number(high.toPrecision(3)))} m`);
    c.textAlign = "left"; c.textBaseline = "top";
    if (lift < 1e4) c.fillText(`height exaggerated ${round(100 * lift)} times`, 14, 12);  // else it is flat
  }

  function go(step) {
    slider.value = step;
    drawMap(step); drawRelief(step);
    const words = `t = ${d.time[step].toFixed(3)} s`;
    clock.textContent = words; slider.setAttribute("aria-valuetext", words);
  }
  slider.addEventListener("input", () => go(Number(slider.value)));
  const loads = [..."zw"].map((name) => load(name, d.nx, d.ny));
  Promise.all([...loads, ...[..."uv"].map((name) => load(name, a.x.length, a.y.length))]).then(() => {
    document.getElementById("still").hidden = true;  // a browser without scripts or decompression shows it instead
    for (const part of document.querySelectorAll(".player [data-moving]")) part.hidden = false;
    go(Math.floor(d.time.length / 2));
  });
})();
