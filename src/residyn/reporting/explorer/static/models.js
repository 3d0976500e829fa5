// What is known of each model: the first order at once, and the fits as they come.

import { keyOf } from "./evidence.js";

export class Models {
  constructor(evidence, first) {
    this.evidence = evidence;
    this.first = first;
    this.guesses = new Map(); // what the first order says, by model
    this.fits = new Map();
  }

  /** Take in fits; one by least squares is better than one by the smoother. */
  keep(fits) {
    for (const fit of fits) {
      const key = keyOf(fit.added);
      const known = this.fits.get(key);
      const more = known?.how !== "refitted" && (fit.held_out || !known?.held_out);
      if (fit.how === "refitted" || more) this.fits.set(key, fit);
    }
  }

  guess(labels) {
    const key = keyOf(labels);
    if (!this.guesses.has(key)) this.guesses.set(key, this.first.model(labels));
    return this.guesses.get(key);
  }

  /** The best that is known of a model now. */
  of(labels) {
    return this.fits.get(keyOf(labels)) ?? this.guess(labels);
  }

  /** Springs and dampers alone. */
  get base() {
    return this.of([]);
  }

  /** Labels with one more, or one less; the new one takes the place of those that it contains. */
  toggled(labels, label) {
    if (labels.includes(label)) return labels.filter((x) => x !== label);
    return [...labels.filter((x) => !this.evidence.conflict(x, label)), label];
  }

  /** Whether a joint or a brake may stick with these effects. */
  sticks(labels) {
    return labels.some((label) => this.evidence.candidates.get(label).sticks);
  }
}
