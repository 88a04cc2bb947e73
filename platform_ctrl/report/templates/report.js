// Values under the pointer, zoom into a plot, designs on and off, folds open on paper. Without it the page is complete.
"use strict";
{
  const read = document.createElement("div");
  read.className = "read";
  read.hidden = true;
  read.setAttribute("aria-hidden", "true");
  document.body.append(read);
  const figures = [...document.querySelectorAll("figure svg[data-axes]")];
  const point = (svg, event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  const along = (share, low, high, log) => (log ? low * (high / low) ** share : low + share * (high - low));
  for (const svg of figures) {
    const axes = JSON.parse(svg.dataset.axes);
    const whole = svg.getAttribute("viewBox");
    let from = null;
    svg.addEventListener("pointermove", (event) => {
      const p = point(svg, event);
      const at = axes.find(([x, y, w, h]) => p.x >= x && p.x <= x + w && p.y >= y && p.y <= y + h);
      read.hidden = !at;
      if (!at) return;
      const [x, y, w, h, xs, ys] = at;
      const words = [along((p.x - x) / w, ...xs), along(1 - (p.y - y) / h, ...ys)].map((one) => String(+one.toPrecision(3)));
      read.textContent = words.join(",  ").replaceAll("-", "\u2212");
      read.style.left = Math.min(event.clientX + 14, innerWidth - read.offsetWidth - 4) + "px";
      read.style.top = event.clientY + 14 + "px";
    });
    svg.addEventListener("pointerleave", () => { read.hidden = true; });
    svg.addEventListener("pointerdown", (event) => {
      from = event.button || event.pointerType === "touch" || event.target.closest("[role=button]") ? null : point(svg, event);
      if (from) event.preventDefault();
    });
    svg.addEventListener("pointerup", (event) => {
      const to = point(svg, event);
      if (from && Math.abs(to.x - from.x) > 8 && Math.abs(to.y - from.y) > 8) {
        svg.style.aspectRatio = whole.split(" ").slice(2).join(" / ");
        const [x, y] = [Math.min(from.x, to.x), Math.min(from.y, to.y)];
        svg.setAttribute("viewBox", [x, y, Math.abs(to.x - from.x), Math.abs(to.y - from.y)].join(" "));
        svg.style.overflow = "hidden";
      }
      from = null;
    });
    svg.addEventListener("dblclick", () => {
      svg.setAttribute("viewBox", whole);
      svg.style.overflow = "";
    });
  }
  // A legend's entry and the colour of the handle to its left.
  const entries = figures.flatMap((svg) => [...svg.querySelectorAll(".legend text")].map((text) => {
    const box = text.getBoundingClientRect();
    const left = [...svg.querySelectorAll(".legend path, .legend use")].map((one) => [one, one.getBoundingClientRect()])
      .filter(([, it]) => it.right <= box.left + 2 && it.bottom > box.top - 2 && it.top < box.bottom + 2)
      .sort(([, a], [, b]) => b.right - a.right)[0];
    const colour = left && /stroke: *(var\(--series-\d+\))/.exec(left[0].getAttribute("style") ?? "");
    return colour && { svg, text, colour: colour[1], name: text.textContent.replace(/, closed$/, "") };
  }).filter(Boolean));
  for (const one of entries) {
    one.svg.setAttribute("role", "group");
    one.text.setAttribute("role", "button");
    one.text.setAttribute("tabindex", "0");
    one.text.setAttribute("aria-pressed", "true");
    one.text.style.cursor = "pointer";
    const toggle = () => {
      const off = one.text.getAttribute("aria-pressed") === "true";
      for (const same of entries.filter((it) => it.name === one.name)) {
        same.text.setAttribute("aria-pressed", String(!off));
        same.text.classList.toggle("off", off);
        for (const drawn of same.svg.querySelectorAll(`[style*="${same.colour}"]`))
          if (!drawn.closest(".legend")) drawn.style.visibility = off ? "hidden" : "";
      }
    };
    one.text.addEventListener("click", toggle);
    one.text.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      toggle();
    });
  }
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((one) => { one.open = true; }));
}
