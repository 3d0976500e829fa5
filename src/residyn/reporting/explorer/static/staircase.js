// The models that have been looked at, as a staircase of their errors; a click goes back to one.

import { element, fill } from "./elements.js";
import { listed, times } from "./words.js";

export class Staircase {
  constructor(onChoose, nameOf) {
    this.place = element("div", {
      class: "stairs",
      role: "group",
      "aria-label": "models looked at",
    });
    this.onChoose = onChoose;
    this.nameOf = nameOf;
  }

  /** `steps`: [{ key, labels, model }] in the order in which they were first seen. */
  draw(steps, current) {
    const worst = (m) => (m?.fitted ? Math.max(...m.fitted) : null);
    const sizes = steps.map((s) => worst(s.model));
    const top = Math.max(2, ...sizes.filter((x) => x !== null));
    const height = (x) => 6 + 84 * (Math.log(Math.max(x, 0.7) / 0.7) / Math.log(top / 0.7));
    const focused = document.activeElement?.dataset?.step;
    fill(
      this.place,
      ...steps.map((step, i) => {
        const size = sizes[i];
        const names = step.labels.map(this.nameOf);
        const name = names.length ? `+ ${listed(names)}` : "springs and dampers";
        const tread = element("span", { class: size === null ? "tread unknown" : "tread" });
        tread.style.height = `${size === null ? 6 : height(size)}px`;
        const how = step.model?.how === "first order" ? " (first order)" : "";
        return element(
          "button",
          {
            type: "button",
            class: "step",
            "data-step": step.key,
            "aria-current": step.key === current ? "true" : null,
            title: `${name}: ${size === null ? "error not known" : `${times(size)} times the noise`}${how}`,
            click: () => this.onChoose(step.labels),
          },
          element("span", { class: "size" }, size === null ? "?" : `${times(size)} ×`),
          tread,
          element("span", { class: "what" }, name),
        );
      }),
    );
    if (focused !== undefined) {
      [...this.place.children].find((b) => b.dataset.step === focused)?.focus();
    }
  }
}
