// Where the page begins: with the data inside a report, or with what the server knows.

import { opened } from "./arrays.js";
import { element, fill } from "./elements.js";
import { Page } from "./page.js";
import { Server } from "./server.js";

const root = document.getElementById("residyn-explorer");
let page = null;

/** Show a study of the server, as soon as it is there. */
async function open(server, study, hidden) {
  if (!hidden) server.home = study;
  page?.destroy();
  server.study = study;
  const words = element("p", { class: "status working", role: "status" }, "loading");
  const title = "Smoothing the recorded motion, and looking at all effects.";
  fill(
    root,
    element(
      "header",
      {},
      element("p", { class: "kind" }, "residyn explore"),
      element("p", { class: "verdict" }, title),
      words,
    ),
  );
  try {
    const data = await server.payload((said) => {
      words.textContent = `${said} ...`;
    });
    page = new Page(root, data, server, (...next) => open(server, ...next), hidden);
  } catch (error) {
    words.className = "status error";
    words.textContent = error.message;
  }
}

const inside = document.getElementById("residyn-explorer-data");
if (inside) page = new Page(root, await opened(JSON.parse(inside.textContent)));
else open(new Server(), 0, false);
