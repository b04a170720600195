// The search of the documentation for pages opened from the disk, where browsers allow no web workers: a hidden
// frame runs the script of the worker instead.
if (location.protocol === "file:") {
  const prelude = `
    postMessage = parent.postMessage.bind(parent);
    importScripts = (...urls) => urls.reduce((loaded, url) => loaded.then(() => new Promise((done) => {
      const script = document.createElement("script");
      script.src = url;
      script.onload = done;
      document.body.appendChild(script);
    })), Promise.resolve());
  `;
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.appendChild(this.frame);
      const inside = this.frame.contentWindow;
      this.loaded = new Promise((done) => this.frame.addEventListener("load", done, { once: true }));
      inside.document.open();
      inside.document.write(`<body><script>${prelude}<\/script><script src="${url}"><\/script></body>`);
      inside.document.close();
      this.receive = (event) => {
        if (event.source !== inside) { return; }
        const message = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(message);
        if (this.onmessage) { this.onmessage(message); }
      };
      window.addEventListener("message", this.receive);
    }

    postMessage(data) {
      const message = new MessageEvent("message", { data });
      this.loaded.then(() => this.frame.contentWindow.dispatchEvent(message));
    }

    terminate() {
      this.frame.remove();
      window.removeEventListener("message", this.receive);
    }
  };
}
