// Buttons, dialogs and keys.
import { request, byId, receive, made, on } from "./messages.js";
import { shownState } from "./choices.js";
import { rows } from "./sliders.js";

const copy = async (text) => {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    // Without leave to write the clipboard: the older way.
    const field = made("textarea", { value: text, className: "unseen" });
    (document.querySelector("dialog[open]") ?? document.body).append(field);
    field.select();
    const done = document.execCommand("copy");
    field.remove();
    return done;
  }
};

const say = (text, kind = "quiet") => receive({ line: { text, kind } });
const acts = {
  undo: () => request("undo"),
  redo: () => request("redo"),
  tune: () => request("tune"),
  cancel: () => request("cancel"),
  simulate: () => request("simulate", { manoeuvre: byId("manoeuvre").value }),
  help: () => byId("help-dialog").showModal(),
  link: async () => say(await copy(location.href) ? "The link is copied: it opens exactly this state." : "The link is in the address bar: it opens exactly this state.", "good"),
  save: () => {
    byId("saved").hidden = true;
    byId("save-line").textContent = "";
    byId("save-go").textContent = "Save";
    byId("save-name").value ||= shownState()?.stem ?? "";
    byId("save-folder").textContent = shownState()?.folder ?? "";
    byId("save-dialog").showModal();
    byId("save-name").select();
  },
};
for (const id of Object.keys(acts)) byId(id).addEventListener("click", () => acts[id]());

let overwrite = false;
byId("save-name").addEventListener("input", () => { overwrite = false; byId("save-go").textContent = "Save"; byId("save-line").textContent = ""; });
byId("save-dialog").addEventListener("close", () => { overwrite = false; });
byId("save-close").addEventListener("click", () => byId("save-dialog").close());
byId("save-dialog").querySelector("form").addEventListener("submit", (event) => {
  event.preventDefault();
  byId("saved").hidden = true;
  request("save", { name: byId("save-name").value, overwrite });
});
on("saved", (given) => {
  const line = byId("save-line");
  line.textContent = given.text;
  line.className = given.kind;
  overwrite = given.exists === true;
  byId("save-go").textContent = overwrite ? "Overwrite" : "Save";
  byId("saved").hidden = !given.command;
  byId("saved-command").textContent = given.command ?? "";
});
byId("saved-copy").addEventListener("click", async () => {
  byId("saved-copy").textContent = await copy(byId("saved-command").textContent) ? "Copied" : "Select it";
});

// One plot is large, the others are thumbnails; the large one may take all of the room, or all plots are equal.
const LARGE = "platform_ctrl large plot";
const kept = () => { try { return localStorage.getItem(LARGE); } catch { return null; } };
const panels = () => [...document.querySelectorAll(".panel")];
const ofBudget = (panel) => panel?.classList.contains("of-budget") === true;
let chosen = null;
const large = () => document.querySelector(".panel.large");
const grow = (panel, alone) => {
  byId("plots").classList.toggle("grown", alone);
  byId("plots").classList.toggle("focus", panel !== null);
  for (const one of panels()) {
    one.classList.toggle("large", one === panel);
    const button = one.querySelector(".grow"), name = one.getAttribute("aria-label");
    button.setAttribute("aria-pressed", String(one === panel));
    button.setAttribute("aria-label", `${one !== panel ? "Enlarge" : alone ? "Back" : "Show alone"}: ${name}`);
  }
  // The panels of the budget are large only alone.
  if (ofBudget(panel)) return;
  chosen = panel;
  try { localStorage.setItem(LARGE, panel?.id ?? "none"); } catch { /* it lasts as long as the page */ }
};
const back = () => grow(chosen, false);
for (const button of document.querySelectorAll(".grow")) {
  button.addEventListener("click", () => {
    const panel = button.closest(".panel"), alone = byId("plots").classList.contains("grown");
    // Enlarged, then alone, then as all others.
    if (panel !== large()) grow(panel, ofBudget(panel));
    else if (ofBudget(panel)) back();
    else grow(alone ? null : panel, !alone);
    button.focus();
  });
}
grow(kept() === "none" ? null : byId(kept() ?? "panel-bode") ?? byId("panel-bode"), false);
let lastPanel = document.querySelector(".panel");
for (const type of ["mouseover", "focusin"]) {
  byId("plots").addEventListener(type, (event) => { lastPanel = event.target.closest?.(".panel") ?? lastPanel; });
}

const next = (id, way) => {
  const select = byId(id);
  if (select.disabled || select.options.length < 2) return;
  select.selectedIndex = (select.selectedIndex + way + select.options.length) % select.options.length;
  select.dispatchEvent(new Event("change"));
};
const focusedRow = () => rows.get(document.activeElement?.closest?.("[data-slider]")?.dataset.slider);
const choose = (id, index) => {
  const select = byId(id);
  if (index >= select.options.length) return;
  select.selectedIndex = index;
  select.dispatchEvent(new Event("change"));
};

