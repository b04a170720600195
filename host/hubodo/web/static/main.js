// The page: what comes from the feed into its places, and what a visitor wants to the server.

import { colour, forgetColours, ofNode } from "./canvas.js";
import { Feed } from "./feed.js";
import { compass, PathMap } from "./map.js";
import { element, NodeCards, say, signed } from "./nodes.js";
import { Recordings } from "./recordings.js";
import { logOut, renew, send, toast } from "./server.js";
import { strip } from "./strip.js";
import { theme } from "./theme.js";

const DEG = 180 / Math.PI, GB = 1e9, MB = 1e6, MOST_EVENTS = 200;
const at = (id) => document.getElementById(id);
const live = document.documentElement.dataset.live === "yes";
const map = new PathMap(at("map"));
const cards = new NodeCards(at("nodes"), send);
const recordings = new Recordings(at("view-recordings"));
let drawing = false, lastSlow = null, connected = false;

const feed = new Feed(soon, (open) => {
  if (open && !connected) { at("events").replaceChildren(); cards.clear(); lastSlow = null; }
  connected = open;
  if (open) { renew(feed.csrf); }
  at("lost").hidden = open;
  state();
});

function soon() {
  if (drawing) { return; }
  drawing = true;
  requestAnimationFrame(() => { drawing = false; draw(); });
}

function draw() {
  events();
  if (at("view-live").hidden) { return; }
  if (feed.slow && feed.slow !== lastSlow) { slow(); }
  speeds();
  headings();
  place();
}

function slow() {
  lastSlow = feed.slow;
  const log = feed.slow.log;
  at("file").hidden = false;
  say(at("file-name"), log.file);
  say(at("file-time"), clock(feed.slow.seconds));
  say(at("file-size"), log.size < 1e8 ? `${(log.size / MB).toFixed(1)} MB` : `${(log.size / GB).toFixed(2)} GB`);
  say(at("disk-left"), log.free === null ? "unknown" : `${(log.free / GB).toFixed(log.free < 1e10 ? 2 : 0)} GB`);
  if (log.free !== null) {
    at("disk-used").style.width = `${(100 * (1 - log.free / log.disk)).toFixed(1)}%`;
    at("disk-used").className = log.free < 0.05 * log.disk ? "low" : "";
  }
  state();
  cards.update(feed.slow, feed.past, feed.now, feed.sides);
}

function state() {
  const log = feed.slow?.log;
  const [name, words] = !connected ? ["lost", "no connection"]
    : !log ? ["waiting", "waiting for the recorder"]
    : log.recording ? ["recording", "recording"] : ["stopped", log.trouble ?? "not recording"];
  at("state").dataset.state = name;
  say(at("state"), words);
  at("record").hidden = !log;
  at("record").className = log?.recording ? "stop" : "";
  say(at("record"), log?.recording ? "Stop recording" : "Start recording");
}

function speeds() {
  const names = [...new Set(feed.frames.flatMap((frame) => Object.keys(frame.n)))].sort();
  const wheels = names.filter((name) => feed.frames.some((frame) => (frame.n[name]?.[1] ?? null) !== null));
  const shown = wheels.length ? wheels : names, which = wheels.length ? 1 : 0;
  const series = shown.map((name) => ({
    name, tone: ofNode(name, feed.sides[name]),
    points: feed.frames.filter((frame) => frame.n[name]).map((frame) => [frame.t, frame.n[name][which]]),
  }));
  if (wheels.length) {
    series.push({ name: "vehicle", tone: "fused", points: feed.frames.filter((f) => f.o).map((f) => [f.t, f.o[3]]) });
  }
  say(at("speed-title"), wheels.length ? "Wheel speeds, m/s" : "Turning about z, rad/s");
  legend(at("speed-legend"), series.map(({ name, tone, points }) => [name, tone, points.at(-1)?.[1]?.toFixed(2) ?? "–"]));
  strip(at("speeds"), series.map((one) => ({ ...one, colour: colour(one.tone) })), feed.now, { least: 0.5, zero: true });
}

function headings() {
  const points = feed.frames.filter((f) => f.o).map((f) => [f.t, f.o[2] * DEG, f.o[6] === null ? null : f.o[6] * DEG]);
  const series = [{ points, colour: colour("fused"), band: true }];
  const onMap = feed.frames.filter((f) => f.m).map((f) => [f.t, f.m[2] * DEG]);
  const keys = [["odometry ± 1 sigma", "fused"]];
  if (onMap.length) {
    series.push({ points: onMap, colour: colour("warn") });
    keys.push(["on the map", "warn"]);
  }
  say(at("heading-title"), "Heading, °");
  legend(at("heading-legend"), points.length ? keys : [["needs --vehicle", "dim"]]);
  strip(at("headings"), series, feed.now, { least: 10, steps: [2, 5, 10, 15, 30, 45, 90, 180, 360, 720] });
}

