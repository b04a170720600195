// A card for each node: link, rate, losses, clock, supply, temperature, bias; and what it can be asked.

import { colour, ofNode } from "./canvas.js";
import { biasWords, drawBias } from "./bias.js";
import { spark } from "./strip.js";

const CELLS = [
  ["rate", "Rate", 1], ["lost", "Lost", 0.001], ["clock", "Clock offset", 0.0002],
  ["ppm", "Clock drift", 2], ["battery", "Battery", 0.05], ["temperature", "Temperature", 0.5],
];

export class NodeCards {
  // ask(action, body): sends a wish.
  constructor(place, ask) {
    this.place = place;
    this.ask = ask;
    this.cards = new Map();
  }

  clear() {
    this.place.replaceChildren();
    this.cards.clear();
  }

  // slow: what came last; past: [{t, nodes}] of the last minute; sides: name -> side.
  update(slow, past, now, sides) {
    for (const name of Object.keys(slow.nodes).sort()) {
      if (!this.cards.has(name)) { this.cards.set(name, this.card(name, sides[name])); }
      this.fill(this.cards.get(name), slow.nodes[name], slow.links[slow.nodes[name].link]);
      this.drawn(this.cards.get(name), name, slow.nodes[name], past, now);
    }
  }

  card(name, side) {
    const tone = ofNode(name, side);
    const card = element("article", { class: "card node", "aria-label": `Node ${name}` });
    card.style.setProperty("--own", `var(--${tone})`);
    const state = element("span", { class: "chip", role: "status" });
    const where = element("span", { class: "dim where" });
    const head = element("div", { class: "head" }, element("h3", {}, name), state, where);
    const cells = element("dl", { class: "cells" });
    const parts = {};
    for (const [key, title] of CELLS) {
      const value = element("dd"), chart = element("canvas", { "aria-hidden": "true" });
      cells.append(element("div", {}, element("dt", {}, title), value, chart));
      parts[key] = { value, chart };
    }
    const button = element("button", { type: "button", class: "quiet" }, "Initialise bias at standstill");
    button.title = "Keep the wheel still for about ten seconds";
    button.addEventListener("click", () => this.ask("bias", { node: name }));
    const chart = element("canvas", { role: "img" });
    const legend = element("ul", { class: "legend" });
    legend.append(key("node", tone), key("host", "fused"));
    const bias = element("div", { class: "bias" },
      element("div", { class: "head" }, element("h2", {}, "Gyro bias, °/s"), legend, button), chart);
    card.append(head, cells, bias);
    this.place.append(card);
    return { card, state, where, parts, chart, button, tone };
  }

  fill({ state, where, parts, chart, button }, node, link) {
    const [tone, words] = health(node, link);
    state.dataset.state = tone;
    say(state, words);
    say(where, link ? link.where || "not connected" : "");
    const whole = node.samples + node.lost;
    value(parts.rate, node.rate.toFixed(1), "Hz");
    value(parts.lost, whole ? ((100 * node.lost) / whole).toFixed(2) : "–", `% (${node.lost})`);
    const clock = node.clock;
    value(parts.clock, clock.sigma === null ? "–" : `± ${(clock.sigma * 1e3).toFixed(2)}`, clock.sigma === null ? "" : "ms");
    parts.clock.value.title = clock.offset === null ? "" : `host minus node: ${clock.offset.toFixed(6)} s, ${clock.source}`;
    value(parts.ppm, clock.ppm === null ? "–" : signed(clock.ppm), clock.ppm === null ? "" : `± ${clock.ppm_sigma.toFixed(1)} ppm`);
    value(parts.battery, node.battery === null ? "–" : node.battery.toFixed(2), node.battery === null ? "" : "V");
    value(parts.temperature, node.temperature === null ? "–" : node.temperature.toFixed(1), node.temperature === null ? "" : "°C");
    const own = node.bias && node.bias.state === "tracking" ? node.bias : null;
    chart.setAttribute("aria-label", `Node: ${biasWords(own)}; host: ${biasWords(node.host_bias)}; degrees per second about x, y, z`);
    const busy = node.bias !== null && node.bias.state === "initialising";
    button.disabled = busy || !link?.up;
    say(button, busy ? "Initialising…" : "Initialise bias at standstill");
  }

  drawn({ parts, chart, tone }, name, node, past, now) {
    const own = past.map(({ t, nodes }) => [t, nodes[name]]).filter(([, told]) => told);
    const first = own.find(([, told]) => told.clock.offset !== null)?.[1].clock.offset ?? 0;
    const of = {
      rate: (told) => told.rate,
      lost: (told) => told.lost,
      clock: (told) => (told.clock.offset === null ? null : told.clock.offset - first),
      ppm: (told) => told.clock.ppm,
      battery: (told) => told.battery,
      temperature: (told) => told.temperature,
    };
    for (const [cell, , least] of CELLS) {
      spark(parts[cell].chart, own.map(([t, told]) => [t, of[cell](told)]), now, colour(tone), least);
    }
    drawBias(chart, node.bias && node.bias.state === "tracking" ? node.bias : null, node.host_bias, colour(tone));
  }
}

function health(node, link) {
  if (node.refused) { return ["bad", "version mismatch"]; }
  if (!link?.up) { return ["bad", "link down"]; }
  if (node.silent > 3) { return ["bad", `silent for ${node.silent.toFixed(0)} s`]; }
  if (node.faults.length) { return ["warn", node.faults.join(", ").replaceAll("_", " ")]; }
  return ["good", "streaming"];
}

function value({ value: place }, text, unit) {
  if (place.dataset.text === text + unit) { return; }
  place.dataset.text = text + unit;
  place.replaceChildren(text, " ", element("small", {}, unit));
}

function key(text, tone) {
  const mark = element("i");
  mark.style.background = `var(--${tone})`;
  return element("li", {}, mark, text);
}

export function signed(number, digits = 1) {
  return (number < 0 ? "−" : "+") + Math.abs(number).toFixed(digits);
}

export function say(place, text) {
  if (place.textContent !== text) { place.textContent = text; }
}

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, text] of Object.entries(attributes)) { made.setAttribute(name, text); }
  made.append(...children);
  return made;
}
