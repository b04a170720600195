// The gyro bias by axis with its 1σ interval, as estimated by the node and by the host while driving.

import { beginDrawing, colour, font, formatTick, roundStep } from "./canvas.js";

const DEG = 180 / Math.PI;

// nodeBias, hostBias: {bias: [3], sigma: [3]} in rad/s, or null; nodeColour: colour of the node.
export function drawBias(canvas, nodeBias, hostBias, nodeColour) {
  const { pen, width, height } = beginDrawing(canvas);
  const left = 18, right = width - 8, rows = 3, rowHeight = (height - 18) / rows;
  const halfSpan = halfRange(nodeBias, hostBias);
  const x = (v) => (left + right) / 2 + (v / halfSpan) * ((right - left) / 2 - 2);
  const step = roundStep(2 * halfSpan, width < 300 ? 3 : 5);
  pen.font = font(11);
  pen.lineWidth = 1;
  for (let v = Math.ceil(-halfSpan / step) * step; v <= halfSpan + 1e-9; v += step) {
    pen.strokeStyle = colour(Math.abs(v) < step / 2 ? "dim" : "grid");
    pen.beginPath();
    pen.moveTo(Math.round(x(v)) + 0.5, 2);
    pen.lineTo(Math.round(x(v)) + 0.5, height - 16);
    pen.stroke();
    pen.fillStyle = colour("dim");
    pen.textAlign = "center";
    pen.fillText(formatTick(v, step), Math.min(Math.max(x(v), left + 12), right - 12), height - 3);
  }
  "xyz".split("").forEach((axis, k) => {
    const y = 2 + rowHeight * (k + 0.5);
    pen.fillStyle = colour("ink");
    pen.font = font(12, 600);
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillText(axis, 2, y);
    pen.textBaseline = "alphabetic";
    interval(pen, x, left, right, y - rowHeight * 0.17, hostBias, k, colour("fused"), false);
    interval(pen, x, left, right, y + rowHeight * 0.17, nodeBias, k, nodeColour, true);
  });
}

function interval(pen, x, left, right, y, estimate, axis, stroke, isRound) {
  if (!estimate || estimate.bias[axis] === null) { return; }
  const value = estimate.bias[axis] * DEG, sigma = (estimate.sigma[axis] ?? 0) * DEG;
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
  if (isRound) {
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

// Returns the halfSpan range in deg/s: estimates values, and the intervals up to twice the largest value.
function halfRange(nodeBias, hostBias) {
  const estimates = [nodeBias, hostBias].filter(Boolean);
  const values = estimates.flatMap((estimate) => estimate.bias).filter((v) => v !== null).map((v) => Math.abs(v) * DEG);
  const sigmas = estimates.flatMap((estimate) => estimate.sigma).filter((v) => v !== null).map((v) => v * DEG);
  const maxValue = Math.max(0.02, ...values), maxSigma = Math.max(0, ...sigmas);
  return 1.15 * (maxValue + Math.min(maxSigma, 2 * maxValue));
}

export function biasText(estimate) {
  if (!estimate) { return "not known"; }
  return estimate.bias.map((v, k) => {
    const sigma = estimate.sigma[k];
    return (v * DEG).toFixed(3) + (sigma === null ? "" : ` ± ${(sigma * DEG).toFixed(3)}`);
  }).join(", ");
}
