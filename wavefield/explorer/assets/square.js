// Adapts the axes of a figure to its size, so that the pixels of its image stay square.
const [width, height] = made.tags, [w, h] = [made.inner_width, made.inner_height]
if (!width || !w || !h) return
const px = Math.max(width / w, height / h), dx = (px * w - width) / 2, dy = (px * h - height) / 2
made.x_range.setv({start: -dx, end: width + dx, reset_start: -dx, reset_end: width + dx})
made.y_range.setv({start: height + dy, end: -dy, reset_start: height + dy, reset_end: -dy})
