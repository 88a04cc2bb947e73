// What a screen reader says: the verdict, and what each plot shows. It follows once nothing moves, so that a move costs
// nothing and not every step of it is read out.
import { byId, on, write } from "./messages.js";

const REST = 700;
let verdict = "", resting = 0;

const every = (view) => [view, ...[...view.children()].flatMap(every)];
const named = (element, name) => { if (element.getAttribute("aria-label") !== name) element.setAttribute("aria-label", name); };
const inside = (root, query) => {
  for (const one of root.querySelectorAll("*")) {
    const found = one.matches(query) ? one : one.shadowRoot && inside(one.shadowRoot, query);
    if (found) return found;
  }
  return null;
};

const plotNames = () => {
  for (const view of [...window.Bokeh.index.roots ?? window.Bokeh.index].flatMap(every)) {
    const panel = view.model.type === "Figure" || view.model.type === "Button" ? byId(`panel-${view.root.model.name}`) : null;
    if (!panel) continue;
    const caption = panel.getAttribute("aria-label");
    if (view.model.type === "Button") {
      const button = inside(view.el.shadowRoot, "button");
      if (button) named(button, `${view.model.label}: ${caption}`);
      continue;
    }
    const { left: [up], center, renderers } = view.model;
    // Of figures that stand above one another only the last one's axis has words.
    const along = every(view.root).findLast((one) => one.model.type === "Figure" && one.model.below[0].axis_label)?.model.below[0];
    const detail = inside(panel, ".detail")?.textContent, curves = inside(panel, "curve-keys")?.title;
    const axes = [up?.axis_label, along?.axis_label].filter(Boolean).join(" over ");
    const said = [...center, ...renderers].filter((one) => one.type === "Label" && one.visible).map((one) => one.text);
    view.el.setAttribute("role", "img");
    named(view.el, [`${caption}${detail ? `, ${detail}` : ""}`, axes, curves, ...said].filter(Boolean).join("; "));
  }
};

const speak = () => {
  write(byId("spoken"), verdict);
  plotNames();
};
on("bar", (given) => {
  verdict = `${given.words}. ${given.more}`;
  clearTimeout(resting);
  resting = setTimeout(speak, REST);
});
