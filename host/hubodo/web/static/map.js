// The map: path, GNSS fixes, and the vehicle with its 1σ circle, on a grid in metres.

import { beginDrawing, colour, font, formatTick, roundStep } from "./canvas.js";

const MIN_SPAN = 4; // m
const FOLLOW_SPAN = 12; // m around the vehicle

export class PathMap {
  constructor(canvas) {
    this.canvas = canvas;
    this.follow = false;
    this.view = null;
  }

  // trail, fixes: [[x, y]]; pose: {x, y, heading, sigma} or null; north: true if x is east.
  draw({ trail, fixes, pose, north }) {
    const { pen, width, height } = beginDrawing(this.canvas);
    const target = this.fitWindow(trail, fixes, pose, width, height);
    // The view moves smoothly, so that the eye can follow.
    const view = this.view && !prefersReducedMotion() ? blend(this.view, target, 0.25) : target;
    this.view = view;
    const x = (v) => width / 2 + (v - view.x) * view.scale;
    const y = (v) => height / 2 - (v - view.y) * view.scale;
    this.grid(pen, view, x, y, width, height);
    pen.fillStyle = colour("warn");
    for (const [east, up] of fixes) {
      pen.globalAlpha = 0.55;
      pen.beginPath();
      pen.arc(x(east), y(up), 2.5, 0, 7);
      pen.fill();
    }
    pen.globalAlpha = 1;
    if (trail.length) {
      pen.strokeStyle = colour("fused");
      pen.lineWidth = 2.5;
      pen.beginPath();
      for (const [a, b] of trail) { pen.lineTo(x(a), y(b)); }
      if (pose) { pen.lineTo(x(pose.x), y(pose.y)); }
      pen.stroke();
      dot(pen, x(trail[0][0]), y(trail[0][1]));
    }
    if (pose) { vehicle(pen, x(pose.x), y(pose.y), pose, view.scale); }
    scaleBar(pen, view.scale, width, height);
    if (north) { northArrow(pen, width); }
  }

  fitWindow(trail, fixes, pose, width, height) {
    let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
    if (this.follow && pose) {
      [x0, x1, y0, y1] = [pose.x - FOLLOW_SPAN / 2, pose.x + FOLLOW_SPAN / 2, pose.y - FOLLOW_SPAN / 2, pose.y + FOLLOW_SPAN / 2];
    } else {
      const points = pose ? [...trail, ...fixes, [pose.x, pose.y]] : [...trail, ...fixes];
      const include = ([x, y]) => {
        x0 = Math.min(x0, x); x1 = Math.max(x1, x);
        y0 = Math.min(y0, y); y1 = Math.max(y1, y);
      };
      points.forEach(include);
      // A circle wider than the path would leave the path too small to see.
      if (pose?.sigma && pose.sigma < Math.max(x1 - x0, y1 - y0)) {
        include([pose.x - pose.sigma, pose.y - pose.sigma]);
        include([pose.x + pose.sigma, pose.y + pose.sigma]);
      }
      if (!points.length) { [x0, x1, y0, y1] = [-MIN_SPAN, MIN_SPAN, -MIN_SPAN, MIN_SPAN]; }
    }
    const spanX = Math.max(x1 - x0, MIN_SPAN), spanY = Math.max(y1 - y0, MIN_SPAN);
    const scale = Math.min((width - 70) / spanX, (height - 70) / spanY);
    return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale: Math.max(scale, 1e-6) };
  }

  grid(pen, view, x, y, width, height) {
    const step = roundStep(width / view.scale, Math.max(width / 90, 3));
    const left = view.x - width / 2 / view.scale, bottom = view.y - height / 2 / view.scale;
    pen.font = font(11);
    pen.lineWidth = 1;
    pen.fillStyle = colour("dim");
    pen.strokeStyle = colour("grid");
    for (let v = Math.ceil(left / step) * step; x(v) < width; v += step) {
      stroke(pen, x(v), 0, x(v), height);
      if (x(v) > 40 && x(v) < barStart(view.scale, width) - 24) {
        pen.textAlign = "center";
        pen.fillText(formatTick(v, step), x(v), height - 6);
      }
    }
    for (let v = Math.ceil(bottom / step) * step; y(v) > 0; v += step) {
      stroke(pen, 0, y(v), width, y(v));
      pen.textAlign = "left";
      if (y(v) > 12 && y(v) < height - 24) { pen.fillText(formatTick(v, step), 4, y(v) - 4); }
    }
  }
}

function prefersReducedMotion() { return window.matchMedia("(prefers-reduced-motion: reduce)").matches; }

