// The gyro's bias by axis, as two know it: the node's own filter, and the host's while it drives; with bands.

import { begin, colour, font, label, roundStep } from "./canvas.js";

const DEG = 180 / Math.PI;

// own, host: {bias: [3], sigma: [3]} in rad/s, or null.
export function drawBias(canvas, own, host, stroke) {
  const { pen, width, height } = begin(canvas);
  const left = 18, right = width - 8, rows = 3, high = (height - 18) / rows;
  const half = reach(own, host);
  const x = (v) => (left + right) / 2 + (v / half) * ((right - left) / 2 - 2);
  const step = roundStep(2 * half, width < 300 ? 3 : 5);
  pen.font = font(11);
  pen.lineWidth = 1;
  for (let v = Math.ceil(-half / step) * step; v <= half + 1e-9; v += step) {
    pen.strokeStyle = colour(Math.abs(v) < step / 2 ? "dim" : "grid");
    pen.beginPath();
    pen.moveTo(Math.round(x(v)) + 0.5, 2);
    pen.lineTo(Math.round(x(v)) + 0.5, height - 16);
    pen.stroke();
    pen.fillStyle = colour("dim");
    pen.textAlign = "center";
    pen.fillText(label(v, step), Math.min(Math.max(x(v), left + 12), right - 12), height - 3);
  }
  "xyz".split("").forEach((axis, k) => {
    const y = 2 + high * (k + 0.5);
    pen.fillStyle = colour("ink");
    pen.font = font(12, 600);
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillText(axis, 2, y);
    pen.textBaseline = "alphabetic";
    interval(pen, x, left, right, y - high * 0.17, host, k, colour("fused"), false);
    interval(pen, x, left, right, y + high * 0.17, own, k, stroke, true);
  });
}

function interval(pen, x, left, right, y, told, axis, stroke, round) {
  if (!told || told.bias[axis] === null) { return; }
  const value = told.bias[axis] * DEG, sigma = (told.sigma[axis] ?? 0) * DEG;
  const clamp = (v) => Math.min(Math.max(v, left), right);
  pen.strokeStyle = pen.fillStyle = stroke;
  pen.globalAlpha = 0.35;
  pen.lineWidth = 5;
  pen.lineCap = "butt";
  pen.beginPath();
  pen.moveTo(clamp(x(value - sigma)), y);
  pen.lineTo(clamp(x(value + sigma)), y);
  pen.stroke();
  pen.globalAlpha = 1;
  pen.beginPath();
  if (round) {
    pen.arc(clamp(x(value)), y, 3.4, 0, 7);
  } else {
    const at = clamp(x(value));
    pen.moveTo(at, y - 4.4);
    pen.lineTo(at + 4.4, y);
    pen.lineTo(at, y + 4.4);
    pen.lineTo(at - 4.4, y);
  }
  pen.fill();
}

// deg/s to each side of zero: all values, and of the bands as much as is of use beside them.
function reach(own, host) {
  const all = [own, host].filter(Boolean);
  const values = all.flatMap((told) => told.bias).filter((v) => v !== null).map((v) => Math.abs(v) * DEG);
  const sigmas = all.flatMap((told) => told.sigma).filter((v) => v !== null).map((v) => v * DEG);
  const most = Math.max(0.02, ...values), band = Math.max(0, ...sigmas);
  return 1.15 * (most + Math.min(band, 2 * most));
}

export function biasWords(told) {
  if (!told) { return "not known"; }
  return told.bias.map((v, k) => {
    const sigma = told.sigma[k];
    return (v * DEG).toFixed(3) + (sigma === null ? "" : ` ± ${(sigma * DEG).toFixed(3)}`);
  }).join(", ");
}