function place() {
  const odometry = feed.last("o"), onMap = feed.last("m"), north = Boolean(onMap || (feed.origin && !odometry));
  const pose = onMap ? { x: onMap[0], y: onMap[1], heading: onMap[2], sigma: onMap[3] }
    : odometry ? { x: odometry[0], y: odometry[1], heading: odometry[2], sigma: odometry[5] } : null;
  map.draw({ trail: onMap ? feed.trails.m : feed.trails.o, fixes: north ? feed.trails.g : [], pose, north });
  say(at("map-note"), north && feed.origin
    ? `m east and north of ${feed.origin[0].toFixed(6)}°, ${feed.origin[1].toFixed(6)}°`
    : pose ? `m from the start${fixes()}` : `odometry needs --vehicle${fixes()}`);
  at("map").setAttribute("aria-label", pose
    ? `The path of the vehicle; it is at x ${pose.x.toFixed(1)}, y ${pose.y.toFixed(1)} m` : "No path yet");
  compass(at("compass"), pose ? pose.heading : null, north);
  if (!pose || !odometry) { return; }
  say(at("now-speed"), odometry[3].toFixed(2).replace("-", "−"));
  say(at("now-distance"), odometry[7].toFixed(odometry[7] < 1000 ? 1 : 0));
  const turned = Math.atan2(Math.sin(pose.heading), Math.cos(pose.heading)) * DEG;
  say(at("now-heading"), signed(turned));
  say(at("now-heading-sigma"), odometry[6] === null ? "" : `± ${(odometry[6] * DEG).toFixed(1)}°`);
  say(at("now-yaw"), signed(odometry[4] * DEG));
  say(at("now-place"), `${pose.x.toFixed(2)}, ${pose.y.toFixed(2)} m`.replaceAll("-", "−"));
  say(at("now-place-sigma"), pose.sigma === null ? "" : `± ${pose.sigma.toFixed(2)} m`);
}

// What a receiver has told that is not on the map yet.
function fixes() {
  const counts = Object.values(feed.slow?.gnss ?? {});
  return counts.length ? `; GNSS: ${counts[0]} fixes, heading not yet known` : "";
}

function legend(list, entries) {
  const text = JSON.stringify(entries);
  if (list.dataset.text === text) { return; }
  list.dataset.text = text;
  list.replaceChildren(...entries.map(([name, tone, value]) => {
    const mark = element("i");
    mark.style.background = `var(--${tone})`;
    return element("li", {}, mark, value === undefined ? name : `${name} ${value.replace("-", "−")}`);
  }));
}

function events() {
  const list = at("events");
  for (const event of feed.takeEvents()) {
    const time = new Date(event.at * 1000).toLocaleTimeString([], { hour12: false });
    const line = element("li", { "data-kind": event.kind },
      element("span", { class: "dim" }, time), element("span", { class: "kind" }, event.kind),
      element("span", { class: "what" }, event.text));
    list.prepend(line);
    while (list.children.length > MOST_EVENTS) { list.lastElementChild.remove(); }
  }
}

function clock(seconds) {
  const whole = Math.floor(seconds), two = (n) => String(n).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

function show(view) {
  for (const tab of document.querySelectorAll(".tab")) {
    const here = tab.dataset.view === view;
    if (here) { tab.setAttribute("aria-current", "page"); } else { tab.removeAttribute("aria-current"); }
    at(`view-${tab.dataset.view}`).hidden = !here;
  }
  if (view === "recordings") { recordings.load(); }
  soon();
}

function follow(on) {
  map.follow = on;
  at("map-fit").setAttribute("aria-pressed", String(!on));
  at("map-follow").setAttribute("aria-pressed", String(on));
  soon();
}

for (const tab of document.querySelectorAll(".tab")) { tab.addEventListener("click", () => show(tab.dataset.view)); }
at("map-fit").addEventListener("click", () => follow(false));
at("map-follow").addEventListener("click", () => follow(true));
at("record").addEventListener("click", () => send("record", { on: !feed.slow.log.recording }));
at("mark").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (await send("mark", { text: at("mark-text").value })) {
    toast("Marked");
    at("mark-text").value = "";
  }
});
document.addEventListener("keydown", (event) => {
  const writing = event.target.closest("input, select, textarea");
  if (event.key.toLowerCase() === "m" && !writing && !event.ctrlKey && !event.metaKey && !event.altKey && live) {
    event.preventDefault();
    show("live");
    at("mark-text").focus();
  }
});
at("logout").hidden = document.documentElement.dataset.token !== "yes";
at("logout").addEventListener("click", logOut);
theme(at("theme"), () => { forgetColours(); if (feed.slow) { lastSlow = null; } soon(); });
new ResizeObserver(() => { lastSlow = null; soon(); }).observe(at("main"));
if (live) {
  feed.start();
} else {
  at("state").hidden = true;
  document.querySelector(".tabs").hidden = true;
  show("recordings");
}
