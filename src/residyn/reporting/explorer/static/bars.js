// The error of each joint, fitted and held out, as bars that fall.

import { element } from "./elements.js";

export class Bars {
  constructor(joints, heldOut, scale) {
    this.scale = scale;
    const words = heldOut === "last third" ? "last third, held out" : "held out";
    this.rows = joints.flatMap((joint) => [
      this.row("fitted", "fitted", element("b", {}, joint)),
      this.row("held", words, ""),
    ]);
    this.place = element("div", { class: "bars" }, ...this.rows.map((row) => row.place));
  }

  row(kind, words, joint) {
    const ghost = element("span", { class: "ghost", title: "springs and dampers alone" });
    const bar = this.scale.bar(kind, ghost);
    const name = element("span", { class: "name" }, joint, element("small", {}, ` ${words}`));
    return {
      kind,
      ghost,
      bar,
      place: element("div", { class: "bar" }, name, bar.track, bar.value),
    };
  }

  /** Errors of a model, and of the base model. */
  draw(model, base) {
    this.rows.forEach((row, i) => {
      const of = (m) => (row.kind === "fitted" ? m.fitted : m.held_out)?.[i >> 1] ?? null;
      const first = of(base);
      this.scale.draw(row.bar, of(model));
      row.ghost.hidden = first === null;
      row.ghost.style.left = this.scale.at(first ?? 0);
    });
  }
}
