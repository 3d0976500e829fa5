// A stretch of time, chosen by two sliders; a drag across a chart chooses one as well.

import { action, element } from "./elements.js";

const STEPS = 1000;
const SHORTEST = 1 / 200; // of the recording

export class Stretch {
  /** `onChoose([from, to] | null)`. */
  constructor(onChoose) {
    this.onChoose = onChoose;
    this.last = 1;
    const slider = (words) =>
      element("input", {
        type: "range",
        min: 0,
        max: STEPS,
        step: 1,
        "aria-label": `${words}, s`,
        input: () => this.moved(),
      });
    this.sliders = [slider("from"), slider("to")];
    this.values = [element("output", {}), element("output", {})];
    this.whole = action("Whole recording", () => onChoose(null));
    const labelled = (words, i) => element("label", {}, words, this.sliders[i], this.values[i]);
    this.place = element(
      "div",
      { class: "stretch" },
      labelled("from", 0),
      labelled("to", 1),
      this.whole,
    );
  }

  moved() {
    const [a, b] = this.sliders.map((s) => (this.last * Number(s.value)) / STEPS);
    const short = Math.abs(b - a) < this.last * SHORTEST;
    this.onChoose(short ? null : [Math.min(a, b), Math.max(a, b)]);
  }

  /** `last`: where the recording ends, s. */
  draw(stretch, last) {
    this.last = last;
    (stretch ?? [0, last]).forEach((t, i) => {
      const slider = this.sliders[i];
      if (document.activeElement !== slider || !stretch) {
        slider.value = String((STEPS * t) / last);
      }
      this.values[i].textContent = `${t.toFixed(2)} s`;
      slider.setAttribute("aria-valuetext", this.values[i].textContent);
    });
    this.whole.disabled = stretch === null;
  }
}
