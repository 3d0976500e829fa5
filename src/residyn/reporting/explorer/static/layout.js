// Where everything stands on the page, under which words.

import { action, element, fill } from "./elements.js";
import { force, position } from "./words.js";

function panel(title, words, ...children) {
  return element(
    "section",
    { class: "panel" },
    element("h2", {}, title),
    words ? element("p", { class: "note" }, words) : null,
    ...children,
  );
}

/** What colours mean: { name of a colour: words }. */
function legend(words) {
  const keys = Object.entries(words).map(([colour, said]) =>
    element("span", { class: `key ${colour}` }, said),
  );
  return element("div", { class: "legend" }, ...keys);
}

/** Fill `root` with the parts of a page; `hide` is one more button, or null. */
export function lay(root, page, hide) {
  const { saving } = page;
  const acts = force(page.data.units);
  fill(
    root,
    element(
      "header",
      {},
      page.server
        ? element("p", { class: "kind" }, `residyn explore: ${page.data.name}`)
        : element("h2", { class: "kind" }, `Explore the models of ${page.data.name}`),
      page.verdict,
      page.status,
      page.news ? page.news.place : null,
    ),
    element(
      "div",
      { class: "columns" },
      panel(
        "Add an effect",
        "A click adds it to the model or takes it away. The number on an effect that is added (✓) " +
          "is the probability that it is needed: that the model is better with it than without it; " +
          "on any other, that it is the one to add next.",
        ...page.chips.parts,
        element("div", { class: "actions" }, ...saving.parts, hide, saving.said),
        hide
          ? element(
              "p",
              { class: "note" },
              "Hide one: an effect is hidden in a simulated copy of this arm, for you to find.",
            )
          : null,
      ),
      panel(
        "Watch the error fall",
        "The error is the root mean square of measured minus model. The dashed line is the noise of a " +
          "reading: a model that lacks nothing comes to it, or by chance a little below. Thin marks: " +
          "springs and dampers alone.",
        page.bars.place,
        page.scale.axis,
        element("h3", {}, "Models so far, and the joint where each is worst"),
        page.stairs.place,
      ),
    ),
    panel(
      "Measured, model and what is left",
      "Drag across a chart to choose a stretch of time; it is marked everywhere.",
      legend({
        measured: "measured",
        model: "model",
        residual: "measured less model",
        band: "noise, 2 sigma",
      }),
      page.recordings.place,
      page.stretch.place,
      page.curves.place,
    ),
    panel(
      `The ${acts} that springs and dampers lack`,
      "Friction is a step against the rate, a stiffening spring an S against the " +
        `${position(page.data.units)}, hysteresis a loop.`,
      legend({
        measured: "estimated from the motion",
        band: "95\u00a0% band",
        model: `${acts} of the added effects`,
        mark: "in the chosen stretch",
      }),
      page.joints.place,
      page.missing.place,
    ),
    panel(
      "Numbers",
      page.server
        ? "Move a number and the model's curve follows; the others are then fitted again beside it."
        : "",
      page.numbers.place,
    ),
  );
  if (document.querySelector(".in-full")) standForTheRest(root);
}

/** In a report the page stands for all tables and pictures; a button shows them. */
function standForTheRest(root) {
  const turn = (shown) => {
    document.body.classList.toggle("explored", !shown);
    more.setAttribute("aria-expanded", String(shown));
    more.textContent = shown ? "Hide tables and pictures" : "All tables and pictures";
  };
  const more = action("", () => turn(more.getAttribute("aria-expanded") === "false"));
  root.append(element("div", { class: "actions" }, more));
  turn(false);
}
