// The recordings of the folder: content, report and `gap` of each.

import { call, toast } from "./server.js";
import { element } from "./nodes.js";
import { thumbnail } from "./thumbnail.js";

const POLL_MS = 500;
const ORDERS = {
  newest: ["newest first", (a, b) => b.changed - a.changed],
  oldest: ["oldest first", (a, b) => a.changed - b.changed],
  name: ["by name", (a, b) => a.name.localeCompare(b.name, undefined, { numeric: true })],
  size: ["largest first", (a, b) => b.size - a.size],
};

export class Recordings {
  constructor(container) {
    this.container = container;
    this.cards = new Map();
  }

  async load() {
    let listing;
    try {
      listing = await call("/api/recordings");
    } catch (error) {
      toast(error.message);
      return;
    }
    this.models = listing.models;
    this.cards.clear();
    this.listing = listing;
    this.show();
  }

  // Shows the cards in the order that the visitor has chosen.
  show() {
    const listing = this.listing;
    const order = element("select", { "aria-label": "Order of the recordings" },
      ...Object.entries(ORDERS).map(([value, [text]]) => element("option", { value }, text)));
    order.value = this.order ?? "newest";
    order.addEventListener("change", () => { this.order = order.value; this.show(); });
    this.container.replaceChildren(element("div", { class: "head" },
      element("h2", {}, `Recordings in ${listing.folder}`), element("div", { class: "row" }, order)));
    if (!listing.recordings.length) { this.container.append(element("p", { class: "card" }, "No recording yet.")); }
    for (const recording of [...listing.recordings].sort(ORDERS[order.value][1])) { this.container.append(this.card(recording)); }
  }

  card(recording) {
    const path = recording.name.split("/").map(encodeURIComponent).join("/");
    const card = element("article", { class: "card recording", "aria-label": recording.name });
    const when = new Date(recording.changed * 1000).toLocaleString([], { hour12: false });
    const size = recording.size < 1e8 ? `${(recording.size / 1e6).toFixed(1)} MB` : `${(recording.size / 1e9).toFixed(2)} GB`;
    const buttons = element("div", { class: "row" });
    if (!recording.current) { card.append(thumbnail(recording, path)); }
    card.append(
      element("div", { class: "head" }, element("h2", {}, recording.name),
        element("span", { class: "dim" }, `${when}, ${size}`),
        ...(recording.current ? [element("span", { class: "chip" }, "being recorded")] : []), buttons));
    const model = element("select", { "aria-label": "Model file for gap" },
      ...this.models.map((name) => element("option", { value: name }, name)));
    const addButton = (text, onClick) => {
      const button = element("button", { type: "button", class: "quiet" }, text);
      button.addEventListener("click", onClick);
      buttons.append(button);
    };
    addButton("Info", () => this.run(card, { kind: "info", name: recording.name }, (result) => facts(card, result)));
    addButton("Report", () => this.run(card, { kind: "report", name: recording.name },
      () => link(card, "report", `/pages/report/${path}`, "Open the report")));
    if (this.models.length) {
      addButton("Gap", () => this.run(card, { kind: "gap", name: recording.name, model: model.value }, (result) => {
        link(card, "gap", `/pages/gap/${path}`, "Open the gap report");
        if (result?.verdict) { note(card, verdict(result)); }
      }));
      buttons.append(element("label", { class: "dim" }, "with ", model));
    }
    const file = element("a", { href: `/api/recordings/${path}`, download: "" }, "Download");
    buttons.append(file);
    if (recording.report) { link(card, "report", `/pages/report/${path}`, "Open the report"); }
    if (recording.gap) { link(card, "gap", `/pages/gap/${path}`, "Open the gap report"); }
    return card;
  }

  async run(card, request, onDone) {
    for (const button of card.querySelectorAll("button")) { button.disabled = true; }
    const status = element("p", { class: "dim", role: "status" }, "waiting");
    const bar = element("progress", { max: "1", value: "0", "aria-label": `${request.kind} of ${request.name}` });
    const cancel = element("button", { type: "button", class: "quiet", "data-cancel": "" }, "Cancel");
    const progressNote = element("div", { class: "note" }, status, bar, cancel);
    card.append(progressNote);
    try {
      let job = await call("/api/jobs", request);
      const limit = `at most ${job.limit < 120 ? `${Math.round(job.limit)} s` : `${Math.round(job.limit / 60)} min`}`;
      cancel.addEventListener("click", () => {
        cancel.disabled = true;
        call(`/api/jobs/${job.id}/cancel`, {}).catch((error) => toast(error.message));
      });
      while (job.state === "waiting" || job.state === "running") {
        status.textContent = job.state === "waiting" ? "waiting for earlier jobs" : `${job.text || "working"} (${limit})`;
        if (job.progress > 0) { bar.value = job.progress; } else { bar.removeAttribute("value"); }
        await new Promise((resolve) => setTimeout(resolve, POLL_MS));
        job = await call(`/api/jobs/${job.id}`);
      }
      if (job.state === "done") { onDone(job.result); } else { note(card, job.text, job.state === "failed"); }
    } catch (error) {
      note(card, error.message, true);
    }
    progressNote.remove();
    for (const button of card.querySelectorAll("button")) { button.disabled = false; }
  }
}

function link(card, kind, path, text) {
  card.querySelector(`[data-derived="${kind}"]`)?.remove();
  const anchor = element("a", { href: path, target: "_blank", rel: "noopener" }, text);
  card.append(element("p", { class: "note", "data-derived": kind }, anchor));
}

function note(card, text, isError = false) {
  card.querySelector(".outcome")?.remove();
  card.append(element("p", { class: isError ? "note outcome error" : "note outcome" }, text));
}

function verdict(result) {
  const findings = result.found.map((finding) => `${finding.effect.replaceAll("_", " ")} (${finding.scope})`).join(", ");
  return `${result.verdict.replaceAll("_", " ")}: gap ${result.gap.before.toFixed(2)} → ${result.gap.after.toFixed(2)}${findings ? `; ${findings}` : ""}`;
}

function facts(card, info) {
  card.querySelector(".facts")?.remove();
  const list = element("dl", { class: "facts" });
  const add = (name, text) => list.append(element("div", {}, element("dt", {}, name), element("dd", {}, text)));
  add("Duration", `${info.duration.toFixed(1)} s`);
  add("Messages", String(info.messages));
  for (const stream of info.streams.filter((stream) => stream.topic.endsWith("/imu"))) {
    add(stream.topic, `${stream.messages} at ${(stream.rate ?? 0).toFixed(1)} Hz`);
  }
  add("Gaps", String(info.gaps?.length ?? 0));
  add("File", info.complete === false ? "not closed" : "complete");
  card.append(list);
}
