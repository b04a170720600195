// The recordings of the folder: what each holds, its report, and what a model lacks to explain it.

import { call, toast } from "./server.js";
import { element } from "./nodes.js";

const LOOK = 500; // ms

export class Recordings {
  constructor(place) {
    this.place = place;
    this.cards = new Map();
  }

  async load() {
    let told;
    try {
      told = await call("/api/recordings");
    } catch (error) {
      toast(error.message);
      return;
    }
    this.models = told.models;
    this.cards.clear();
    this.place.replaceChildren(element("h2", {}, `Recordings in ${told.folder}`));
    if (!told.recordings.length) { this.place.append(element("p", { class: "card" }, "No recording yet.")); }
    for (const one of told.recordings) { this.place.append(this.card(one)); }
  }

  card(one) {
    const path = one.name.split("/").map(encodeURIComponent).join("/");
    const card = element("article", { class: "card recording", "aria-label": one.name });
    const when = new Date(one.changed * 1000).toLocaleString([], { hour12: false });
    const size = one.size < 1e8 ? `${(one.size / 1e6).toFixed(1)} MB` : `${(one.size / 1e9).toFixed(2)} GB`;
    const buttons = element("div", { class: "row" });
    card.append(
      element("div", { class: "head" }, element("h2", {}, one.name),
        element("span", { class: "dim" }, `${when}, ${size}`),
        ...(one.current ? [element("span", { class: "chip" }, "being recorded")] : []), buttons));
    const model = element("select", { "aria-label": "Model file for gap" },
      ...this.models.map((name) => element("option", { value: name }, name)));
    const button = (text, what) => {
      const made = element("button", { type: "button", class: "quiet" }, text);
      made.addEventListener("click", what);
      buttons.append(made);
    };
    button("Info", () => this.run(card, { kind: "info", name: one.name }, (result) => facts(card, result)));
    button("Report", () => this.run(card, { kind: "report", name: one.name },
      () => link(card, "report", `/pages/report/${path}`, "Open the report")));
    if (this.models.length) {
      buttons.append(model);
      button("Gap", () => this.run(card, { kind: "gap", name: one.name, model: model.value }, (result) => {
        link(card, "gap", `/pages/gap/${path}`, "Open what the model lacks");
        if (result?.verdict) { note(card, verdict(result)); }
      }));
    }
    const file = element("a", { href: `/api/recordings/${path}`, download: "" }, "Download");
    buttons.append(file);
    if (one.report) { link(card, "report", `/pages/report/${path}`, "Open the report"); }
    if (one.gap) { link(card, "gap", `/pages/gap/${path}`, "Open what the model lacks"); }
    return card;
  }

  async run(card, asked, done) {
    for (const button of card.querySelectorAll("button")) { button.disabled = true; }
    const words = element("p", { class: "dim", role: "status" }, "waiting");
    const bar = element("progress", { max: "1", value: "0", "aria-label": `${asked.kind} of ${asked.name}` });
    const cancel = element("button", { type: "button", class: "quiet", "data-cancel": "" }, "Cancel");
    const going = element("div", { class: "note" }, words, bar, cancel);
    card.append(going);
    try {
      let job = await call("/api/jobs", asked);
      const limit = `at most ${job.limit < 120 ? `${Math.round(job.limit)} s` : `${Math.round(job.limit / 60)} min`}`;
      cancel.addEventListener("click", () => {
        cancel.disabled = true;
        call(`/api/jobs/${job.id}/cancel`, {}).catch((error) => toast(error.message));
      });
      while (job.state === "waiting" || job.state === "running") {
        words.textContent = job.state === "waiting" ? "waiting for what was asked for before" : `${job.text || "working"} (${limit})`;
        if (job.progress > 0) { bar.value = job.progress; } else { bar.removeAttribute("value"); }
        await new Promise((resolve) => setTimeout(resolve, LOOK));
        job = await call(`/api/jobs/${job.id}`);
      }
      if (job.state === "done") { done(job.result); } else { note(card, job.text, job.state === "failed"); }
    } catch (error) {
      note(card, error.message, true);
    }
    going.remove();
    for (const button of card.querySelectorAll("button")) { button.disabled = false; }
  }
}

function link(card, kind, path, text) {
  card.querySelector(`[data-made="${kind}"]`)?.remove();
  const made = element("a", { href: path, target: "_blank", rel: "noopener" }, text);
  card.append(element("p", { class: "note", "data-made": kind }, made));
}

function note(card, text, wrong = false) {
  card.querySelector(".said")?.remove();
  card.append(element("p", { class: wrong ? "note said wrong" : "note said" }, text));
}

function verdict(result) {
  const found = result.found.map((one) => `${one.effect.replaceAll("_", " ")} (${one.scope})`).join(", ");
  return `${result.verdict.replaceAll("_", " ")}: gap ${result.gap.before.toFixed(2)} → ${result.gap.after.toFixed(2)}${found ? `; ${found}` : ""}`;
}

function facts(card, info) {
  card.querySelector(".facts")?.remove();
  const list = element("dl", { class: "facts" });
  const add = (name, text) => list.append(element("div", {}, element("dt", {}, name), element("dd", {}, text)));
  add("Duration", `${info.duration.toFixed(1)} s`);
  add("Messages", String(info.messages));
  for (const stream of info.streams.filter((one) => one.topic.endsWith("/imu"))) {
    add(stream.topic, `${stream.messages} at ${(stream.rate ?? 0).toFixed(1)} Hz`);
  }
  add("Gaps", String(info.gaps?.length ?? 0));
  add("File", info.complete === false ? "not closed" : "whole");
  card.append(list);
}
