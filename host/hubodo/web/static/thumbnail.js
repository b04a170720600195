// A small drawing of the path of a recording, loaded when its card comes into view.

import { call } from "./server.js";

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 132, HEIGHT = 88, MARGIN = 6; // px
const previews = new Map();

const observer = new IntersectionObserver((entries) => {
  for (const entry of entries.filter((entry) => entry.isIntersecting)) {
    observer.unobserve(entry.target);
    fill(entry.target);
  }
}, { rootMargin: "600px" });

// Returns the element; it stays empty until the path is known, and is removed if the log has none.
export function thumbnail(recording, path) {
  const figure = document.createElement("figure");
  figure.className = "thumbnail";
  figure.dataset.path = path;
  figure.dataset.key = `${recording.name} ${recording.changed}`;
  observer.observe(figure);
  return figure;
}

async function fill(figure) {
  const key = figure.dataset.key;
  if (!previews.has(key)) { previews.set(key, call(`/api/paths/${figure.dataset.path}`).catch(() => ({ points: [] }))); }
  const { points, topic } = await previews.get(key);
  if (points.length < 2) { figure.remove(); return; }
  const size = draw(figure, points);
  figure.append(Object.assign(document.createElement("figcaption"), { textContent: size, className: "dim" }));
  figure.title = `${topic}: ${size}`;
}

function draw(figure, points) {
  const xs = points.map(([x]) => x), ys = points.map(([, y]) => y);
  const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const scale = Math.min((WIDTH - 2 * MARGIN) / Math.max(x1 - x0, 0.1), (HEIGHT - 2 * MARGIN) / Math.max(y1 - y0, 0.1));
  const at = ([x, y]) => [WIDTH / 2 + (x - (x0 + x1) / 2) * scale, HEIGHT / 2 - (y - (y0 + y1) / 2) * scale].map((v) => v.toFixed(1));
  const size = `${length(x1 - x0)} × ${length(y1 - y0)}`;
  const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `Path, ${size}` });
  const [startX, startY] = at(points[0]);
  svg.append(shape("polyline", { points: points.map((point) => at(point).join(",")).join(" ") }),
    shape("circle", { cx: startX, cy: startY, r: 3.5 }));
  figure.replaceChildren(svg);
  return size;
}

function shape(name, attributes) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) { node.setAttribute(key, value); }
  return node;
}

function length(metres) {
  return metres >= 1000 ? `${(metres / 1000).toFixed(1)} km` : `${metres.toFixed(metres < 10 ? 1 : 0)} m`;
}
