// <curve-keys>: what each curve of a plot is, in one line. Keys that have no room are counted instead: "+3".
const ROOM = 26; // pixels for the count
const ROUNDING = 1; // sizes are told in whole pixels, each rounded by itself

class CurveKeys extends HTMLElement {
  connectedCallback() {
    // It gets its size after the page was laid out, so that asking where the keys stand costs nothing.
    this.sizes = new ResizeObserver(() => this.fit());
    this.sizes.observe(this);
  }

  disconnectedCallback() { this.sizes.disconnect(); }

  fit() {
    this.more ??= Object.assign(document.createElement("span"), { className: "more" });
    const keys = [...this.children].filter((key) => key !== this.more), width = this.clientWidth;
    const ends = keys.map((key) => key.offsetLeft + key.offsetWidth);
    const all = keys.length === 0 || ends.at(-1) <= width + ROUNDING;
    const few = all ? keys.length : ends.filter((end) => end + ROOM <= width).length;
    keys.forEach((key, k) => { key.style.visibility = k < few ? "" : "hidden"; });
    this.more.remove();
    if (all) return;
    this.more.textContent = few > 0 ? `+${keys.length - few}` : `${keys.length} curves`;
    this.more.style.left = few > 0 ? `${ends[few - 1] + 8}px` : "0";
    this.append(this.more);
  }
}
customElements.define("curve-keys", CurveKeys);
