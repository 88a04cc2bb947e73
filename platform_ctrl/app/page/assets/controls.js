// The page's own part: sliders while they are dragged, keys, dialogs, the large plot; its start, and its return after a lost connection.
import { byId, choose, connect, held, move, newGesture, on, request } from "./messages.js";

const STEPS = 4000, COARSE = 80, AGAIN = 1500, LOOK = 20;
// Milliseconds without a move after which the next move by keys is a gesture of its own.
const SERIES = 1500;
const say = (text, kind = "quiet") => Object.assign(byId("line"), { textContent: text, title: text, className: kind });

// A click or a choice sends the request in the element's attributes.
const ask = (element, value) => {
  const { what, more = "{}", value: name } = element.dataset, content = JSON.parse(more);
  if (name) content[name] = value;
  if (what === "move") content.gesture = newGesture();
  choose(element, what, content);
};

document.addEventListener("click", async (event) => {
  const button = event.target.closest?.("button");
  if (!button) return;
  const { what, dialog, copy, focus } = button.dataset;
  if (what) ask(button);
  if (dialog) {
    byId(dialog).showModal();
    byId(dialog).querySelector("input")?.select();
  }
  if ("close" in button.dataset) button.closest("dialog").close();
  if (copy !== undefined) {
    const copied = await navigator.clipboard?.writeText(copy ? byId(copy).textContent : location.href).then(() => true, () => false);
    if (copy) button.textContent = copied ? "Copied" : "Select it";
    else say(copied ? "The link is copied: it opens exactly this state." : "The link is in the address bar: it opens exactly this state.", "good");
  }
  // "All runs" is an entry of the list of manoeuvres.
  if (focus && byId("manoeuvre").options.length > 1) byId("manoeuvre").value = "";
  if (focus) byId(focus).focus();
  if (button.matches(".reset")) byId(`slider-${button.closest(".slider").dataset.slider}`).focus();
  if (button.matches(".grow")) grow(button.closest(".panel"));
});
document.addEventListener("change", ({ target }) => {
  if (target.name === "theme") {
    window.pageTheme.choose(target.value);
    themed();
  } else if (target.dataset.what && target.type !== "text") {
    ask(target, target.type === "checkbox" ? target.checked : "number" in target.dataset ? Number(target.value) : target.value);
  }
});
byId("simulate").addEventListener("click", () => request("simulate", { manoeuvre: byId("manoeuvre").value }));

// Sliders.
let pressed = false, moved = -Infinity;
const slide = (range) => {
  const row = range.closest(".slider"), { slider, low, high } = row.dataset, [a, b] = [Number(low), Number(high)], part = range.value / STEPS;
  const value = Number(("logarithmic" in row.dataset ? a * (b / a) ** part : a + part * (b - a)).toPrecision(4));
  held.add(slider);
  range.style.setProperty("--at", `${100 * part}%`);
  row.querySelector('input[type="text"]').value = value;
  const now = performance.now();
  if (!pressed && now - moved > SERIES) newGesture();
  moved = now;
  move(slider, value);
};
document.addEventListener("pointerdown", ({ target }) => {
  pressed = target.type === "range";
  if (pressed) newGesture();
});
document.addEventListener("pointerup", () => { pressed = false; });
document.addEventListener("input", ({ target }) => {
  if (target.type === "range" && target.closest(".slider")) slide(target);
  else if (target.dataset.what) target.dataset.typing = "yes";
  // Consent to replace a file is for its name alone.
  else if (target.id === "save-name") Object.assign(byId("save-go"), { value: "false", textContent: "Save" });
});

// Typed numbers: Enter sends them, Esc restores the old ones. The server checks them.
const commit = (field) => {
  if (!field.dataset.typing) return;
  delete field.dataset.typing;
  if (field.value.trim() === field.getAttribute("value")) return;
  const text = field.value.trim().replace(/^([≥≤]|[<>]=?)\s*/, "").replace("−", "-").replace(/^(-?\d*),(\d+)$/, "$1.$2");
  const value = text === "" || Number.isNaN(Number(text)) ? field.value.slice(0, 40) : Number(text);
  const { slider } = JSON.parse(field.dataset.more);
  if (slider) request("move", { moves: [{ slider, value }], gesture: newGesture() });
  else ask(field, value);
};
document.addEventListener("focusin", ({ target }) => {
  if (target.dataset.what && target.type === "text") {
    target.value = target.dataset.numberTyped ?? target.value;
    target.select();
  }
});
document.addEventListener("focusout", ({ target }) => {
  if (target.dataset.what && target.type === "text") {
    if (target.closest(".slider")) commit(target);
    delete target.dataset.typing;
    target.value = target.getAttribute("value");
  }
});
const typed = (field, key) => {
  if (key === "Enter") commit(field);
  else delete field.dataset.typing;
  field.blur();
};

// The same slider is marked in its row and in the table.
for (const type of ["mouseover", "focusin"]) {
  document.addEventListener(type, ({ target }) => {
    const name = target.closest?.("[data-slider]")?.dataset.slider;
    for (const one of document.querySelectorAll(".near")) one.classList.remove("near");
    if (name) for (const one of document.querySelectorAll(`[data-slider="${CSS.escape(name)}"]`)) one.classList.add("near");
  });
}

