// The models that have been looked at, each with the error of its worst joint; a click goes back to
// one.

import { element, fill } from "./elements.js";
import { listed } from "./words.js";

export class Staircase {
  constructor(joints, scale, { onChoose, nameOf }) {
    Object.assign(this, { joints, scale, onChoose, nameOf });
    this.place = element("div", {
      class: "stairs",
      role: "group",
      "aria-label": "models looked at",
    });
  }

  /** `steps`: [{ key, labels, model }] in the order in which they were first seen. */
  draw(steps, current) {
    const focused = document.activeElement?.dataset?.step;
    fill(this.place, ...steps.map((step) => this.step(step, current)));
    if (focused !== undefined) {
      [...this.place.children].find((b) => b.dataset.step === focused)?.focus();
    }
  }

  step({ key, labels, model }, current) {
    const names = labels.map(this.nameOf);
    const errors = model.fitted ?? [];
    const size = errors.length ? Math.max(...errors) : null;
    const bar = this.scale.bar("fitted");
    this.scale.draw(bar, size);
    const joint = size === null ? "" : this.joints[errors.indexOf(size)];
    const how = size !== null && model.how === "first order" ? ", first order" : "";
    const name = element("span", { class: "name" }, element("small", {}, `${joint}${how}`));
    return element(
      "button",
      {
        type: "button",
        class: "step",
        "data-step": key,
        "aria-current": key === current ? "true" : null,
        click: () => this.onChoose(labels),
      },
      element(
        "span",
        { class: "what" },
        names.length ? `+ ${listed(names)}` : "springs and dampers",
      ),
      element("span", { class: "bar" }, name, bar.track, bar.value),
    );
  }
}
