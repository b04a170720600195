// The live feed: connects, keeps the last minute, and connects again when the recorder has been away.

const KEPT = 62; // s
const SESSION_ENDED = 4401;
const PATIENCE = [500, 1000, 2000, 4000];

export class Feed {
  // changed(): something new is there; state(connected): the connection came or went.
  constructor(changed, state) {
    this.changed = changed;
    this.state = state;
    this.tries = 0;
    this.reset({ trails: {}, events: [], sides: {} });
  }

  reset(hello) {
    this.sides = hello.sides;
    this.origin = hello.origin ?? null;
    this.trails = { o: [], m: [], g: [], ...hello.trails };
    this.events = hello.events;
    this.fresh = hello.events.slice();
    this.frames = [];
    this.past = [];
    this.slow = null;
    this.now = 0;
  }

  start() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    socket.addEventListener("message", (event) => this.take(JSON.parse(event.data)));
    socket.addEventListener("close", (event) => {
      this.state(false);
      if (event.code === SESSION_ENDED) { location.assign("/login"); return; }
      const wait = PATIENCE[Math.min(this.tries++, PATIENCE.length - 1)];
      setTimeout(() => this.start(), wait);
    });
  }

  take(message) {
    if (message.hello) {
      this.reset(message.hello);
      for (const frame of message.history) { this.add(frame, true); }
      this.tries = 0;
      this.csrf = message.hello.csrf;
      this.state(true);
    } else {
      for (const frame of message.many ?? [message]) { this.add(frame, false); }
    }
    this.changed();
  }

  add(frame, past) {
    this.now = frame.t;
    this.frames.push(frame);
    if (frame.s) {
      this.slow = frame.s;
      this.past.push({ t: frame.t, nodes: frame.s.nodes });
    }
    while (this.frames.length && this.frames[0].t < this.now - KEPT) { this.frames.shift(); }
    while (this.past.length && this.past[0].t < this.now - KEPT) { this.past.shift(); }
    if (past) { return; }
    if (frame.origin) { this.origin = frame.origin; this.trails.g = []; }
    for (const key of ["o", "m", "g"]) {
      if (frame[key]) { grow(this.trails[key], frame[key]); }
    }
    if (frame.e) { this.fresh.push(...frame.e); }
  }

  // The newest frame's value of a key.
  last(key) {
    for (let k = this.frames.length - 1; k >= 0; k--) {
      if (this.frames[k][key]) { return this.frames[k][key]; }
    }
    return null;
  }

  takeEvents() {
    const fresh = this.fresh;
    this.fresh = [];
    return fresh;
  }
}

function grow(trail, [x, y]) {
  const last = trail[trail.length - 1];
  if (last && Math.hypot(last[0] - x, last[1] - y) < 0.02) { return; }
  trail.push([x, y]);
  if (trail.length > 4000) { trail.splice(0, trail.length, ...trail.filter((_, k) => k % 2 === 0)); }
}