function blend(from, to, fraction) {
  const isClose = Math.abs(from.x - to.x) * to.scale < 0.5 && Math.abs(from.scale / to.scale - 1) < 0.005;
  const isFar = Math.abs(Math.log(from.scale / to.scale)) > 3;
  if (isFar || (isClose && Math.abs(from.y - to.y) * to.scale < 0.5)) { return to; }
  const mix = (a, b) => a + (b - a) * fraction;
  return { x: mix(from.x, to.x), y: mix(from.y, to.y), scale: from.scale * (to.scale / from.scale) ** fraction };
}

function stroke(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(Math.round(x0) + 0.5, Math.round(y0) + 0.5);
  pen.lineTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
  pen.stroke();
}

function dot(pen, x, y) {
  pen.fillStyle = colour("card");
  pen.strokeStyle = colour("fused");
  pen.lineWidth = 2;
  pen.beginPath();
  pen.arc(x, y, 4.5, 0, 7);
  pen.fill();
  pen.stroke();
}

function vehicle(pen, x, y, { heading, sigma }, scale) {
  if (sigma) {
    pen.fillStyle = colour("fused");
    pen.globalAlpha = 0.15;
    pen.beginPath();
    pen.arc(x, y, Math.max(sigma * scale, 1), 0, 7);
    pen.fill();
    pen.globalAlpha = 1;
  }
  pen.save();
  pen.translate(x, y);
  pen.rotate(-heading);
  pen.fillStyle = colour("ink");
  pen.strokeStyle = colour("card");
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(13, 0);
  pen.lineTo(-8, 8);
  pen.lineTo(-4, 0);
  pen.lineTo(-8, -8);
  pen.closePath();
  pen.stroke();
  pen.fill();
  pen.restore();
}

const barMetres = (scale) => roundStep(90 / scale, 1.6);
const barStart = (scale, width) => width - 14 - barMetres(scale) * scale;

function scaleBar(pen, scale, width, height) {
  const metres = barMetres(scale), length = metres * scale, x = barStart(scale, width), y = height - 12;
  pen.strokeStyle = pen.fillStyle = colour("ink");
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(x, y - 5);
  pen.lineTo(x, y);
  pen.lineTo(x + length, y);
  pen.lineTo(x + length, y - 5);
  pen.stroke();
  pen.font = font(12, 600);
  pen.textAlign = "center";
  pen.fillText(metres >= 1000 ? `${metres / 1000} km` : `${formatTick(metres, metres)} m`, x + length / 2, y - 8);
}

function northArrow(pen, width) {
  const x = width - 22, y = 34;
  pen.fillStyle = colour("ink");
  pen.beginPath();
  pen.moveTo(x, y - 16);
  pen.lineTo(x + 7, y + 4);
  pen.lineTo(x, y - 1);
  pen.lineTo(x - 7, y + 4);
  pen.fill();
  pen.font = font(12, 700);
  pen.textAlign = "center";
  pen.fillText("N", x, y + 18);
}

// Draws a compass; heading: rad anticlockwise from east, or null.
export function drawCompass(canvas, heading, north) {
  const { pen, width, height } = beginDrawing(canvas);
  const x = width / 2, y = height / 2, r = Math.min(width, height) / 2 - 4;
  pen.strokeStyle = colour("line");
  pen.lineWidth = 2;
  pen.beginPath();
  pen.arc(x, y, r, 0, 7);
  pen.stroke();
  pen.strokeStyle = colour("dim");
  pen.lineWidth = 1.5;
  for (let k = 0; k < 12; k++) {
    const a = (k * Math.PI) / 6, inner = k % 3 ? 0.9 : 0.82;
    pen.beginPath();
    pen.moveTo(x + r * inner * Math.cos(a), y + r * inner * Math.sin(a));
    pen.lineTo(x + r * 0.97 * Math.cos(a), y + r * 0.97 * Math.sin(a));
    pen.stroke();
  }
  // The needle ends before the labels, which are drawn over it where the compass is small.
  if (heading !== null) {
    pen.save();
    pen.translate(x, y);
    pen.rotate(-heading);
    pen.fillStyle = colour("right");
    wedge(pen, r * 0.5);
    pen.fillStyle = colour("dim");
    wedge(pen, -r * 0.34);
    pen.restore();
  }
  pen.font = font(north ? 11 : 9, north ? 700 : 400);
  pen.fillStyle = colour("dim");
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  // Headings are anticlockwise from east on the map, else from the direction at the start.
  (north ? ["E", "N", "W", "S"] : ["0°", "90°", "180°", "−90°"]).forEach((label, k) => {
    const a = (k * Math.PI) / 2;
    pen.fillText(label, x + r * 0.62 * Math.cos(a), y - r * 0.62 * Math.sin(a));
  });
  pen.textBaseline = "alphabetic";
}

function wedge(pen, length) {
  pen.beginPath();
  pen.moveTo(length, 0);
  pen.lineTo(0, 5);
  pen.lineTo(0, -5);
  pen.fill();
}
