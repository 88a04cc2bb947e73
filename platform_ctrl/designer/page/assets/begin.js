// Waits for BokehJS, takes the model that carries questions and answers, and asks for the first picture.
import { ask, connect, hear, traffic } from "./wire.js";
import { themeChanged } from "./choices.js";
import { watch } from "./connection.js";
import "./sliders.js";
import "./table.js";
import "./acts.js";

const LOOK = 20;
// For who watches the page from outside: whether everything that it asked for is done.
window.designer = {
  traffic,
  settled: () => {
    const { asked, answered, waiting } = traffic();
    return asked > 0 && asked === answered && waiting === 0;
  },
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
  themeChanged();
  ask("ready");
};

const wait = () => {
  const bokeh = window.Bokeh?.documents[0];
  if (bokeh?.is_idle) begin(bokeh);
  else setTimeout(wait, LOOK);
};
wait();
