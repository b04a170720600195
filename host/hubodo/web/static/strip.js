// Charts of the last minute: lines with optional 1σ bands, and sparklines.

import { beginDrawing, colour, font, formatTick, roundStep } from "./canvas.js";

export const SPAN_S = 60;

// series: [{points: [[t, value, sigma]], colour, band, width}]; now: time at the right edge, s.
// minSpan: smallest span of values; zero: include zero; steps: allowed tick steps instead of decimal ones.
export function drawStrip(canvas, series, now, { minSpan = 1, zero = false, steps = null } = {}) {
  const { pen, width, height } = beginDrawing(canvas);
  const box = { left: 44, right: width - 8, top: 8, bottom: height - 20 };
  const [low, high] = range(series, now, minSpan, zero);
  const x = (t) => box.right - ((now - t) / SPAN_S) * (box.right - box.left);
  const y = (v) => box.bottom - ((v - low) / (high - low)) * (box.bottom - box.top);
  pen.font = font(11);
  pen.lineWidth = 1;
  const step = steps?.find((candidate) => (high - low) / candidate <= 6) ?? roundStep(high - low, 5);
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (let v = Math.ceil(low / step) * step; v <= high + step * 1e-6; v += step) {
    pen.strokeStyle = colour(Math.abs(v) < step * 1e-6 ? "line" : "grid");
    horizontalLine(pen, box.left, y(v), box.right, y(v));
    pen.fillStyle = colour("dim");
    pen.fillText(formatTick(v, step), box.left - 7, y(v));
  }
  pen.textBaseline = "alphabetic";
  for (let s = 0; s <= SPAN_S; s += width < 420 ? 20 : 10) {
    pen.textAlign = s === 0 ? "right" : "center";
    pen.fillStyle = colour("dim");
    pen.fillText(s === 0 ? "now" : `−${s} s`, x(now - s), height - 5);
  }
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top - 4, box.right - box.left, box.bottom - box.top + 8);
  pen.clip();
  for (const line of series) { drawSeries(pen, line, x, y, now); }
  pen.restore();
}

function drawSeries(pen, { points, colour: stroke, band, width = 1.75 }, x, y, now) {
  const visible = points.filter((point) => point[0] > now - SPAN_S - 1 && point[1] !== null);
  if (!visible.length) { return; }
  if (band) {
    pen.fillStyle = stroke;
    pen.globalAlpha = 0.16;
    pen.beginPath();
    visible.forEach(([t, v, s]) => pen.lineTo(x(t), y(v + (s ?? 0))));
    visible.toReversed().forEach(([t, v, s]) => pen.lineTo(x(t), y(v - (s ?? 0))));
    pen.fill();
    pen.globalAlpha = 1;
  }
  pen.strokeStyle = stroke;
  pen.lineWidth = width;
  pen.beginPath();
  let last = -Infinity;
  for (const [t, v] of visible) {
    // Gaps in the data are not bridged by a line.
    if (t - last > 1) { pen.moveTo(x(t), y(v)); } else { pen.lineTo(x(t), y(v)); }
    last = t;
  }
  pen.stroke();
}

function range(series, now, minSpan, zero) {
  let low = zero ? 0 : Infinity, high = zero ? 0 : -Infinity;
  for (const { points, band } of series) {
    for (const [t, v, s] of points) {
      if (t < now - SPAN_S || v === null) { continue; }
      const halfBand = band ? Math.min(s ?? 0, 60) : 0;
      low = Math.min(low, v - halfBand);
      high = Math.max(high, v + halfBand);
    }
  }
  if (!(high >= low)) { [low, high] = [0, minSpan]; }
  const middle = (low + high) / 2, half = Math.max((high - low) * 0.55, minSpan / 2);
  return [middle - half, middle + half];
}

function horizontalLine(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, Math.round(y0) + 0.5);
  pen.lineTo(x1, Math.round(y1) + 0.5);
  pen.stroke();
}

// values: [[t, value]], one per second.
export function drawSparkline(canvas, values, now, stroke, minSpan = 0) {
  const { pen, width, height } = beginDrawing(canvas);
  const visible = values.filter(([t, v]) => t > now - SPAN_S && v !== null);
  if (!visible.length) { return; }
  let low = Math.min(...visible.map((p) => p[1])), high = Math.max(...visible.map((p) => p[1]));
  const half = Math.max((high - low) / 2, minSpan / 2, 1e-9), middle = (low + high) / 2;
  const x = (t) => width - 2 - ((now - t) / SPAN_S) * (width - 4);
  const y = (v) => height / 2 - ((v - middle) / half) * (height / 2 - 3);
  pen.strokeStyle = stroke;
  pen.lineWidth = 1.25;
  pen.beginPath();
  visible.forEach(([t, v]) => pen.lineTo(x(t), y(v)));
  pen.stroke();
  const [t, v] = visible[visible.length - 1];
  pen.fillStyle = stroke;
  pen.beginPath();
  pen.arc(x(t), y(v), 2, 0, 7);
  pen.fill();
}
