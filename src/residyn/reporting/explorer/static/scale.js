// One logarithmic scale of errors in times the noise, for all bars of the page.

import { element, fill } from "./elements.js";
import { times } from "./words.js";

const LEAST = 0.5; // times the noise, where bars begin: no error of a fit lies below
const FINE = 50; // up to here numbers at 1, 2 and 5 have room beside each other on a phone

export class Scale {
  constructor() {
    this.most = 2;
    this.numbers = element("span", { class: "track" });
    const words = element("small", {}, "times the noise");
    this.axis = element("div", { class: "bar axis" }, words, this.numbers);
  }

  /** Make room for the errors of models, and draw the axis. */
  hold(models) {
    const all = models.flatMap((m) => [...(m.fitted ?? []), ...(m.held_out ?? [])]);
    this.most = Math.max(this.most, 1.15 * Math.max(...all.filter(Number.isFinite)));
    const ticks = [];
    for (let ten = 1; ten <= this.most; ten *= 10) {
      const each = this.most < FINE ? [ten, 2 * ten, 5 * ten] : [ten];
      ticks.push(...each.filter((x) => x <= this.most));
    }
    fill(
      this.numbers,
      ...ticks.map((x) => {
        const tick = element("small", {}, `${x}`);
        tick.style.left = this.at(x);
        return tick;
      }),
    );
  }

  /** Where an error lies. */
  at(x) {
    const part = Math.log(Math.max(x, LEAST) / LEAST) / Math.log(this.most / LEAST);
    return `${100 * Math.min(1, Math.max(0.004, part))}%`;
  }

  /** A bar with its number, for `draw`; `more`: other elements on it. */
  bar(kind, ...more) {
    const bar = element("span", { class: `fill ${kind}` });
    const noise = element("span", { class: "noise" });
    const track = element("span", { class: "track" }, ...more, bar, noise);
    return { bar, track, value: element("span", { class: "value" }) };
  }

  /** `x`: null if it is not known. */
  draw({ bar, track, value }, x) {
    bar.hidden = x === null; // an empty bar would say that the error is gone
    bar.style.width = this.at(x ?? LEAST);
    track.style.setProperty("--one", this.at(1));
    value.textContent = x === null ? "not known" : `${times(x)} ×`;
  }
}
