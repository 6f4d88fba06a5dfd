// -- the state in the page's address ------------------------------------------------------------------------------

const SETTLED = 300; // milliseconds without a change after which the address follows; browsers limit how often it may
const LONGEST_ADDRESS = 40_000; // characters of a fragment that a page sends back in one message, which is limited

/**
 * Keeps the state in the fragment of the page's address, "#s=...", as `clvol.view.code.to_url` writes it: a reload, a bookmark and a
 * copied address show the same. While the first state is shown there is none.
 */
class Address {
  constructor(viewer) {
    this.viewer = viewer;
    this.last = ""; // the fragment that was read or written last
    this.first = null; // the state before anything was changed
    viewer.onConfirmed = (state) => this.follow(state);
    addEventListener("hashchange", () => this.read());
  }

  /** The state's text in the address, or "". */
  get text() {
    return new URLSearchParams(location.hash.slice(1)).get("s") ?? "";
  }

  /** Shows the state of the address to a session that has just begun. */
  begin() {
    this.last = "";
    this.read();
  }

  /** Shows the state of the address, unless it was read or written here. */
  async read() {
    const { text, viewer } = this;
    if (!text || text === this.last) return;
    this.last = text;
    viewer.noted = "";
    if (text.length > LONGEST_ADDRESS) viewer.note(`the state in this page's address has more than ${LONGEST_ADDRESS} characters`);
    else await viewer.ask("restore", { url: `#s=${text}` }).catch((error) => viewer.note(error.message));
  }

  /** Writes a state once none comes any more: a drag sends none before its end, and a slider many. */
  follow(state) {
    this.first ??= state;
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.write(state), SETTLED);
  }

  write(state) {
    const { viewer } = this;
    const isFirst = same(state, this.first);
    if (viewer.unheard.length || !viewer.info) return; // a newer state will come
    if (isFirst && viewer.noted) return; // what could not be read may be put right
    const text = isFirst ? "" : fragmentOf(state, viewer.info.defaults);
    if (text.length > LONGEST_ADDRESS) {
      viewer.note("this state is too long for the page's address: a reload shows the last one that was not; copy it as TOML");
      return;
    }
    if (text === this.text) return;
    this.last = text;
    history.replaceState(history.state, "", text ? `#s=${text}` : location.pathname + location.search);
  }
}

/** Compact JSON of what differs from the defaults, as base64url. */
function fragmentOf(state, defaults) {
  const brief = Object.entries(state).filter(([name, value]) => name === "version" || !same(value, defaults[name]));
  const bytes = new TextEncoder().encode(JSON.stringify(Object.fromEntries(brief)));
  const text = btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  return text.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
}
