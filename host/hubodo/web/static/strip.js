// A chart of the last minute: lines over time, with a band where a sigma is known; and the tiny ones in cells.

import { begin, colour, font, label, roundStep } from "./canvas.js";

export const SPAN = 60;

// steps: between lines, where these are rounder than decimals.
// series: [{points: [[t, value, sigma]], colour, band, width}]; now: s at the right edge; least: smallest span.
export function strip(canvas, series, now, { least = 1, zero = false, steps = null } = {}) {
  const { pen, width, height } = begin(canvas);
  const box = { left: 44, right: width - 8, top: 8, bottom: height - 20 };
  const [low, high] = range(series, now, least, zero);
  const x = (t) => box.right - ((now - t) / SPAN) * (box.right - box.left);
  const y = (v) => box.bottom - ((v - low) / (high - low)) * (box.bottom - box.top);
  pen.font = font(11);
  pen.lineWidth = 1;
  const step = steps?.find((one) => (high - low) / one <= 6) ?? roundStep(high - low, 5);
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (let v = Math.ceil(low / step) * step; v <= high + step * 1e-6; v += step) {
    pen.strokeStyle = colour(Math.abs(v) < step * 1e-6 ? "line" : "grid");
    line(pen, box.left, y(v), box.right, y(v));
    pen.fillStyle = colour("dim");
    pen.fillText(label(v, step), box.left - 7, y(v));
  }
  pen.textBaseline = "alphabetic";
  for (let s = 0; s <= SPAN; s += width < 420 ? 20 : 10) {
    pen.textAlign = s === 0 ? "right" : "center";
    pen.fillStyle = colour("dim");
    pen.fillText(s === 0 ? "now" : `−${s} s`, x(now - s), height - 5);
  }
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top - 4, box.right - box.left, box.bottom - box.top + 8);
  pen.clip();
  for (const one of series) { draw(pen, one, x, y, now); }
  pen.restore();
}

function draw(pen, { points, colour: stroke, band, width = 1.75 }, x, y, now) {
  const seen = points.filter((point) => point[0] > now - SPAN - 1 && point[1] !== null);
  if (!seen.length) { return; }
  if (band) {
    pen.fillStyle = stroke;
    pen.globalAlpha = 0.16;
    pen.beginPath();
    seen.forEach(([t, v, s]) => pen.lineTo(x(t), y(v + (s ?? 0))));
    seen.toReversed().forEach(([t, v, s]) => pen.lineTo(x(t), y(v - (s ?? 0))));
    pen.fill();
    pen.globalAlpha = 1;
  }
  pen.strokeStyle = stroke;
  pen.lineWidth = width;
  pen.beginPath();
  let last = -Infinity;
  for (const [t, v] of seen) {
    // What was not heard is not drawn as if it had been.
    if (t - last > 1) { pen.moveTo(x(t), y(v)); } else { pen.lineTo(x(t), y(v)); }
    last = t;
  }
  pen.stroke();
}

function range(series, now, least, zero) {
  let low = zero ? 0 : Infinity, high = zero ? 0 : -Infinity;
  for (const { points, band } of series) {
    for (const [t, v, s] of points) {
      if (t < now - SPAN || v === null) { continue; }
      const around = band ? Math.min(s ?? 0, 60) : 0;
      low = Math.min(low, v - around);
      high = Math.max(high, v + around);
    }
  }
  if (!(high >= low)) { [low, high] = [0, least]; }
  const middle = (low + high) / 2, half = Math.max((high - low) * 0.55, least / 2);
  return [middle - half, middle + half];
}

function line(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, Math.round(y0) + 0.5);
  pen.lineTo(x1, Math.round(y1) + 0.5);
  pen.stroke();
}

// values: [[t, value]], one a second.
export function spark(canvas, values, now, stroke, least = 0) {
  const { pen, width, height } = begin(canvas);
  const seen = values.filter(([t, v]) => t > now - SPAN && v !== null);
  if (!seen.length) { return; }
  let low = Math.min(...seen.map((p) => p[1])), high = Math.max(...seen.map((p) => p[1]));
  const half = Math.max((high - low) / 2, least / 2, 1e-9), middle = (low + high) / 2;
  const x = (t) => width - 2 - ((now - t) / SPAN) * (width - 4);
  const y = (v) => height / 2 - ((v - middle) / half) * (height / 2 - 3);
  pen.strokeStyle = stroke;
  pen.lineWidth = 1.25;
  pen.beginPath();
  seen.forEach(([t, v]) => pen.lineTo(x(t), y(v)));
  pen.stroke();
  const [t, v] = seen[seen.length - 1];
  pen.fillStyle = stroke;
  pen.beginPath();
  pen.arc(x(t), y(v), 2, 0, 7);
  pen.fill();
}