// One plot is large, the others are thumbnails; a second click gives it all of the room.
let large = null, pointed = document.querySelector(".panel");
const grow = (panel) => {
  const budget = panel.classList.contains("of-budget"), again = panel.classList.contains("large");
  // A panel of the budget is never enlarged beside others.
  const alone = again ? !budget && !byId("plots").classList.contains("grown") : budget;
  if (!budget) large = panel;
  const shown = again && budget ? large : panel;
  byId("plots").classList.toggle("grown", alone);
  for (const one of document.querySelectorAll(".panel")) {
    one.classList.toggle("large", one === shown);
    one.querySelector(".grow").setAttribute("aria-pressed", String(one === shown));
  }
};
grow(pointed);
for (const type of ["mouseover", "focusin"]) {
  byId("plots").addEventListener(type, ({ target }) => { pointed = target.closest?.(".panel") ?? pointed; });
}

// Keys: shortcuts that elements name themselves, and a few for the element that has the focus.
const press = (element, way) => {
  // The buttons follow the shown state, but a move that is still being computed can be undone too.
  if (element.matches("#undo, #redo")) request(element.id);
  else if (element.matches("button, input")) element.click();
  else if (element.matches("fieldset")) {
    const all = [...element.querySelectorAll("input")];
    all[(all.findIndex((one) => one.checked) + 1) % all.length].click();
  } else if (element.matches("select") && !element.disabled) {
    select(element, (element.selectedIndex + way + element.options.length) % element.options.length);
  } else element.querySelector("input")?.focus();
};
const select = (list, index) => {
  if (index >= list.options.length) return;
  list.selectedIndex = index;
  list.dispatchEvent(new Event("change", { bubbles: true }));
};
const special = (key, row) => {
  if (key === "ESCAPE") {
    if (!byId("busy").hidden) request("cancel");
    else if (byId("plots").classList.contains("grown")) grow(document.querySelector(".panel.large"));
  } else if (/^[1-9]$/.test(key)) select(byId("loop"), Number(key) - 1);
  else if (key === "G") document.querySelector('#sliders input[type="range"]')?.focus();
  else if (key === "F") pointed.querySelector(".grow").click();
  else if (row && key === "N") row.querySelector('input[type="text"]').focus();
  else if (row && key === "X") row.querySelector(".pin").click();
  else if (row && key === "R") row.querySelector(".reset").click();
  else return false;
  return true;
};
document.addEventListener("keydown", (event) => {
  const { target, shiftKey: shift } = event, control = event.ctrlKey || event.metaKey, key = event.key.toUpperCase();
  const field = target.dataset?.what && target.type === "text";
  if (field && (key === "ENTER" || key === "ESCAPE")) typed(target, event.key);
  if (event.altKey || document.querySelector("dialog[open]") || field && (!control || key !== "S")) return;
  if (target.type === "range" && shift && event.key.startsWith("Arrow")) {
    target.value = Number(target.value) + (/Right|Up/.test(event.key) ? COARSE : -COARSE);
    slide(target);
  } else {
    const name = [control && "Control", shift && /^[A-Z]$/.test(key) && "Shift", key].filter(Boolean).join("+");
    const named = document.querySelector(`[aria-keyshortcuts~="${CSS.escape(name)}"]`);
    // In a list a letter goes to the entry that begins with it.
    if (!control && target instanceof HTMLSelectElement) return;
    if (named && (control || !event.repeat)) press(named, shift ? -1 : 1);
    else if (control || !special(key, target.closest?.(".slider"))) return;
  }
  event.preventDefault();
});

// Answers.
on("line", (line) => say(...line));
on("busy", (words) => {
  byId("busy").hidden = words === "";
  byId("busy").querySelector(".words").textContent = words;
});
on("view", (view) => document.body.classList.toggle("budget", view === "budget"));
on("spoken", (words) => { byId("spoken").textContent = words; });
on("link", (link) => {
  const address = new URL(location);
  if (link) address.searchParams.set("state", link);
  else address.searchParams.delete("state");
  if (address.href !== location.href) history.replaceState(null, "", address);
});
on("answered", () => {
  byId("compared").hidden = byId("overlays").childElementCount === 0;
  if (byId("numbers")) document.body.classList.remove("starting");
});
byId("save-dialog").querySelector("form").addEventListener("submit", (event) => {
  event.preventDefault();
  if (document.body.classList.contains("lost")) Object.assign(byId("save-line"), { className: "error", textContent: "Not saved: the connection to the server is lost." });
  else request("save", { name: byId("save-name").value, overwrite: byId("save-go").value === "true" });
});

// A lost page says so, and is loaded again with its state, which the address holds, as soon as the server answers.
const back = async () => {
  const answer = await fetch(location, { cache: "no-store" }).catch(() => null);
  if (answer?.ok) location.reload();
  else setTimeout(back, AGAIN);
  if (answer?.status === 403) say("The server was started again and has another link: open that one, or put its token into this address, which holds the state.", "error");
};

const themed = () => request("dark", { dark: window.pageTheme.isDark });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  window.pageTheme.apply();
  themed();
});
document.querySelector(`#theme [value="${window.pageTheme.choice}"]`).checked = true;
const begin = (bokeh) => {
  if (!bokeh?.is_idle) {
    setTimeout(() => begin(window.Bokeh?.documents[0]), LOOK);
    return;
  }
  connect(bokeh);
  bokeh.on_event("connection_lost", () => {
    if (document.body.classList.contains("lost")) return;
    document.body.classList.add("lost");
    byId("busy").hidden = true;
    say("The connection to the server is lost. The page returns with its state as soon as the server answers.", "error");
    setTimeout(back, AGAIN);
  });
  themed();
  request("ready");
};
begin(window.Bokeh?.documents[0]);
