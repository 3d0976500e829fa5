// The effects as chips: what is on and the most probable ones first, the others folded away below.

import { element, fill } from "./elements.js";
import { percent } from "./words.js";

const MOST = 8;

export class Chips {
  /** `candidates`: Map label -> candidate; `onToggle(label)`. */
  constructor(candidates, onToggle) {
    Object.assign(this, { candidates, onToggle });
    const group = (label) => element("div", { class: "chips", role: "group", "aria-label": label });
    this.top = group("effects of the model, and the most probable others");
    this.rest = group("all other effects");
    this.title = element("summary", {});
    this.first = [];
    this.parts = [this.top, element("details", {}, this.title, this.rest)];
  }

  /** What is on, then the others, the most probable one first; `weighed(exact)`: whether a
   * probability is worth showing yet. */
  draw(chosen, probabilities, weighed) {
    const others = [...probabilities]
      .filter(([label]) => !chosen.includes(label))
      .sort((a, b) => b[1].probability - a[1].probability)
      .map(([label]) => label);
    const most = Math.max(0, MOST - chosen.length);
    this.first = [...chosen, ...others.slice(0, most)];
    const rest = others.slice(most);
    const focused = document.activeElement?.dataset?.effect;
    const chip = (label) => this.chip(label, chosen, probabilities.get(label), weighed);
    fill(this.top, ...this.first.map(chip));
    fill(this.rest, ...rest.map(chip));
    this.title.textContent = `${rest.length} more effects and places`;
    if (focused) this.find(focused)?.focus();
  }

  find(label) {
    return [...this.top.children, ...this.rest.children].find((b) => b.dataset.effect === label);
  }

  chip(label, chosen, { probability, exact }, weighed) {
    const own = this.candidates.get(label);
    const known = weighed(exact);
    const on = chosen.includes(label);
    let said =
      probability === null ? "not known" : `${percent(probability)} ${on ? "needed" : "next"}`;
    if (!known) said = "not evaluated yet";
    const order = probability === null ? "" : "probability to first order";
    const words = [own.equation, own.looks_like, exact ? "" : order];
    const found = element(
      "button",
      {
        type: "button",
        class: "chip",
        "aria-pressed": String(on),
        "data-effect": label,
        title: words.filter(Boolean).join("; "),
        click: () => this.onToggle(label),
      },
      element(
        "span",
        { class: "title" },
        own.title,
        own.place ? element("small", {}, ` ${own.place}`) : "",
      ),
      element("span", { class: "p" }, said),
    );
    found.style.setProperty("--p", `${known ? 100 * probability : 0}%`);
    return found;
  }
}
