// What the page does when the server is lost: it says so, and comes back with its state when the server does.
import { receive } from "./messages.js";

const AGAIN = 1500;
const LOST = "The connection to the server is lost. The page returns with its state as soon as the server answers.";
const OTHER = "The server was started again and has another link: open that one, or put its token into this address, which holds the state.";

const say = (text, kind) => receive({ line: { text, kind } });

const back = async () => {
  try {
    const answer = await fetch(location, { cache: "no-store" });
    // The address holds the state.
    if (answer.ok) { window.location.reload(); return; }
    if (answer.status === 403) say(OTHER, "error");
  } catch { /* Still away. */ }
  setTimeout(back, AGAIN);
};

export const watch = (bokeh) => {
  let lost = false;
  bokeh.on_event("connection_lost", () => {
    if (lost) return;
    lost = true;
    document.body.classList.add("lost");
    document.querySelector("#busy").hidden = true;
    say(LOST, "error");
    setTimeout(back, AGAIN);
  });
};
