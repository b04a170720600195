// The page: shows the data of the live feed, and sends requests of the visitor to the server.

import { colour, resetColours, colourNameOfNode } from "./canvas.js";
import { Feed } from "./feed.js";
import { drawCompass, PathMap } from "./map.js";
import { element, NodeCards, setText, signed, unsignedZero } from "./nodes.js";
import { Recordings } from "./recordings.js";
import { logOut, replaceCsrfSecret, send, toast } from "./server.js";
import { drawStrip } from "./strip.js";
import { theme } from "./theme.js";

const DEG = 180 / Math.PI, GB = 1e9, MB = 1e6, MAX_EVENTS = 200;
const SMOOTHING_S = 0.5;  // over which speed and yaw rate are averaged, so that the digits can be read
const byId = (id) => document.getElementById(id);
const isLive = document.documentElement.dataset.live === "yes";
const map = new PathMap(byId("map"));
const cards = new NodeCards(byId("nodes"), send);
const recordings = new Recordings(byId("view-recordings"));
let isDrawScheduled = false, shownStatus = null, connected = false;

const feed = new Feed(scheduleDraw, (open) => {
  if (open && !connected) { byId("events").replaceChildren(); cards.clear(); shownStatus = null; }
  connected = open;
  if (open) { replaceCsrfSecret(feed.csrf); }
  byId("lost").hidden = open;
  showState();
});

function scheduleDraw() {
  if (isDrawScheduled) { return; }
  isDrawScheduled = true;
  requestAnimationFrame(() => { isDrawScheduled = false; draw(); });
}

function draw() {
  showEvents();
  if (byId("view-live").hidden) { return; }
  if (feed.status && feed.status !== shownStatus) { showStatus(); }
  drawSpeeds();
  drawHeadings();
  showPosition();
}

function showStatus() {
  shownStatus = feed.status;
  const log = feed.status.log;
  byId("file").hidden = false;
  setText(byId("file-name"), log.file);
  setText(byId("file-time"), formatDuration(feed.status.seconds));
  setText(byId("file-size"), log.size < 1e8 ? `${(log.size / MB).toFixed(1)} MB` : `${(log.size / GB).toFixed(2)} GB`);
  setText(byId("disk-left"), log.free === null ? "unknown" : `${(log.free / GB).toFixed(log.free < 1e10 ? 2 : 0)} GB`);
  if (log.free !== null) {
    byId("disk-used").style.width = `${(100 * (1 - log.free / log.disk)).toFixed(1)}%`;
    byId("disk-used").className = log.free < 0.05 * log.disk ? "low" : "";
  }
  showState();
  cards.update(feed.status, feed.statusHistory, feed.now, feed.sides);
}

function showState() {
  const log = feed.status?.log;
  const [name, text] = !connected ? ["lost", "no connection"]
    : !log ? ["waiting", "waiting for the recorder"]
    : log.recording ? ["recording", "recording"] : ["stopped", log.trouble ?? "not recording"];
  byId("state").dataset.state = name;
  setText(byId("state"), text);
  byId("record").hidden = !log;
  byId("record").className = log?.recording ? "stop" : "";
  setText(byId("record"), log?.recording ? "Stop recording" : "Start recording");
}

function drawSpeeds() {
  const names = [...new Set(feed.frames.flatMap((frame) => Object.keys(frame.n)))].sort();
  const wheels = names.filter((name) => feed.frames.some((frame) => (frame.n[name]?.[1] ?? null) !== null));
  const shown = wheels.length ? wheels : names, column = wheels.length ? 1 : 0;
  const series = shown.map((name) => ({
    name, tone: colourNameOfNode(name, feed.sides[name]),
    points: feed.frames.filter((frame) => frame.n[name]).map((frame) => [frame.t, frame.n[name][column]]),
  }));
  if (wheels.length) {
    series.push({ name: "vehicle", tone: "fused", points: feed.frames.filter((f) => f.o).map((f) => [f.t, f.o[3]]) });
  }
  setText(byId("speed-title"), wheels.length ? "Wheel speeds, m/s" : "Turning about z, rad/s");
  legend(byId("speed-legend"), series.map(({ name, tone, points }) => [name, tone, points.at(-1)?.[1]?.toFixed(2) ?? "–"]));
  drawStrip(byId("speeds"), series.map((line) => ({ ...line, colour: colour(line.tone) })), feed.now, { minSpan: 0.5, zero: true });
}

function drawHeadings() {
  const points = feed.frames.filter((f) => f.o).map((f) => [f.t, f.o[2] * DEG, f.o[6] === null ? null : f.o[6] * DEG]);
  const series = [{ points, colour: colour("fused"), band: true }];
  const onMap = feed.frames.filter((f) => f.m).map((f) => [f.t, f.m[2] * DEG]);
  const keys = [["odometry ± 1 sigma", "fused"]];
  if (onMap.length) {
    series.push({ points: onMap, colour: colour("warn") });
    keys.push(["on the map", "warn"]);
  }
  setText(byId("heading-title"), "Heading, °");
  legend(byId("heading-legend"), points.length ? keys : [["needs --vehicle", "dim"]]);
  drawStrip(byId("headings"), series, feed.now, { minSpan: 10, steps: [2, 5, 10, 15, 30, 45, 90, 180, 360, 720] });
}

