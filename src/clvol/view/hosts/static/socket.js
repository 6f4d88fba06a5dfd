// -- the websocket of a page, and what is said and done when it is lost -------------------------------------------

const RETRY = [500, 1000, 2000, 4000, 8000, 16_000, 30_000]; // milliseconds before reconnecting
const DOUBTFUL = 4; // tries after which clvol may have ended
const IDLE = 4000; // close code of an idle page, which keeps its state
const LEFT_ALONE = [1008, 1009, 4001]; // close codes after which the page does not reconnect by itself
const REFUSED = 4003; // close code of a page that the server does not know
const BEAT = 100; // milliseconds between looks at whether clvol answers
const STOOD = 500; // and that between two looks tell that the page itself stood still
const UNHEARD = 350; // milliseconds of silence after which it is asked
const SILENT = 850; // and after which it is said that it does not answer: with a look within a second
const WORKING = 3; // seconds without progress after which it is said that clvol is computing
const HANGING = 60; // and after which it may hang
const STUCK = "clvol has shown no progress for a minute; if that goes on, end it, and start it again";
const RENEWED = "open the address that clvol prints when it is started again";

class Socket {
  constructor(path) {
    this.url = new URL(path, location.href);
    this.url.hash = "";
    this.onmessage = () => {};
    this.onopen = () => {};
    this.onlost = () => {}; // (words, how): "retry", "doubtful" while it tries on, "wait" for a click, "ended" or "final"
    this.onsilent = () => {}; // with words if clvol does not answer or get on, and with "" once it does; and their kind
    this.tries = 0;
    this.welcomed = false; // ever
    this.upload = Infinity;
    this.token = new URLSearchParams(location.search).get("token"); // until it is exchanged for the secret
    this.name = `clvol ${this.url.pathname}`;
    this.heard = this.looked = performance.now();
    this.silent = false;
    this.working = 0;
    setInterval(() => this.look(), BEAT);
  }

  /** Asks whether clvol still answers: a server that hangs keeps its connection. */
  look() {
    const now = performance.now();
    const stood = document.hidden || this.socket?.readyState !== WebSocket.OPEN || now - this.looked > STOOD; // the page itself
    this.looked = now;
    if (stood) this.heard = Math.max(this.heard, now - UNHEARD);
    if (this.socket?.readyState !== WebSocket.OPEN) this.silent = false; // that is said otherwise
    else if (now - this.heard >= UNHEARD) this.send({ type: "ping" });
    if (stood || now - this.heard < SILENT || this.silent) return;
    this.silent = true;
    this.onsilent("clvol does not answer", "error");
  }

  hear() {
    this.heard = performance.now();
    if (this.silent) this.onsilent("");
    this.silent = false;
  }

  /** The server lives; its thread that draws may take long over one thing, or hang. */
  answered({ working = 0 }) {
    const level = (working >= WORKING) + (working >= HANGING);
    if (level !== this.working) this.onsilent(...[[""], ["still computing", "busy"], [STUCK, "warning"]][level]);
    this.working = level;
  }

  /** What proves that this page may look: kept by the browser for the page's origin, as cookies are for all ports of a machine. */
  get secret() {
    try {
      return localStorage.getItem(this.name) ?? this.own ?? "";
    } catch {
      return this.own ?? ""; // without storage
    }
  }

  /** Headers of requests beside the socket. */
  get headers() {
    return { "X-Clvol-Secret": this.secret };
  }

  /** Keeps the secret; the address loses the token. */
  welcome({ secret, upload }) {
    this.own = secret;
    this.upload = upload; // bytes that a file may have that is sent
    try {
      localStorage.setItem(this.name, secret);
    } catch {} // without storage a reload needs the printed address
    this.welcomed = true;
    this.tries = 0;
    if (this.token !== null) history.replaceState(history.state, "", location.pathname + location.hash);
    this.token = null;
    this.onopen();
  }

  send(object) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(object));
  }

  connect() {
    const url = new URL(this.url);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(url);
    this.socket.binaryType = "arraybuffer";
    let header = null; // of the bytes that follow
    this.socket.onopen = () => this.send({ type: "hello", token: this.token ?? "", secret: this.secret });
    this.socket.onmessage = ({ data }) => {
      this.hear();
      if (typeof data !== "string") {
        const message = header;
        header = null;
        if (message) this.onmessage(message, data);
        return;
      }
      const message = JSON.parse(data);
      if (message.type === "pong") this.answered(message);
      else if (message.type === "welcome") this.welcome(message);
      else if (message.bytes !== undefined) header = message;
      else this.onmessage(message, null);
    };
    this.socket.onclose = (event) => this.closed(event);
  }

  closed({ code, reason }) {
    if (code === IDLE) return this.onlost(`${reason}; click to continue`, "wait");
    if (LEFT_ALONE.includes(code)) return this.onlost(`${reason || "the connection to clvol was lost"}; reload to continue`, "final");
    if (code === REFUSED) return this.onlost(this.welcomed ? `this viewer has ended; ${RENEWED}` : reason, "ended");
    const wait = RETRY[Math.min(this.tries++, RETRY.length - 1)];
    const doubtful = this.tries > DOUBTFUL;
    const words = doubtful ? `clvol does not answer; if it has ended, ${RENEWED}` : reason || "the connection to clvol was lost";
    setTimeout(() => this.connect(), wait);
    return this.onlost(`${words}; trying again in ${wait / 1000} s`, doubtful ? "doubtful" : "retry");
  }
}

/** A field for the address of a viewer that was started again, which shows the state of this page. */
function renewal(viewer) {
  const box = make("input", { type: "text", "aria-label": "the new address", placeholder: "the new address", inputmode: "url", spellcheck: false });
  const open = () => {
    try {
      const url = new URL(box.value.trim());
      if (!["http:", "https:"].includes(url.protocol)) throw new TypeError(url.protocol);
      url.hash = location.hash;
      location.assign(url);
    } catch {
      viewer.status("an address begins with http:// or https://", "error");
    }
  };
  box.addEventListener("keydown", (event) => event.key === "Enter" && open());
  return make("div", { class: "clvol-renewal", hidden: true }, box, button("Open", open, { title: "with the state of this page" }));
}