// [keys as they are shown, what they do, when they are meant, the act]
const KEYS = [
  ["Ctrl Z", "undo", (e) => e.ctrl && !e.shift && e.key === "z", acts.undo],
  ["Ctrl Shift Z", "redo; also Ctrl Y", (e) => e.ctrl && ((e.shift && e.key === "z") || e.key === "y"), acts.redo],
  ["Ctrl S", "save as a job file", (e) => e.ctrl && e.key === "s", acts.save],
  ["← →", "move the slider; with Shift: coarsely"],
  ["PgUp PgDn", "move the slider by a tenth"],
  ["Home End", "to the slider's ends"],
  ["G", "go to the sliders", (e) => e.key === "g", () => rows.values().next().value?.range.focus()],
  ["N", "type the slider's number; Enter takes it", (e) => e.key === "n", () => focusedRow()?.number.focus()],
  ["X", "fix the slider, or free it", (e) => e.key === "x", () => focusedRow()?.pin.click()],
  ["R", "reset the slider to the job's value", (e) => e.key === "r", () => focusedRow()?.reset.click()],
  ["1 … 9", "loop of that number", (e) => /^[1-9]$/.test(e.key), (e) => choose("loop", Number(e.key) - 1)],
  ["M", "caged or stabilised", (e) => e.key === "m", () => byId("mode").querySelector('[aria-checked="false"]:not(:disabled)')?.click()],
  ["D", "next design; Shift: previous", (e) => e.key === "d", (e) => next("design", e.shift ? -1 : 1)],
  ["Q", "next torquer; Shift: previous", (e) => e.key === "q", (e) => next("channel", e.shift ? -1 : 1)],
  ["A", "next axis; Shift: previous", (e) => e.key === "a", (e) => next("axis", e.shift ? -1 : 1)],
  ["P", "next plant; Shift: previous", (e) => e.key === "p", (e) => next("plant", e.shift ? -1 : 1)],
  ["J", "loop or budget of the line of sight", (e) => e.key === "j", () => byId("view")?.querySelector('[aria-checked="false"]')?.click()],
  ["B", "band of the set on or off", (e) => e.key === "b", () => byId("band").click()],
  ["T", "tune the rest", (e) => e.key === "t", () => byId("tune").click()],
  ["C", "go to the designs that can be drawn over this one", (e) => e.key === "c", () => byId("overlays").querySelector("input")?.focus()],
  ["Y", "apply the next step", (e) => e.key === "y", () => byId("apply").click()],
  ["S", "simulate the manoeuvre", (e) => e.key === "s", () => byId("simulate").click()],
  ["F", "enlarge the plot last pointed at; again: alone, and equal to the others", (e) => e.key === "f", () => lastPanel.querySelector(".grow").click()],
  ["L", "copy the link", (e) => e.key === "l", acts.link],
  ["K", "theme: light, dark, as the system", (e) => e.key === "k", () => {
    const themes = ["light", "dark", "system"];
    window.pageTheme.choose(themes[(themes.indexOf(window.pageTheme.choice()) + 1) % 3]);
  }],
  ["Esc", "cancel what is going on; close", (e) => e.key === "escape", () => {
    if (!byId("busy").hidden) acts.cancel();
    else if (byId("plots").classList.contains("grown")) back();
  }],
  ["?", "this list", (e) => e.key === "?", acts.help],
];
byId("keys").append(...KEYS.flatMap(([keys, words]) => [
  made("dd", {}, ...keys.split(" ").flatMap((key) => (key === "…" ? ["…"] : [made("kbd", {}, key), " "]))), made("dt", {}, words)]));

document.addEventListener("keydown", (event) => {
  const target = event.composedPath()[0];
  const inText = target instanceof HTMLInputElement && target.type === "text";
  const e = { key: event.key.toLowerCase(), ctrl: event.ctrlKey || event.metaKey, shift: event.shiftKey };
  if (event.altKey || document.querySelector("dialog[open]")) return;
  // Letters belong to text fields, and to lists, which go to the entry that begins with them.
  if (!e.ctrl && (inText || target instanceof HTMLSelectElement) && e.key !== "escape") return;
  if (inText && e.ctrl && e.key !== "s") return;
  for (const [, , meant, act] of KEYS) {
    if (meant?.(e) && (e.ctrl || !event.defaultPrevented)) {
      event.preventDefault();
      if (e.ctrl || !event.repeat) act(e);
      return;
    }
  }
});
