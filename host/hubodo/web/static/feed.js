// The live feed: connects, stores the last minute, and reconnects after a restart of the recorder.

const HISTORY_S = 62; // s
const SESSION_ENDED = 4401;
const RETRY_MS = [500, 1000, 2000, 4000];

export class Feed {
  // onChange(): new data; onConnection(connected): the connection was opened or closed.
  constructor(onChange, onConnection) {
    this.onChange = onChange;
    this.onConnection = onConnection;
    this.tries = 0;
    this.reset({ trails: {}, events: [], sides: {} });
  }

  reset(hello) {
    this.sides = hello.sides;
    this.origin = hello.origin ?? null;
    this.trails = { o: [], m: [], g: [], ...hello.trails };
    this.events = hello.events;
    this.newEvents = hello.events.slice();
    this.frames = [];
    this.statusHistory = [];
    this.status = null;
    this.now = 0;
  }

  start() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.addEventListener("message", (event) => this.handle(JSON.parse(event.data)));
    socket.addEventListener("close", (event) => {
      this.onConnection(false);
      if (event.code === SESSION_ENDED) { location.assign("/login"); return; }
      const delay = RETRY_MS[Math.min(this.tries++, RETRY_MS.length - 1)];
      setTimeout(() => this.start(), delay);
    });
  }

  handle(message) {
    if (message.hello) {
      this.reset(message.hello);
      for (const frame of message.history) { this.add(frame, true); }
      this.tries = 0;
      this.csrf = message.hello.csrf;
      this.onConnection(true);
    } else {
      for (const frame of message.many ?? [message]) { this.add(frame, false); }
    }
    this.onChange();
  }

  add(frame, isHistory) {
    this.now = frame.t;
    this.frames.push(frame);
    if (frame.s) {
      this.status = frame.s;
      this.statusHistory.push({ t: frame.t, nodes: frame.s.nodes });
    }
    while (this.frames.length && this.frames[0].t < this.now - HISTORY_S) { this.frames.shift(); }
    while (this.statusHistory.length && this.statusHistory[0].t < this.now - HISTORY_S) { this.statusHistory.shift(); }
    if (isHistory) { return; }
    if (frame.origin) { this.origin = frame.origin; this.trails.g = []; }
    for (const key of ["o", "m", "g"]) {
      if (frame[key]) { appendPoint(this.trails[key], frame[key]); }
    }
    if (frame.e) { this.newEvents.push(...frame.e); }
  }

  // Returns the newest value of a key, or null.
  newest(key) {
    for (let k = this.frames.length - 1; k >= 0; k--) {
      if (this.frames[k][key]) { return this.frames[k][key]; }
    }
    return null;
  }

  takeNewEvents() {
    const events = this.newEvents;
    this.newEvents = [];
    return events;
  }
}

function appendPoint(trail, [x, y]) {
  const last = trail[trail.length - 1];
  if (last && Math.hypot(last[0] - x, last[1] - y) < 0.02) { return; }
  trail.push([x, y]);
  if (trail.length > 4000) { trail.splice(0, trail.length, ...trail.filter((_, k) => k % 2 === 0)); }
}
