// Waits for BokehJS, takes the model that carries the messages, and requests the first picture.
import { request, connect, receive, traffic } from "./messages.js";
import { themeChanged } from "./choices.js";
import { watch } from "./connection.js";
import { follow } from "./cursor.js";
import "./sliders.js";
import "./table.js";
import "./strip.js";
import "./budget.js";
import "./actions.js";

const LOOK = 20;
// For who watches the page from outside: whether everything that it requested is done.
window.page = {
  traffic,
  settled: () => {
    const { sent, answered, waiting } = traffic();
    return sent > 0 && sent === answered && waiting === 0;
  },
};

const begin = (bokeh) => {
  const messages = bokeh.get_model_by_name("messages");
  connect((message) => { messages.request = JSON.stringify(message); });
  messages.properties.response.change.connect(() => {
    const response = JSON.parse(messages.response);
    receive(response);
    if (response.bar) document.body.classList.remove("starting");
    window.dispatchEvent(new CustomEvent("response", { detail: traffic() }));
  });
  watch(bokeh);
  follow(bokeh);
  themeChanged();
  request("ready");
};

const wait = () => {
  const bokeh = window.Bokeh?.documents[0];
  if (bokeh?.is_idle) begin(bokeh);
  else setTimeout(wait, LOOK);
};
wait();
