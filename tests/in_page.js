// Functions that the browser tests call inside the page.

// Returns texts with a contrast to their background below 4.5, or 3 if large (WCAG 2.2, AA).
function lowContrastTexts() {
  const texts = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const text = walker.currentNode.textContent.trim(), element = walker.currentNode.parentElement;
    const hidden = !element.checkVisibility() || element.closest("script, .hidden, .skip, option, :disabled");
    if (!text || hidden) { continue; }
    const style = getComputedStyle(element), size = parseFloat(style.fontSize);
    const [a, b] = [luminance(parseColour(style.color)), luminance(backgroundOf(element))].sort((x, y) => y - x);
    const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    if ((a + 0.05) / (b + 0.05) < (large ? 3 : 4.5)) { texts.push([text.slice(0, 30), (a + 0.05) / (b + 0.05)]); }
  }
  return texts;
}

function parseColour(text) {
  const numbers = text.match(/[\d.]+/g).map(Number);
  return { rgb: numbers.slice(0, 3), alpha: numbers[3] ?? 1 };
}

function luminance({ rgb }) {
  const linear = rgb.map((v) => (v / 255 <= 0.03928 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
}

function backgroundOf(element) {
  for (let at = element; at; at = at.parentElement) {
    const background = parseColour(getComputedStyle(at).backgroundColor);
    if (background.alpha > 0.99) { return background; }
  }
  return { rgb: [255, 255, 255] };
}

// Returns the number of opaque colours on a canvas.
function countColours(name) {
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

// Returns the number of elements that can be reached with the keyboard.
function countFocusable() {
  const all = [...document.querySelectorAll("button, input, select, a, #events")];
  return all.filter((element) => element.checkVisibility() && !element.disabled).length;
}

// Returns true if the focused element has a visible outline.
function hasVisibleFocus() {
  const at = document.activeElement;
  return at === document.body || parseFloat(getComputedStyle(at).outlineWidth) >= 2;
}
