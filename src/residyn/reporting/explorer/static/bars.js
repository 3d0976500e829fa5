// The error of each joint in times the noise, as bars on a logarithmic scale that fall.

import { element } from "./elements.js";
import { times } from "./words.js";

const LEAST = 0.5;

export class Bars {
  constructor(joints, heldOut) {
    this.place = element("div", { class: "bars" });
    this.rows = [];
    this.most = 2;
    const words = heldOut === "last third" ? "last third, held out" : "held out";
    for (const joint of joints) {
      for (const [kind, name] of [
        ["fitted", "fitted"],
        ["held", words],
      ]) {
        const fill = element("span", { class: `fill ${kind}` });
        const ghost = element("span", { class: "ghost", title: "springs and dampers alone" });
        const value = element("span", { class: "value" });
        const track = element(
          "span",
          { class: "track" },
          ghost,
          fill,
          element("span", { class: "noise" }),
        );
        this.place.append(
          element(
            "div",
            { class: "bar" },
            element(
              "span",
              { class: "name" },
              kind === "fitted" ? element("b", {}, joint) : "",
              element("small", {}, ` ${name}`),
            ),
            track,
            value,
          ),
        );
        this.rows.push({ fill, ghost, value, kind });
      }
    }
    this.place.append(
      element(
        "p",
        { class: "note" },
        "Root mean square of measured minus model, in times the noise of a reading. " +
          "The dashed line is the noise: no bar can fall further. Thin marks: springs and dampers alone.",
      ),
    );
  }

  share(x) {
    const top = Math.log(this.most / LEAST);
    return Math.min(1, Math.max(0.004, Math.log(Math.max(x, LEAST) / LEAST) / top));
  }

  /** Errors of a model, and of the base model. */
  draw(model, base) {
    const all = [base, model].flatMap((m) => [...(m.fitted ?? []), ...(m.held_out ?? [])]);
    this.most = Math.max(2, this.most, 1.15 * Math.max(...all.filter(Number.isFinite)));
    this.rows.forEach((row, i) => {
      const of = (m) => (row.kind === "fitted" ? m.fitted : m.held_out)?.[i >> 1] ?? null;
      const [now, first] = [of(model), of(base)];
      row.fill.style.width = `${now === null ? 0 : 100 * this.share(now)}%`;
      row.fill.hidden = now === null; // an empty bar would say that the error is gone
      row.ghost.style.left = `${100 * this.share(first ?? LEAST)}%`;
      row.ghost.hidden = first === null;
      row.value.textContent = now === null ? "not known" : `${times(now)} ×`;
      row.fill.parentElement.style.setProperty("--one", `${100 * this.share(1)}%`);
    });
  }
}
