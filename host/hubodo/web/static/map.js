// The path on a grid of metres, or east and north of an origin; where the vehicle is and how sure that is.

import { begin, colour, font, label, roundStep } from "./canvas.js";

const LEAST = 4; // m across at least
const NEAR = 12; // m around the vehicle when following

export class PathMap {
  constructor(canvas) {
    this.canvas = canvas;
    this.follow = false;
    this.view = null;
  }

  // trail, fixes: [[x, y]]; pose: {x, y, heading, sigma} or null; north: whether x is east.
  draw({ trail, fixes, pose, north }) {
    const { pen, width, height } = begin(this.canvas);
    const target = this.window(trail, fixes, pose, width, height);
    // The view glides: a jump would lose the eye.
    const view = this.view && !reduced() ? blend(this.view, target, 0.25) : target;
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

  window(trail, fixes, pose, width, height) {
    let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
    if (this.follow && pose) {
      [x0, x1, y0, y1] = [pose.x - NEAR / 2, pose.x + NEAR / 2, pose.y - NEAR / 2, pose.y + NEAR / 2];
    } else {
      const places = pose ? [...trail, ...fixes, [pose.x, pose.y]] : [...trail, ...fixes];
      for (const [x, y] of places) {
        x0 = Math.min(x0, x); x1 = Math.max(x1, x);
        y0 = Math.min(y0, y); y1 = Math.max(y1, y);
      }
      if (!places.length) { [x0, x1, y0, y1] = [-LEAST, LEAST, -LEAST, LEAST]; }
    }
    const across = Math.max(x1 - x0, LEAST), along = Math.max(y1 - y0, LEAST);
    const scale = Math.min((width - 70) / across, (height - 70) / along);
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
        pen.fillText(label(v, step), x(v), height - 6);
      }
    }
    for (let v = Math.ceil(bottom / step) * step; y(v) > 0; v += step) {
      stroke(pen, 0, y(v), width, y(v));
      pen.textAlign = "left";
      if (y(v) > 12 && y(v) < height - 24) { pen.fillText(label(v, step), 4, y(v) - 4); }
    }
  }
}

function reduced() { return window.matchMedia("(prefers-reduced-motion: reduce)").matches; }

function blend(from, to, share) {
  const near = Math.abs(from.x - to.x) * to.scale < 0.5 && Math.abs(from.scale / to.scale - 1) < 0.005;
  const far = Math.abs(Math.log(from.scale / to.scale)) > 3;
  if (far || (near && Math.abs(from.y - to.y) * to.scale < 0.5)) { return to; }
  const mix = (a, b) => a + (b - a) * share;
  return { x: mix(from.x, to.x), y: mix(from.y, to.y), scale: from.scale * (to.scale / from.scale) ** share };
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
  const metres = barMetres(scale), long = metres * scale, x = barStart(scale, width), y = height - 12;
  pen.strokeStyle = pen.fillStyle = colour("ink");
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(x, y - 5);
  pen.lineTo(x, y);
  pen.lineTo(x + long, y);
  pen.lineTo(x + long, y - 5);
  pen.stroke();
  pen.font = font(12, 600);
  pen.textAlign = "center";
  pen.fillText(metres >= 1000 ? `${metres / 1000} km` : `${label(metres, metres)} m`, x + long / 2, y - 8);
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

// A dial with the heading as a needle; rad anticlockwise from east.
export function compass(canvas, heading, north) {
  const { pen, width, height } = begin(canvas);
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
  if (north) {
    pen.font = font(11, 700);
    pen.fillStyle = colour("dim");
    pen.textAlign = "center";
    pen.fillText("N", x, y - r * 0.58);
  }
  if (heading === null) { return; }
  pen.save();
  pen.translate(x, y);
  pen.rotate(-heading);
  pen.fillStyle = colour("right");
  wedge(pen, r * 0.74);
  pen.fillStyle = colour("dim");
  wedge(pen, -r * 0.5);
  pen.restore();
}

function wedge(pen, long) {
  pen.beginPath();
  pen.moveTo(long, 0);
  pen.lineTo(0, 5);
  pen.lineTo(0, -5);
  pen.fill();
}
