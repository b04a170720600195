// A card for each node: link, rate, losses, clock, battery, temperature, bias, and a button for bias initialisation.

import { colour, colourNameOfNode } from "./canvas.js";
import { biasText, drawBias } from "./bias.js";
import { drawSparkline } from "./strip.js";

const CELLS = [
  ["rate", "Rate", 1], ["lost", "Lost", 0.001], ["clock", "Clock offset", 0.0002],
  ["ppm", "Clock drift", 2], ["battery", "Battery", 0.05], ["temperature", "Temperature", 0.5],
];

export class NodeCards {
  // request(action, body): sends a request to the server.
  constructor(container, request) {
    this.container = container;
    this.request = request;
    this.cards = new Map();
  }

  clear() {
    this.container.replaceChildren();
    this.cards.clear();
  }

  // status: the newest one; history: [{t, nodes}] of the last minute; sides: name -> side.
  update(status, history, now, sides) {
    for (const name of Object.keys(status.nodes).sort()) {
      if (!this.cards.has(name)) { this.cards.set(name, this.card(name, sides[name])); }
      this.fill(this.cards.get(name), status.nodes[name], status.links[status.nodes[name].link]);
      this.drawCharts(this.cards.get(name), name, status.nodes[name], history, now);
    }
  }

  card(name, side) {
    const tone = colourNameOfNode(name, side);
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
    button.addEventListener("click", () => this.request("bias", { node: name }));
    const chart = element("canvas", { role: "img" });
    const legend = element("ul", { class: "legend" });
    legend.append(legendEntry("node", tone), legendEntry("host", "fused"));
    const bias = element("div", { class: "bias" },
      element("div", { class: "head" }, element("h2", {}, "Gyro bias, °/s"), legend, button), chart);
    card.append(head, cells, bias);
    this.container.append(card);
    return { card, state, where, parts, chart, button, tone };
  }

  fill({ state, where, parts, chart, button }, node, link) {
    const [level, text] = health(node, link);
    state.dataset.state = level;
    setText(state, text);
    setText(where, link ? link.where || "not connected" : "");
    const total = node.samples + node.lost;
    setValue(parts.rate, node.rate.toFixed(1), "Hz");
    setValue(parts.lost, total ? ((100 * node.lost) / total).toFixed(2) : "–", `% (${node.lost})`);
    const clock = node.clock;
    setValue(parts.clock, clock.offset === null ? "–" : `${clock.offset.toFixed(3).replace("-", "−")} s`,
      clock.sigma === null ? "" : `± ${(clock.sigma * 1e3).toFixed(2)} ms`);
    parts.clock.value.title = clock.offset === null ? "" : `host minus node: ${clock.offset.toFixed(6)} s, ${clock.source}`;
    setValue(parts.ppm, clock.ppm === null ? "–" : signed(clock.ppm), clock.ppm === null ? "" : `± ${clock.ppm_sigma.toFixed(1)} ppm`);
    setValue(parts.battery, node.battery === null ? "–" : node.battery.toFixed(2), node.battery === null ? "" : "V");
    setValue(parts.temperature, node.temperature === null ? "–" : node.temperature.toFixed(1), node.temperature === null ? "" : "°C");
    const nodeBias = node.bias && node.bias.state === "tracking" ? node.bias : null;
    chart.setAttribute("aria-label", `Node: ${biasText(nodeBias)}; host: ${biasText(node.host_bias)}; degrees per second about x, y, z`);
    const isBusy = node.bias !== null && node.bias.state === "initialising";
    button.disabled = isBusy || !link?.up;
    setText(button, isBusy ? "Initialising…" : "Initialise bias at standstill");
  }

  drawCharts({ parts, chart, tone }, name, node, history, now) {
    const statuses = history.map(({ t, nodes }) => [t, nodes[name]]).filter(([, status]) => status);
    const firstOffset = statuses.find(([, status]) => status.clock.offset !== null)?.[1].clock.offset ?? 0;
    const valueOf = {
      rate: (status) => status.rate,
      lost: (status) => status.lost,
      clock: (status) => (status.clock.offset === null ? null : status.clock.offset - firstOffset),
      ppm: (status) => status.clock.ppm,
      battery: (status) => status.battery,
      temperature: (status) => status.temperature,
    };
    for (const [cell, , minSpan] of CELLS) {
      drawSparkline(parts[cell].chart, statuses.map(([t, status]) => [t, valueOf[cell](status)]), now, colour(tone), minSpan);
    }
    drawBias(chart, node.bias && node.bias.state === "tracking" ? node.bias : null, node.host_bias, colour(tone));
  }
}

function health(node, link) {
  if (node.refused) { return ["bad", "version mismatch"]; }
  if (!link?.up) { return ["bad", "link down"]; }
  if (node.faults.includes("asleep") && node.silent < 20) { return ["good", "asleep until motion"]; }
  if (node.silent > 3) { return ["bad", `silent for ${node.silent.toFixed(0)} s`]; }
  if (node.faults.length) { return ["warn", node.faults.join(", ").replaceAll("_", " ")]; }
  return ["good", "streaming"];
}

function setValue({ value: cell }, text, unit) {
  if (cell.dataset.text === text + unit) { return; }
  cell.dataset.text = text + unit;
  cell.replaceChildren(text, " ", element("small", {}, unit));
}

function legendEntry(text, tone) {
  const mark = element("i");
  mark.style.background = `var(--${tone})`;
  return element("li", {}, mark, text);
}

export function signed(number, digits = 1) {
  const text = Math.abs(number).toFixed(digits);
  return Number(text) === 0 ? text : (number < 0 ? "−" : "+") + text;
}

// Returns a number without the sign of a rounded zero.
export function unsignedZero(number, digits) {
  const text = number.toFixed(digits);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

export function setText(target, text) {
  if (target.textContent !== text) { target.textContent = text; }
}

export function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, text] of Object.entries(attributes)) { node.setAttribute(name, text); }
  node.append(...children);
  return node;
}
