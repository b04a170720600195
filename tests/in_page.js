// What the tests ask inside the page.

// The words whose contrast with what is behind them is below 4.5, or 3 for large ones (WCAG 2.2, AA).
function faintWords() {
  const found = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const text = walk.currentNode.textContent.trim(), element = walk.currentNode.parentElement;
    const hidden = !element.checkVisibility() || element.closest("script, .hidden, .skip, option, :disabled");
    if (!text || hidden) { continue; }
    const style = getComputedStyle(element), size = parseFloat(style.fontSize);
    const [a, b] = [lightness(parse(style.color)), lightness(behind(element))].sort((x, y) => y - x);
    const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    if ((a + 0.05) / (b + 0.05) < (large ? 3 : 4.5)) { found.push([text.slice(0, 30), (a + 0.05) / (b + 0.05)]); }
  }
  return found;
}

function parse(text) {
  const numbers = text.match(/[\d.]+/g).map(Number);
  return { rgb: numbers.slice(0, 3), alpha: numbers[3] ?? 1 };
}

function lightness({ rgb }) {
  const linear = rgb.map((v) => (v / 255 <= 0.03928 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
}

function behind(element) {
  for (let at = element; at; at = at.parentElement) {
    const paint = parse(getComputedStyle(at).backgroundColor);
    if (paint.alpha > 0.99) { return paint; }
  }
  return { rgb: [255, 255, 255] };
}

// How many colours are on a canvas.
function coloursOf(name) {
  const canvas = document.getElementById(name), copy = new OffscreenCanvas(canvas.width, canvas.height);
  const pen = copy.getContext("2d", { willReadFrequently: true });
  pen.drawImage(canvas, 0, 0);
  const data = pen.getImageData(0, 0, copy.width, copy.height).data;
  const colours = new Set();
  for (let k = 0; k < data.length; k += 4) {
    if (data[k + 3] > 200) { colours.add(data[k] * 65536 + data[k + 1] * 256 + data[k + 2]); }
  }
  return colours.size;
}

// How many things can be reached with the keyboard.
function reachable() {
  const all = [...document.querySelectorAll("button, input, select, a, #events")];
  return all.filter((element) => element.checkVisibility() && !element.disabled).length;
}

// Whether what has the focus shows it.
function focusShown() {
  const at = document.activeElement;
  return at === document.body || parseFloat(getComputedStyle(at).outlineWidth) >= 2;
}
