// Waits for BokehJS, takes the model that carries questions and answers, and asks for the first picture.
import { ask, connect, hear, traffic } from "./messages.js";
import { themeChanged } from "./choices.js";
import { watch } from "./connection.js";
import "./sliders.js";
import "./table.js";
import "./actions.js";

const LOOK = 20;
// For who watches the page from outside: whether everything that it asked for is done.
window.designer = {
  traffic,
  settled: () => {
    const { asked, answered, waiting } = traffic();
    return asked > 0 && asked === answered && waiting === 0;
  },
};

// With Shift a drag in a plot may make limits missed: told as soon as it changes, before the place of the next move.
const shiftFrees = () => {
  let free = false;
  const heard = (now) => {
    if (now === free) return;
    free = now;
    ask("free", { free });
  };
  for (const name of ["keydown", "keyup", "pointerdown", "pointermove"]) {
    window.addEventListener(name, (event) => heard(event.shiftKey === true), { capture: true, passive: true });
  }
  window.addEventListener("blur", () => heard(false));
};

const begin = (bokeh) => {
  const wire = bokeh.get_model_by_name("wire");
  connect((message) => { wire.asked = JSON.stringify(message); });
  wire.properties.told.change.connect(() => {
    const told = JSON.parse(wire.told);
    hear(told);
    if (told.bar) document.body.classList.remove("starting");
    window.dispatchEvent(new CustomEvent("told", { detail: traffic() }));
  });
  watch(bokeh);
  shiftFrees();
  themeChanged();
  ask("ready");
};

const wait = () => {
  const bokeh = window.Bokeh?.documents[0];
  if (bokeh?.is_idle) begin(bokeh);
  else setTimeout(wait, LOOK);
};
wait();
