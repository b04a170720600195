// Shared by all drawings: canvas in screen pixels, colours of the page, round tick steps.

export function beginDrawing(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineJoin = pen.lineCap = "round";
  return { pen, width, height };
}

let palette = null;
export function resetColours() { palette = null; }

export function colour(name) {
  if (!palette) { palette = { style: getComputedStyle(document.documentElement), known: {} }; }
  return (palette.known[name] ??= palette.style.getPropertyValue(`--${name}`).trim());
}

export function colourNameOfNode(name, side) {
  return side ?? (name === "left" || name === "right" ? name : "other");
}

// Returns the step of 1, 2 or 5 times a power of ten that divides a span into at most `parts` parts.
export function roundStep(span, parts) {
  const raw = Math.max(span, 1e-12) / parts, power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].find((step) => step * power >= raw * 0.999) * power;
}

export function formatTick(value, step) {
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const text = value.toFixed(Math.min(digits, 6));
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}

export const font = (size, weight = 400) => `${weight} ${size}px system-ui, "DejaVu Sans", sans-serif`;
