// The model's numbers: their values and errors, and, live, a slider and fit or hold for each.

import { element, fill } from "./elements.js";
import { measured } from "./words.js";

const STEPS = 400;

/** "Spring, elbow: stiffness" of "spring:elbow.stiffness". */
function spoken(n) {
  const [label, ...rest] = n.name.split(".");
  const words = `${label.replace(":", ", ")}: ${rest.join(".")}`.replaceAll("_", " ");
  return words[0].toUpperCase() + words.slice(1); // names of laws begin with persons
}

export class Numbers {
  /** `onMove(name, value)` while a slider moves, `onHold(name, value | null)` when it rests. */
  constructor({ live, onMove, onHold }) {
    Object.assign(this, { live, onMove, onHold });
    this.place = element("div", {});
    this.ranges = new Map();
    this.names = "";
    this.rows = new Map();
  }

  /** `held`: Map name -> value. */
  draw(model, held) {
    const names = model.numbers.map((n) => n.name).join("\n") + (model.how === "first order");
    if (names !== this.names) this.build(model);
    this.names = names;
    for (const n of model.numbers) {
      const row = this.rows.get(n.name);
      const value = held.has(n.name) ? held.get(n.name) : n.value;
      row.value.textContent = held.has(n.name)
        ? `${measured(value, null, n.unit)}, held`
        : measured(value, n.std, n.unit);
      if (!row.slider) continue;
      row.hold.checked = held.has(n.name);
      if (document.activeElement !== row.slider || !held.has(n.name)) {
        const { low, high } = row.range;
        row.slider.value = String(Math.round((STEPS * (value - low)) / (high - low)));
      }
      row.slider.setAttribute("aria-valuetext", row.value.textContent);
    }
  }

  build(model) {
    this.rows.clear();
    const live = this.live && model.how !== "first order";
    const rows = model.numbers.map((n) => {
      const value = element("td", { class: "n" });
      const row = { value };
      const cells = [element("th", { scope: "row" }, spoken(n)), value];
      if (live) {
        const span = Math.max(8 * (n.std ?? 0), 0.6 * Math.abs(n.value), 1e-9);
        const low = n.positive ? Math.max(0, n.value - span) : n.value - span;
        row.range = { low, high: n.value + span };
        const read = () => low + ((row.range.high - low) * Number(row.slider.value)) / STEPS;
        row.slider = element("input", {
          type: "range",
          min: 0,
          max: STEPS,
          step: 1,
          "aria-label": n.name,
          input: () => this.onMove(n.name, read()),
          change: () => this.onHold(n.name, read()),
        });
        row.hold = element("input", {
          type: "checkbox",
          "aria-label": `hold ${n.name}`,
          change: () => this.onHold(n.name, row.hold.checked ? read() : null),
        });
        cells.push(
          element("td", { class: "slide" }, row.slider),
          element("td", {}, element("label", { class: "hold" }, row.hold, " hold")),
        );
      }
      this.rows.set(n.name, row);
      return element("tr", {}, ...cells);
    });
    fill(this.place, element("table", { class: "numbers" }, element("tbody", {}, ...rows)));
  }
}