function showPosition() {
  const odometry = feed.newest("o"), onMap = feed.newest("m"), north = Boolean(onMap || (feed.origin && !odometry));
  const pose = onMap ? { x: onMap[0], y: onMap[1], heading: onMap[2], sigma: onMap[3] }
    : odometry ? { x: odometry[0], y: odometry[1], heading: odometry[2], sigma: odometry[5] } : null;
  map.draw({ trail: onMap ? feed.trails.m : feed.trails.o, fixes: north ? feed.trails.g : [], pose, north });
  setText(byId("map-note"), north && feed.origin
    ? `m east and north of ${feed.origin[0].toFixed(6)}°, ${feed.origin[1].toFixed(6)}°`
    : pose ? `m from the start${pendingFixes()}` : `odometry needs --vehicle${pendingFixes()}`);
  byId("map").setAttribute("aria-label", pose
    ? `The path of the vehicle; it is at x ${pose.x.toFixed(1)}, y ${pose.y.toFixed(1)} m` : "No path yet");
  drawCompass(byId("compass"), pose ? pose.heading : null, north);
  if (!pose || !odometry) { return; }
  const recent = feed.frames.filter((frame) => frame.o && feed.now - frame.t < SMOOTHING_S).map((frame) => frame.o);
  const mean = (column) => (recent.length ? recent.reduce((sum, o) => sum + o[column], 0) / recent.length : odometry[column]);
  setText(byId("now-speed"), unsignedZero(mean(3), 2));
  setText(byId("now-distance"), odometry[7].toFixed(odometry[7] < 1000 ? 1 : 0));
  const wrappedHeading = Math.atan2(Math.sin(pose.heading), Math.cos(pose.heading)) * DEG;
  setText(byId("now-heading"), signed(wrappedHeading));
  setText(byId("now-heading-sigma"), odometry[6] === null ? "" : `± ${(odometry[6] * DEG).toFixed(1)}°`);
  setText(byId("now-yaw"), signed(mean(4) * DEG));
  setText(byId("now-place"), `${pose.x.toFixed(2)}, ${pose.y.toFixed(2)} m`.replaceAll("-", "−"));
  setText(byId("now-place-sigma"), pose.sigma === null ? "" : `± ${pose.sigma.toFixed(2)} m`);
}

// Describes GNSS fixes that are not on the map yet.
function pendingFixes() {
  const counts = Object.values(feed.status?.gnss ?? {});
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

function showEvents() {
  const list = byId("events");
  for (const event of feed.takeNewEvents()) {
    const time = new Date(event.at * 1000).toLocaleTimeString([], { hour12: false });
    const line = element("li", { "data-kind": event.kind },
      element("span", { class: "dim" }, time), element("span", { class: "kind" }, event.kind),
      element("span", { class: "what" }, event.text));
    list.prepend(line);
    while (list.children.length > MAX_EVENTS) { list.lastElementChild.remove(); }
  }
}

function formatDuration(seconds) {
  const whole = Math.floor(seconds), two = (n) => String(n).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}

function show(view) {
  for (const tab of document.querySelectorAll(".tab")) {
    const isShown = tab.dataset.view === view;
    if (isShown) { tab.setAttribute("aria-current", "page"); } else { tab.removeAttribute("aria-current"); }
    byId(`view-${tab.dataset.view}`).hidden = !isShown;
  }
  if (view === "recordings") { recordings.load(); }
  scheduleDraw();
}

function setFollow(on) {
  map.follow = on;
  byId("map-fit").setAttribute("aria-pressed", String(!on));
  byId("map-follow").setAttribute("aria-pressed", String(on));
  scheduleDraw();
}

for (const tab of document.querySelectorAll(".tab")) { tab.addEventListener("click", () => show(tab.dataset.view)); }
byId("map-fit").addEventListener("click", () => setFollow(false));
byId("map-follow").addEventListener("click", () => setFollow(true));
byId("record").addEventListener("click", () => send("record", { on: !feed.status.log.recording }));
byId("mark").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (await send("mark", { text: byId("mark-text").value })) {
    toast("Marked");
    byId("mark-text").value = "";
  }
});
document.addEventListener("keydown", (event) => {
  const isTyping = event.target.closest("input, select, textarea");
  if (event.key.toLowerCase() === "m" && !isTyping && !event.ctrlKey && !event.metaKey && !event.altKey && isLive) {
    event.preventDefault();
    show("live");
    byId("mark-text").focus();
  }
});
byId("logout").hidden = document.documentElement.dataset.token !== "yes";
byId("logout").addEventListener("click", logOut);
theme(byId("theme"), () => { resetColours(); if (feed.status) { shownStatus = null; } scheduleDraw(); });
new ResizeObserver(() => { shownStatus = null; scheduleDraw(); }).observe(byId("main"));
if (isLive) {
  feed.start();
} else {
  byId("state").hidden = true;
  document.querySelector(".tabs").hidden = true;
  show("recordings");
}
