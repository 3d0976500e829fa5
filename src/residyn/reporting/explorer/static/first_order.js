// What effects would do to the error, the curves and the torque, before anything is fitted.

import { at, rows, symmetric } from "./arrays.js";
import { quadratic, subset } from "./linear_algebra.js";

class ErrorGram {
  constructor(packed) {
    this.solve = symmetric(packed.solve.values, packed.size);
    this.joints = rows(packed.joints).map((upper) => symmetric(upper, packed.size));
    this.noise = packed.noise;
    this.readings = packed.readings;
  }

  /** Strengths of columns, by least squares. */
  strengths(columns) {
    return columns.length ? subset(this.solve, columns).mean : [];
  }

  /** Per joint the rms error over the noise. */
  timesNoise(columns, strengths = this.strengths(columns)) {
    return this.joints.map((gram, j) => {
      const energy = quadratic(gram, columns, strengths) + this.noise[j];
      return Math.sqrt(Math.max(energy, 0) / Math.max(this.readings[j], 1));
    });
  }
}

export class FirstOrder {
  constructor(data, evidence) {
    this.data = data;
    this.evidence = evidence;
    this.known = data.first !== null;
    if (!this.known) return;
    this.fitted = new ErrorGram(data.first.fitted);
    this.heldOut = new ErrorGram(data.first.held_out);
    this.columns = new Map(data.candidates.map((c) => [c.label, c.columns])); // at likeliest shapes
  }

  which(labels) {
    return labels.flatMap((label) => this.columns.get(label));
  }

  /** The model with these effects, as far as the first order knows it; like a stored fit. Where a
   * joint may stick nothing is linear: no error and no curve. */
  model(labels) {
    const { data } = this;
    const found = this.evidence.gain(labels);
    const model = {
      added: labels,
      how: "first order",
      fitted: null,
      held_out: null,
      numbers: this.numbers(labels, found),
      predicted: data.recordings.map(() => null),
      torque: this.known ? this.torque(labels, found) : null,
    };
    if (!this.known || labels.some((x) => this.evidence.candidates.get(x).sticks)) return model;
    const columns = this.which(labels);
    const strengths = this.fitted.strengths(columns);
    model.fitted = this.fitted.timesNoise(columns, strengths);
    model.held_out = this.heldOut.timesNoise(columns);
    model.predicted = data.first.predicted.map((one, i) => {
      const total = rows(one.base).map((row) => Float64Array.from(row));
      columns.forEach((c, k) => {
        rows(one.columns[c]).forEach((row, j) => {
          for (let t = 0; t < row.length; t++) total[j][t] += strengths[k] * row[t];
        });
      });
      const [time, wanted] = [one.time.values, data.recordings[i].time.values];
      return total.map((row) => at(time, row, wanted));
    });
    return model;
  }

  /** Strengths of effects in their own units. */
  numbers(labels, found) {
    const numbers = [];
    let first = 0;
    for (const label of labels) {
      const own = this.evidence.candidates.get(label);
      const add = (n, value, std) =>
        numbers.push({ name: `${label}.${n.name}`, unit: n.unit, value, std });
      own.strengths.forEach((strength, i) => {
        let u = found.mean[first + i];
        if (own.oscillates) u = Math.hypot(...found.mean.slice(first, first + 2));
        add(
          strength,
          strength.silent + strength.width * u,
          strength.width * found.spread[first + i],
        );
      });
      for (const shape of own.shape) add(shape, shape.value, null);
      first += own.rows[own.best].length;
    }
    return numbers;
  }

  /** Per fitted recording and joint, the torque that the base model would lack. */
  torque(labels, found) {
    const columns = this.which(labels);
    const means = this.data.screen.likeliest_base_means[found.likeliest];
    const shift = means.values;
    const width = means.shape[1];
    const screened = this.evidence.best(labels).flatMap(([, which]) => which);
    return this.data.missing.map((one) => {
      const length = one.time.shape[0];
      const total = this.data.joints.map(() => new Float64Array(length));
      const add = (sparse, factor) => {
        for (const [joint, { values }] of Object.entries(sparse)) {
          for (let k = 0; k < length; k++) total[joint][k] += factor * values[k];
        }
      };
      for (const [i, c] of columns.entries()) add(one.columns[c], found.mean[i]);
      one.base.forEach((sparse, p) => {
        let change = 0;
        for (const [i, c] of screened.entries()) change += shift[p * width + 1 + c] * found.mean[i];
        add(sparse, change);
      });
      return total;
    });
  }
}
